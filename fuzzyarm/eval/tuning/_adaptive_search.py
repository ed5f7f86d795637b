"""The weights of the adaptive observer: the smallest sum of the largest errors, each capped, over random arms.

Objective [mm]: an arm's value is its largest tip error, or `_CAP` if this is larger or the episode ends early. The mean
over the arms of a group plus `_TAIL` times the value of the worst arm is summed over the groups in `_GROUPS`, and
the largest tip error of the nominal arm without load and with encoder noise is added. The random arms follow random
circles, lemniscates and lines that take at most 95 % of the torque limits under the heaviest load. They carry at most
the payload of the case ``payload`` (Table 1: 5 kg). Half of them are under a force in a random direction from a random
instant on, the other half under a force against the direction of travel, both of up to 250 N (Table 1; scaled for other
arms). The first group has the known arm. The second has masses and motor inertias within 10 % of the known ones,
stiffness within 20 %, damping and friction within 50 %, torque constants within 10 %. The third adds encoder noise of
up to twice `_NOISE`, and delays of the commands of up to two periods.

The weights of `_BOX` are searched for. The others are fixed: they state prior knowledge or the confidence of a test
(the dead zone: four standard deviations).

The policy tolerates a changed loop only because it adapts: with frozen adaptation it is unstable if the loop gain is a
few per cent off. The search therefore has no constraint on margins.

The shipped weights come from the points of `ADAPTIVE_SEARCH` and two runs of Nelder-Mead with 24 evaluations, one from
the best point and one from the first guess.
"""

import dataclasses
import functools
import math
from collections.abc import Callable

import gymnasium as gym
import numpy as np

from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, rigid_inverse_dynamics, tip_jacobian
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.default_reference import reference_family
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise, MachiningForce
from fuzzyarm.envs.scenario.randomisation import find_randomisation
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.eval.sweep._episodes import Delay
from fuzzyarm.eval.tuning._finding import PERIOD, force_factor, heaviest
from fuzzyarm.eval.tuning._search import Context, Costs, Found, WeightSearch, nothing, rounded
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.policies.registry import COMPUTED_TORQUE

__all__ = ["ADAPTIVE_SEARCH", "find_adaptive"]

