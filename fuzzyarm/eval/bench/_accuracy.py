"""Accuracy of the time step: one closed loop, run with the environment's integrator and with the event integrator."""

import numpy as np

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import tip_position
from fuzzyarm.envs.physics.event_integrator import integrate
from fuzzyarm.envs.scenario.cases import find_case
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = ["exact_tips", "max_tip_difference", "stepped_tips"]


def stepped_tips(policy: Predictor, case: str, substep: float) -> np.ndarray:
    """Return the positions of the tip (n, 2) [m] after each control step of the environment with the sub-step [s]."""
    env = FuzzyArmEnv(case=case, substep=substep)
    return np.array([step.info["tip"] for step in episodes(env, policy, env.reset(seed=0))])


def exact_tips(policy: Predictor, case: str) -> np.ndarray:
    """Return the positions of the tip (n, 2) [m] after each control step, with the plant solved by `event_integrator`.

    The tip force varies within a control step. The policy acts on the solved states.
    """
    env, disturbance = FuzzyArmEnv(case=case), find_case(case).disturbance
    reference, period, tip_force = env.reference, env.control_period, disturbance.tip_force
    _, info = env.reset(seed=0)
    state = np.concatenate([info[part] for part in ("q_motor", "q_link", "dq_motor", "dq_link")])
    wanted = reference.sample(period * np.arange(round(reference.duration / period)))
    memory, found = None, []

    def force(time: float) -> tuple[float, float]:
        x, y = (0.0, 0.0) if tip_force is None else tip_force.at(np.array(time), reference.tip(time).velocity)
        return float(x), float(y)

    for k, target in enumerate(np.concatenate([wanted.q, wanted.dq, wanted.ddq], axis=1)):
        q_motor, _, dq_motor, _ = state.reshape(-1, JOINTS)
        seen, begins = np.concatenate([q_motor, dq_motor, target]), np.array([k == 0])
        torque, memory = policy.predict(seen, state=memory, episode_start=begins, deterministic=True)
        times = k * period, (k + 1) * period
        state = integrate(state, torque, force, env.parameters, disturbance.payload, *times)
        found.append(tip_position(state[JOINTS : 2 * JOINTS], env.parameters.length))
    return np.array(found)


def max_tip_difference(stepped: np.ndarray, exact: np.ndarray) -> float:
    """Return the largest distance [m] between points of equal index of two tip paths (n, 2) [m]."""
    return float(np.hypot(*(stepped - exact).T).max())
