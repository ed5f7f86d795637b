"""The weights of the adaptive observer: the smallest largest error over random arms, none of them at the cap.

Objective: the largest tip error, on average over the arms of each of `GROUPS` plus `TAIL` times that of the worst of
them, summed over the groups, plus that of the nominal arm without load and with encoder noise, all in mm; an arm whose
episode ends early, or that errs more, counts as `CAP`. Arms follow random circles, lemniscates and lines that take at
most 95 % of the torque limits under the heaviest load, with a payload of up to the arm's (Table 1: 5 kg), half of them
under a force in a random direction from a random instant on, half under one against the direction of travel, both up to
the arm's (250 N). The arms of the first group are the known one. Those of the second have masses and motor
inertias within 10 % of it, stiffness within 20 %, damping and friction within 50 %, torque constants within 10 %. Those
of the third have that, encoder noise of up to twice the README's, and commands of up to two periods late. The default
reference is that of the last error alone, and the cases with loads play no part.

Searched are the weights of `BOX`. The others say what is known beforehand (how far an arm may be from what is known)
or how sure a test is (the dead zone: four standard deviations), and stay.

The policy bears other loops only because it adapts to them: with its adaptation frozen it is unstable where the loop
gain is a few per cent off, and its search has no constraint of margins.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence

import gymnasium as gym
import numpy as np

from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, rigid_inverse_dynamics, tip_jacobian
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.default_reference import reference_family
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise, MachiningForce
from fuzzyarm.envs.scenario.randomisation import find_randomisation
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.eval.sweep.episodes import Delay
from fuzzyarm.eval.tuning.finding import PERIOD, force_factor, heaviest
from fuzzyarm.eval.tuning.search import Budget, Costs, rounded
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

__all__ = [
    "BOX", "CAP", "FIRST_STEP", "FULL", "GROUPS", "LANES", "NOISE", "SEED", "SHORT", "TAIL", "UNFIT", "RandomArms",
    "feasible_references", "logarithms_of", "noisy_nominal", "objective_for", "weights_of",
]  # fmt: skip

BOX = {
    "link_angle": (2e-3, 1.5e-2),
    "motor_torque": (2e-4, 1.5e-3),
    "torque_doubt": (0.1, 1.0),
    "travel_walk": (0.5, 4.0),
    "force_walk": (0.05, 1.0),
    "calm_walk": (0.1, 1.0),
    "reopening": (0.05, 0.6),
    "encoder_velocity": (5e-4, 5e-3),
    "gate": (1.0, 8.0),
}
"""Where the Sobol set lies, by name of the weight; Nelder-Mead may leave it."""
FULL = Budget(sobol=8, searches=2, evaluations=24, from_guess=True)
"""The search that chose the shipped weights."""
SHORT = Budget(sobol=8, searches=0, evaluations=0)
"""The search of `fuzzyarm tune`: the first guess and eight others."""
FIRST_STEP = math.log(1.4)  # of Nelder-Mead, in the logarithm of a weight
_DIGITS = 2  # of a weight
LANES, SEED = 40, 11  # of the arms that are tuned on, in each group
CAP = 50.0
"""The largest error that an arm counts with [mm], and what it counts if its episode ends early. It is no definition of
a lost path, see `metrics.is_lost`: one arm far off shall not decide for all."""
UNFIT = math.inf  # the cost of weights for which there is no regulator
TAIL = 0.1  # weight of the worst arm beside the mean
_FEASIBLE = 0.95  # of the torque limits
_LARGEST_FORCE, _LATEST_ONSET = 250.0, 0.5  # N, on the arm of Table 1; s
_LONGEST_DELAY, _TORQUE_CONSTANT = 2, 0.1  # periods; share
GROUPS = {"known": (0, 0), "unknown": (1, 0), "unknown, late and noisy": (1, 1)}
"""By name: whether the arm is another than the known one, and whether it is late and its encoders noisy."""
NOISE = EncoderNoise(position=1e-5, velocity=1e-3)  # rad, rad/s


class RandomArms:
    """Arms of one seed and group."""

    def __init__(self, seed: int, group: str, lanes: int = LANES, arm: ArmParameters | None = None) -> None:
        """Draw loads, noise, lateness and torque constants; the plants are drawn by a reset with the same seed.

        The group is of `GROUPS`; `arm` is the known one, default Table 1.
        """
        arm = ArmParameters() if arm is None else arm
        unknown, late = GROUPS[group]
        generator, disturbances = np.random.default_rng((seed, list(GROUPS).index(group))), []
        largest = _LARGEST_FORCE * force_factor(arm)
        for lane in range(lanes):
            size, angle = generator.uniform(0.0, largest), generator.uniform(-math.pi, math.pi)
            start, fade = generator.uniform(0.0, _LATEST_ONSET), generator.uniform(0.005, 0.05)
            factor = late * generator.uniform(0.0, 2.0)
            noise = EncoderNoise(factor * NOISE.position, factor * NOISE.velocity)
            push = ConstantForce((size * math.cos(angle), size * math.sin(angle)), start)
            drag = MachiningForce(base=size, swing=0.0, fade_speed=fade)
            disturbances.append(Disturbance(tip_force=push if lane % 2 else drag, encoder_noise=noise))
        plants = find_randomisation("plants" if unknown else "nominal", arm)
        drawn = dataclasses.replace(plants, payload=(0.0, heaviest(arm)), references=feasible_references(arm))
        self.envs = gym.make_vec(
            "FuzzyArm-v0", num_envs=lanes, disturbance=disturbances, randomisation=drawn, parameters=arm
        )
        self.delay = late * generator.integers(0, _LONGEST_DELAY + 1, lanes)
        self.factor = 1.0 + unknown * generator.uniform(-_TORQUE_CONSTANT, _TORQUE_CONSTANT, lanes)[:, np.newaxis]
        self.seed = seed

    def largest_errors(self, policy: AdaptiveObserverPolicy) -> np.ndarray:
        """Return the largest tip error of every lane's episode [mm], (lanes,), at most `CAP`."""
        late, largest = Delay(self.delay, policy.joints), np.zeros(len(self.delay))
        start = self.envs.reset(seed=self.seed)
        for step in episodes(self.envs, policy, start, actuate=lambda torque: self.factor * late(torque)):
            followed = step.running & ~step.ended
            largest = np.where(followed, np.maximum(largest, 1e3 * step.info["tip_error"]), largest)
            largest[step.ended & ~step.completed] = CAP
        return np.minimum(largest, CAP)


