"""The simulator of the fuzzer, by mathematics and against the package's environment."""

import math

import gymnasium as gym
import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.policies.tip_bound import TipClaim
from fuzzyarm.proof.tip.plant import PlantSet

from .arm import hold
from .motions import even_stops, simulated
from .sets import CONSTANTS, arm_of, sample_at, schedule_of

MIDDLE = np.full(len(CONSTANTS), 0.5)
START = (0.7, 0.8, 0.699, 0.802, 0.3, -0.02, 0.25, 0.0)
TORQUE, FORCE = (67.0, 20.0), (5.0, -3.0, 2e3, 1e3)


def exact(claim):
    return sample_at(claim.plants, MIDDLE, claim.steps, np.random.default_rng(0))


def path(count):
    """Motors that come to rest, and that a rising force breaks away again."""
    start, torque, force = (0.70116, 0.8018, 0.7, 0.8, 0.02, -0.01, 0.0, 0.0), (74.0, 22.0), (0.0, 0.0, 200.0, -400.0)
    claim, stops = TipClaim("computed-torque-tip", steps=1), [0.1 * (i + 1) / count for i in range(count)]
    return np.array([node.state for node in hold(arm_of(claim, exact(claim)), start, torque, force, stops)])


def test_it_is_of_fourth_order_through_stick_and_slip():
    counts, rests = (100, 200, 400), (path(400)[1:, 4:6] == 0.0).astype(int)
    assert (np.diff(rests, axis=0) == 1).any(axis=0).all() and (np.diff(rests, axis=0) == -1).any(axis=0).all()
    fine = path(3200)[-1]
    errors = [np.abs(path(count)[-1] - fine).max() for count in counts]
    assert np.polyfit(np.log(counts), np.log(errors), 1)[0] < -3.5
    assert errors[-1] < 1e-7


def test_energy_is_what_motors_and_the_tip_force_do_less_what_friction_and_damping_take():
    """The sign of every term: inertia, Coriolis, gravity, elasticity, dry and viscous friction, damping, tip force."""
    claim = TipClaim("computed-torque-tip", "payload", plants=PlantSet(payload=(1.0, 2.0)), steps=1)
    arm, duration, count = arm_of(claim, exact(claim)), 0.02, 400
    nodes = [*hold(arm, START, TORQUE, FORCE, [duration * (i + 1) / count for i in range(count)])]
    powers = []
    for node in nodes:
        q1, q2, v1, v2, w1, w2 = node.state[2:]
        x, y = (FORCE[i] + FORCE[2 + i] * node.time for i in range(2))
        (l1, l2), q12, w12 = arm.length, q1 + q2, w1 + w2
        tip = -l1 * w1 * math.sin(q1) - l2 * w12 * math.sin(q12), l1 * w1 * math.cos(q1) + l2 * w12 * math.cos(q12)
        power = TORQUE[0] * v1 + TORQUE[1] * v2 + x * tip[0] + y * tip[1]
        for j, (v, w) in enumerate(((v1, w1), (v2, w2))):
            power -= arm.slip_friction(j, v) * abs(v) + arm.viscous[j] * v * v + arm.damping[j] * (v - w) ** 2
        powers.append(power)
    work = duration / count / 3.0 * np.dot([1.0, *([4.0, 2.0] * (count // 2))[:-1], 1.0], powers)  # Simpson's rule
    assert abs(work) > 0.1
    assert arm.energy(nodes[-1].state) - arm.energy(nodes[0].state) == pytest.approx(work, rel=1e-5)


@pytest.mark.parametrize("case", ["nominal", "machining", "payload"])
def test_it_agrees_with_the_environment(case):
    """The tip differs by what the environment's own time step leaves, 0.2 µm in the whole motion."""
    claim, steps = TipClaim("fuzzy-4-tip", case, steps=60), 60
    (motion,) = simulated(claim, [exact(claim)], even_stops(steps))
    env, policy, memory = gym.make("fuzzyarm:FuzzyArm-v0", case=case), load_policy("fuzzy-4-tip"), None
    seen, info = env.reset(seed=0)
    for k in range(steps):
        action, memory = policy.predict(seen, memory)
        assert motion.torques[k] == pytest.approx(action, abs=0.1)
        seen, *_, info = env.step(action)
        state = np.array(motion.nodes[k][-1].state)
        assert np.abs(state[2:4] - info["q_link"]).max() < 3e-7
    assert np.abs(state[:2] - schedule_of(claim).start[:2]).max() > 1e-3  # it moves
