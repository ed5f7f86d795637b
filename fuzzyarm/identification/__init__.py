"""Identification of an arm's parameters, with intervals, from a log of motor angles, velocities and torques."""