@functools.lru_cache(maxsize=4)
def feasible_references(arm: ArmParameters) -> tuple[Reference, ...]:
    """Return the references of the environment's family that the arm can follow under the heaviest load."""
    kept, loaded = [], arm_constants(arm, Payload(heaviest(arm)))
    for reference in reference_family(arm):
        motion = reference.sample(np.linspace(0.0, reference.duration, 400))
        torque = rigid_inverse_dynamics(*motion, loaded) + np.array(arm.motor_inertia) * motion.ddq
        push = _LARGEST_FORCE * force_factor(arm) * np.linalg.norm(tip_jacobian(motion.q, arm.length), axis=-2)
        if np.all(np.abs(torque) + push <= _FEASIBLE * np.array(arm.torque_limit)):
            kept.append(reference)
    if not kept:
        raise ValueError("the motors are too weak for every path of the family under the heaviest load")
    return tuple(kept)


def noisy_nominal(policy: AdaptiveObserverPolicy) -> float:
    """Return the largest tip error [mm] of the nominal arm without load, with encoder noise."""
    env = gym.make("FuzzyArm-v0", disturbance=Disturbance(encoder_noise=NOISE), parameters=policy.arm)
    steps = list(episodes(env, policy, env.reset(seed=SEED)))
    return max(1e3 * float(step.info["tip_error"]) for step in steps) if steps[-1].completed else CAP


@functools.lru_cache(maxsize=1)
def objective_for(arm: ArmParameters, bandwidth: float | None = None) -> Costs:
    """Return the objective [mm] of an arm, a function of the logarithms of `BOX`; a process builds its arms once.

    It is `UNFIT` where there is no regulator for the weights. Where the filter has diverged acts the computed torque of
    this bandwidth [rad/s]; None: its default.
    """
    from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
    from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy

    random = [RandomArms(SEED, group, arm=arm) for group in GROUPS]

    def cost(logarithms: np.ndarray) -> float:
        try:
            fallback = TipPolicy(ComputedTorquePolicy(arm, PERIOD, bandwidth))
            policy = AdaptiveObserverPolicy(arm, PERIOD, weights_of(logarithms), fallback)
        except ValueError:
            return UNFIT
        errors = [arms.largest_errors(policy) for arms in random]
        return sum(float(group.mean() + TAIL * group.max()) for group in errors) + noisy_nominal(policy)

    return cost


def weights_of(logarithms: Sequence[float] | np.ndarray) -> AdaptiveWeights:
    """Return the weights of logarithms (n,) in the order of `BOX`, rounded to what says something."""
    return AdaptiveWeights(**dict(zip(BOX, rounded(np.exp(np.asarray(logarithms)), _DIGITS), strict=True)))


def logarithms_of(weights: AdaptiveWeights) -> np.ndarray:
    """Return the logarithms (n,) of weights, in the order of `BOX`."""
    return np.log([getattr(weights, name) for name in BOX])
