"""What the arm is asked to do: references, disturbances, cases and domain randomisation."""
