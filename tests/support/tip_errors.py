"""What the environment measures where a bound is proven."""

import numpy as np


def tip_errors(env, policy, torques):
    """Return the tip errors [m] after steps of a policy with torques (steps, n) [N m] beside its own."""
    (observation, _), memory, errors = env.reset(seed=0), None, []
    for beside in torques:
        torque, memory = policy.predict(observation, memory)
        observation, *_, info = env.step(torque + beside)
        errors.append(info["tip_error"])
    return np.array(errors)
