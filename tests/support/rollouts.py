"""Rollouts that nobody simulated."""

import numpy as np

from fuzzyarm.eval.episodes.rollout import Rollout


def made_rollout(time, joints=2, axes=2, **signals):
    """A completed rollout at these times (samples,) [s]; signals that are not given are zero."""
    still, each, place = np.zeros(len(time)), np.zeros((len(time), joints)), np.zeros((len(time), axes))
    base = {"policy": "p", "case": "nominal", "seed": 0, "control_period": 1e-3, "completed": True, "reason": ""}
    base |= dict.fromkeys(("tip", "tip_reference", "external_force"), place)
    base |= dict.fromkeys(("tip_error", "circularity_error", "circularity_error_motor", "reward", "domain_use"), still)
    base |= dict.fromkeys(("q_motor", "dq_motor", "q_link", "dq_link", "q_reference", "dq_reference", "torque"), each)
    return Rollout(**base | {"step_time": 4e-6, "time": time, "friction_torque": each} | signals)