_BOX = {
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
_DIGITS = 2  # of a weight
_LANES, _SEED = 40, 11  # of the random arms of each group
# The largest value [mm] of an arm's error in the objective, also its value if the episode ends early. The cap keeps a
# single arm with large errors from dominating. It does not define a lost path, see `metrics.is_lost`.
_CAP = 50.0
_UNFIT = math.inf  # cost of weights for which there is no regulator
_TAIL = 0.1  # weight of the worst arm; the mean has weight 1
_FEASIBLE = 0.95  # of the torque limits
_LARGEST_FORCE, _LATEST_ONSET = 250.0, 0.5  # N, on the arm of Table 1; s
_LONGEST_DELAY, _TORQUE_CONSTANT = 2, 0.1  # periods; share
# By name: whether arms differ from the known one, and whether their commands are delayed and their encoders noisy.
_GROUPS = {"known": (0, 0), "unknown": (1, 0), "unknown, delayed and noisy": (1, 1)}
_NOISE = EncoderNoise(position=1e-5, velocity=1e-3)  # rad, rad/s
_NOTE = (
    "Its margins are those of the loop with its adaptation frozen, which does not react to the changed condition. The "
    "policy copes with other loops by adapting to them, which is tried on random arms and not measured by a margin."
)


def find_adaptive(context: Context) -> Found:
    """Return the weights found for the adaptive observer of a two-joint arm, or the reason why there are none."""
    arm: ArmParameters = context.arm
    lawful = context.earlier.get(COMPUTED_TORQUE)
    omega = None if lawful is None or lawful.chosen is None else lawful.chosen["bandwidth"]
    try:
        _feasible_references(arm)
    except ValueError as error:
        return nothing(f"It was not tuned: {error}.", 0)
    law, objective = functools.partial(_policy, arm, omega), functools.partial(_objective_for, arm, omega)
    return ADAPTIVE_SEARCH.find(context, law, objective, (_NOTE,))


def _policy(arm: ArmParameters, bandwidth: float | None, weights: AdaptiveWeights) -> AdaptiveObserverPolicy:
    """Return the policy; if its filter diverges, computed torque of this bandwidth [rad/s] (None: default) acts."""
    return AdaptiveObserverPolicy(arm, PERIOD, weights, TipPolicy(ComputedTorquePolicy(arm, PERIOD, bandwidth)))


@functools.lru_cache(maxsize=1)
def _objective_for(arm: ArmParameters, bandwidth: float | None) -> Costs:
    """Return the objective [mm] as a function of the logarithms (9,) of weights, see `_BOX`.

    It is `_UNFIT` if there is no regulator for the weights. `bandwidth` [rad/s] is passed to `_policy`.
    """
    groups = [_random_arms(group, arm) for group in _GROUPS]

    def cost(logarithms: np.ndarray) -> float:
        try:
            policy = _policy(arm, bandwidth, _weights_of(logarithms))
        except ValueError:
            return _UNFIT
        errors = [largest_errors(policy) for largest_errors in groups]
        return sum(float(group.mean() + _TAIL * group.max()) for group in errors) + _noisy_nominal(policy)

    return cost


def _random_arms(group: str, arm: ArmParameters) -> Callable[[AdaptiveObserverPolicy], np.ndarray]:
    """Return a function from a policy to the largest tip error [mm] on each random arm, (lanes,), at most `_CAP`.

    The arms and their loads are those of a group in `_GROUPS`, the same in every call. `arm` is the arm that the policy
    knows.
    """
    unknown, late = _GROUPS[group]
    generator, disturbances = np.random.default_rng((_SEED, list(_GROUPS).index(group))), []
    largest_force = _LARGEST_FORCE * force_factor(arm)
    for lane in range(_LANES):
        size, angle = generator.uniform(0.0, largest_force), generator.uniform(-math.pi, math.pi)
        start, fade = generator.uniform(0.0, _LATEST_ONSET), generator.uniform(0.005, 0.05)
        factor = late * generator.uniform(0.0, 2.0)
        noise = EncoderNoise(factor * _NOISE.position, factor * _NOISE.velocity)
        push = ConstantForce((size * math.cos(angle), size * math.sin(angle)), start)
        drag = MachiningForce(base=size, swing=0.0, fade_speed=fade)
        disturbances.append(Disturbance(tip_force=push if lane % 2 else drag, encoder_noise=noise))
    plants = find_randomisation("plants" if unknown else "nominal", arm)
    drawn = dataclasses.replace(plants, payload=(0.0, heaviest(arm)), references=_feasible_references(arm))
    envs = gym.make_vec("FuzzyArm-v0", num_envs=_LANES, disturbance=disturbances, randomisation=drawn, parameters=arm)
    delay = late * generator.integers(0, _LONGEST_DELAY + 1, _LANES)
    torque_constant = 1.0 + unknown * generator.uniform(-_TORQUE_CONSTANT, _TORQUE_CONSTANT, _LANES)[:, np.newaxis]

    def largest_errors(policy: AdaptiveObserverPolicy) -> np.ndarray:
        delayed, largest = Delay(delay, policy.joints), np.zeros(_LANES)
        start = envs.reset(seed=_SEED)
        for step in episodes(envs, policy, start, actuate=lambda torque: torque_constant * delayed(torque)):
            followed = step.running & ~step.ended
            largest = np.where(followed, np.maximum(largest, 1e3 * step.info["tip_error"]), largest)
            largest[step.ended & ~step.completed] = _CAP
        return np.minimum(largest, _CAP)

    return largest_errors


@functools.lru_cache(maxsize=4)
def _feasible_references(arm: ArmParameters) -> tuple[Reference, ...]:
    """Return the references of the environment's family that the arm can follow under the heaviest load."""
    kept, loaded = [], arm_constants(arm, Payload(heaviest(arm)))
    for reference in reference_family(arm):
        motion = reference.sample(np.linspace(0.0, reference.duration, 400))
        torque = rigid_inverse_dynamics(*motion, loaded) + np.array(arm.motor_inertia) * motion.ddq
        push = _LARGEST_FORCE * force_factor(arm) * np.linalg.norm(tip_jacobian(motion.q, arm.length), axis=-2)
        if np.all(np.abs(torque) + push <= _FEASIBLE * np.array(arm.torque_limit)):
            kept.append(reference)
    if not kept:
        raise ValueError(
            "the motors are too weak to carry the heaviest load along any of the reference paths; raise torque_limit"
        )
    return tuple(kept)


def _noisy_nominal(policy: AdaptiveObserverPolicy) -> float:
    """Return the largest tip error [mm] of the nominal arm with noise but no load; `_CAP` if the episode ends early."""
    env = gym.make("FuzzyArm-v0", disturbance=Disturbance(encoder_noise=_NOISE), parameters=policy.arm)
    steps = list(episodes(env, policy, env.reset(seed=_SEED)))
    return max(1e3 * float(step.info["tip_error"]) for step in steps) if steps[-1].completed else _CAP


def _weights_of(logarithms: np.ndarray) -> AdaptiveWeights:
    return AdaptiveWeights(**dict(zip(_BOX, rounded(np.exp(logarithms), _DIGITS), strict=True)))


ADAPTIVE_SEARCH = WeightSearch(
    usual=AdaptiveWeights(),
    guess=np.log([getattr(AdaptiveWeights(), name) for name in _BOX]),
    weights_of=_weights_of,
    box=_BOX,
    seed=_SEED,
    unfit=_UNFIT,
    points=8,
)
"""The search of `fuzzyarm tune`."""
