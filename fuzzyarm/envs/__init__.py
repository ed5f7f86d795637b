"""The robot and the task: physics, reference, disturbances and the Gymnasium environment."""
