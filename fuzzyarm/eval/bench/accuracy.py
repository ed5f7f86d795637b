"""How accurate the environment's time step is: the same closed loop on the step and on the event integrator."""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import tip_position
from fuzzyarm.envs.physics.event_integrator import integrate
from fuzzyarm.envs.scenario.cases import find_case
from fuzzyarm.fuzzy_policy.policy import Predictor


def stepped_tips(policy: Predictor, case: str, substep: float) -> np.ndarray:
    """Return the tip (n, 2) [m] after every control step of the environment with the given sub-step [s]."""
    env = FuzzyArmEnv(case=case, substep=substep)
    observation, _ = env.reset(seed=0)
    state, tips, done = None, [], False
    while not done:
        action, state = policy.predict(observation, state)
        observation, _, terminated, truncated, info = env.step(action)
        tips.append(info["tip"])
        done = terminated or truncated
    return np.array(tips)


def exact_tips(policy: Predictor, case: str) -> np.ndarray:
    """Return the same (n, 2) [m] with the plant solved by `event_integrator` under the force that follows time.

    The policy closes this loop by itself, from the states found here. About ten seconds.
    """
    env, disturbance = FuzzyArmEnv(case=case), find_case(case).disturbance
    observation, info = env.reset(seed=0)
    reference, period = env.reference, env.control_period
    state = np.concatenate([info["q_motor"], info["q_link"], info["dq_motor"], info["dq_link"]])

    def force(time: float) -> tuple[float, float]:
        if disturbance.tip_force is None:
            return 0.0, 0.0
        x, y = disturbance.tip_force.at(np.array(time), reference.tip(time).velocity)
        return float(x), float(y)

    steps = round(reference.duration / period)
    wanted = reference.sample(period * np.arange(steps + 1))
    targets = np.concatenate([wanted.q, wanted.dq, wanted.ddq], axis=1)
    memory, tips = None, []
    for k in range(steps):
        observation = np.concatenate([state[[0, 1, 4, 5]], targets[k]])
        torque, memory = policy.predict(observation, memory)
        state = integrate(state, torque, force, env.parameters, disturbance.payload, k * period, (k + 1) * period)
        tips.append(tip_position(state[2:4], env.parameters.length))
    return np.array(tips)


def max_tip_difference(stepped: np.ndarray, exact: np.ndarray) -> float:
    """Return the largest distance [m] between two tip paths of equal length."""
    return float(np.hypot(*(stepped - exact).T).max())
