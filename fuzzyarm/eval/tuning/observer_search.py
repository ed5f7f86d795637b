"""The four weights of the elastic observer: the smallest error over random plants and loads, within margins.

Objective: the mean over random arms of the rms tip error, plus the largest tip error of the nominal case with encoder
noise, both in mm. The arms follow the default reference with masses, motor inertias and stiffness within 10 % and
damping and friction within 50 % of what the policy knows, an unknown payload of up to the arm's (Table 1: 5 kg), an
unknown tip force of up to the arm's (200 N) in any direction from some instant of the first half on, and encoder noise.
The cases with loads play no part.

Constraint: in each of the conditions of `radii` the spectral radius is at most that with which a deviation shrinks to a
hundredth in the movement: 0.997 for the 1500 periods of the paper's. It is active: more accuracy costs margin.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.eval.stability.linearisation import LocalLoop, largest_radius, linearise_path
from fuzzyarm.eval.tuning.finding import PERIOD, PERIODS, force_factor, heaviest, periods_of, with_stiffness
from fuzzyarm.eval.tuning.search import Budget, Costs, rounded
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights

__all__ = [
    "BOX", "FIRST_STEP", "FULL", "NOISE", "SEED", "SHORT", "UNFIT", "follow", "largest_allowed", "logarithms_of",
    "objective_for", "radii", "random_arms", "rms", "weights_of",
]  # fmt: skip

_LARGEST_RADIUS = 0.997  # per period, over `PERIODS` periods
BOX = {
    "link_angle [rad]": (5e-3, 5e-2),
    "link_velocity / link_angle [1/s]": (20.0, 200.0),
    "load_walk [1/√s]": (0.01, 0.5),
    "motor_torque / load_walk [s]": (3e-3, 3e-2),
}
"""Where the Sobol set lies; Nelder-Mead may leave it. The two quotients vary less along the edge of the constraint."""
FULL = Budget(sobol=64, searches=3, evaluations=150)
"""The search that chose the shipped weights."""
SHORT = Budget(sobol=48, searches=2, evaluations=60)
"""The search of `fuzzyarm tune`."""
FIRST_STEP = math.log(1.6)  # of Nelder-Mead, in the logarithm of a weight
_DIGITS = 3  # of a weight; a finer one says nothing
UNFIT = 100.0
"""Costs [mm] from this on are of weights that do not meet the constraint."""

_LANES, SEED = 48, 1  # of the arms that are tuned on
NOISE = EncoderNoise(position=1e-5, velocity=1e-3)  # rad and rad/s
_WITHIN: dict[str, Any] = {
    **dict.fromkeys(("mass", "motor_inertia", "stiffness"), (0.9, 1.1)),
    **dict.fromkeys(("damping", "dry_friction", "viscous_friction"), (0.5, 1.5)),
}
_LARGEST_FORCE = 200.0  # N, on the arm of Table 1

_STIFFNESS = {"stiffness x0.8": 0.8, "stiffness x1.2": 1.2}
_SAMPLED = {  # factor on the loop gain and extra delay [samples], on the nominal arm
    "nominal": (1.0, 0.0),
    "loop gain x0.67": (0.67, 0.0),
    "loop gain x1.5": (1.5, 0.0),
    "half a sample later": (1.0, 0.5),
    "one sample later": (1.0, 1.0),
    "loop gain x0.67, one sample later": (0.67, 1.0),
    "loop gain x1.5, one sample later": (1.5, 1.0),
}


def largest_allowed(arm: ArmParameters) -> float:
    """Return the largest spectral radius that the constraint allows for an arm."""
    return float(_LARGEST_RADIUS ** (PERIODS / periods_of(arm)))


def radii(policy: ElasticObserverPolicy, arm: ArmParameters, nominal: list[LocalLoop]) -> dict[str, float]:
    """Return the spectral radius by condition; `nominal` are the policy's loops on its own arm."""
    found = {name: largest_radius(nominal, gain, delay) for name, (gain, delay) in _SAMPLED.items()}
    for name, factor in _STIFFNESS.items():
        found[name] = largest_radius(linearise_path(policy, with_stiffness(arm, factor), PERIOD))
    mass = heaviest(arm)
    found[f"{mass:g} kg payload"] = largest_radius(linearise_path(policy, arm, PERIOD, Payload(mass)))
    return found


