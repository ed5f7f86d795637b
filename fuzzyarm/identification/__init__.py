"""Which arm is this? From a log of motor angles, velocities and torques to the arm's parameters, with intervals."""