def random_arms(arm: ArmParameters, seed: int) -> gym.vector.VectorEnv:
    """Return arms with random tip forces; the plants are drawn by a reset with the same seed."""
    generator, largest = np.random.default_rng(seed), _LARGEST_FORCE * force_factor(arm)
    latest = 0.5 * periods_of(arm) * PERIOD
    disturbances = []
    for _ in range(_LANES):
        force, angle = generator.uniform(0.0, largest), generator.uniform(-math.pi, math.pi)
        start = generator.uniform(0.0, latest)
        push = ConstantForce((force * math.cos(angle), force * math.sin(angle)), start)
        disturbances.append(Disturbance(tip_force=push, encoder_noise=NOISE))
    plants = DomainRandomisation(**_WITHIN, payload=(0.0, heaviest(arm)))
    return gym.make_vec("FuzzyArm-v0", num_envs=_LANES, disturbance=disturbances, randomisation=plants, parameters=arm)


def follow(envs: gym.vector.VectorEnv, policy: ElasticObserverPolicy, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return tip errors [mm] (steps, lanes) and torques [N m] (steps, lanes, 2); inf after an episode ended early."""
    errors, torques, steps = [], [], periods_of(policy.parameters) - 1  # of an episode, without its last
    for step in itertools.islice(episodes(envs, policy, envs.reset(seed=seed)), steps):
        if (step.ended & ~step.completed).any():
            return np.full((1, envs.num_envs), math.inf), step.info["torque"][np.newaxis]
        errors.append(1e3 * step.info["tip_error"])
        torques.append(step.info["torque"])
    return np.array(errors), np.array(torques)


def rms(error: np.ndarray) -> np.ndarray:
    """Return the root mean square over time (lanes,)."""
    return np.asarray(np.sqrt(np.mean(np.square(error), axis=0)))


@functools.lru_cache(maxsize=1)
def objective_for(arm: ArmParameters) -> Costs:
    """Return the objective [mm] of an arm, a function of the logarithms of `BOX`; a process builds its arms once.

    It is `UNFIT` or more where a condition is not met.
    """
    plants, allowed, noise = random_arms(arm, SEED), largest_allowed(arm), Disturbance(encoder_noise=NOISE)
    noisy = gym.make_vec("FuzzyArm-v0", num_envs=1, disturbance=noise, parameters=arm)

    def cost(logarithms: np.ndarray) -> float:
        try:
            policy = ElasticObserverPolicy(arm, PERIOD, weights_of(logarithms))
            worst = max(radii(policy, arm, linearise_path(policy, arm, PERIOD)).values())
        except ValueError:  # gains so high that margins finds no equilibrium within the torque limits, or no gains
            return 1e4
        if worst > allowed:
            return UNFIT * worst / allowed
        random, nominal = follow(plants, policy, SEED)[0], follow(noisy, policy)[0]
        return float(min(rms(random).mean() + nominal.max(), UNFIT))

    return cost


def weights_of(logarithms: Sequence[float] | np.ndarray) -> ObserverWeights:
    """Return the weights of logarithms (4,) of `BOX`, rounded; the encoder's are those of `ObserverWeights`."""
    link_angle, link_rate, load_walk, motor_share = np.exp(np.asarray(logarithms))
    values = (link_angle, link_angle * link_rate, load_walk, load_walk * motor_share)
    return ObserverWeights(*rounded(values, _DIGITS))


def logarithms_of(weights: ObserverWeights) -> np.ndarray:
    """Return the logarithms (4,) of what `BOX` bounds, of weights."""
    w = weights
    return np.log([w.link_angle, w.link_velocity / w.link_angle, w.load_walk, w.motor_torque / w.load_walk])
