"""The four weights of the elastic observer: the smallest error over random plants and loads, within margins.

Objective: the mean over random arms of the rms tip error, plus the largest tip error of the nominal case with encoder
noise, both in mm. The arms follow the default reference with masses, motor inertias and stiffness within 10 % and
damping and friction within 50 % of the policy's values, an unknown payload of up to that of the case ``payload``
(Table 1: 5 kg), a tip force of up to 200 N (Table 1; scaled for other arms) in any direction from some instant of the
first half on, and encoder noise.

Constraint: on the sampled elastic arm a deviation shrinks to about a hundredth in the movement (spectral radius of at
most 0.997 for the paper's 1500 periods) in each of these conditions: loop gain as it is, x 0.67 and x 1.5, with and
without a sample of delay; half a sample of delay; joints 20 % softer or stiffer; the largest payload. The constraint is
active: more accuracy costs margin.

The shipped weights come from 64 points of the Sobol set and three runs of Nelder-Mead with 150 evaluations.
"""

import functools
import itertools
import math
from typing import Any

import gymnasium as gym
import numpy as np

from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.eval.stability._linearisation import largest_radius, linearise_path
from fuzzyarm.eval.tuning._finding import PERIOD, force_factor, heaviest, periods_of, with_stiffness
from fuzzyarm.eval.tuning._search import Context, Costs, Found, WeightSearch, rounded
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights

__all__ = ["OBSERVER_SEARCH", "find_observer"]

_LARGEST_RADIUS, _PERIODS = 0.997, 1500  # per period, over the periods of the paper's motion
_BOX = {  # the two quotients vary less along the edge of the constraint than the weights do
    "link_angle [rad]": (5e-3, 5e-2),
    "link_velocity / link_angle [1/s]": (20.0, 200.0),
    "load_walk [1/√s]": (0.01, 0.5),
    "motor_torque / load_walk [s]": (3e-3, 3e-2),
}
_DIGITS = 3  # of a weight; more would say nothing
_UNFIT = 100.0  # mm

_LANES, _SEED = 48, 1  # of the random arms
_NOISE = EncoderNoise(position=1e-5, velocity=1e-3)  # rad and rad/s
_WITHIN: dict[str, Any] = {
    **dict.fromkeys(("mass", "motor_inertia", "stiffness"), (0.9, 1.1)),
    **dict.fromkeys(("damping", "dry_friction", "viscous_friction"), (0.5, 1.5)),
}
_LARGEST_FORCE = 200.0  # N, on the arm of Table 1
# Factors on the loop gain and extra delays [samples] of the nominal arm.
_SAMPLED = ((1.0, 0.0), (0.67, 0.0), (1.5, 0.0), (1.0, 0.5), (1.0, 1.0), (0.67, 1.0), (1.5, 1.0))
_STIFFNESS = (0.8, 1.2)


def find_observer(context: Context) -> Found:
    """Return the weights of the elastic observer of a two-joint arm."""
    law = functools.partial(ElasticObserverPolicy, context.arm, PERIOD)
    return OBSERVER_SEARCH.find(context, law, functools.partial(_objective_for, context.arm))


@functools.lru_cache(maxsize=1)
def _objective_for(arm: ArmParameters) -> Costs:
    """Return the objective [mm] as a function of the logarithms (4,) of the weights in `_BOX`.

    It is `_UNFIT` or more if there are no gains, or if the loop is slower than allowed in one of the conditions.
    """
    plants, allowed, noise = _random_arms(arm), _largest_allowed(arm), Disturbance(encoder_noise=_NOISE)
    noisy = gym.make_vec("FuzzyArm-v0", num_envs=1, disturbance=noise, parameters=arm)

    def cost(logarithms: np.ndarray) -> float:
        try:
            policy = ElasticObserverPolicy(arm, PERIOD, _weights_of(logarithms))
            worst = _worst_radius(policy, arm)
        except ValueError:  # no gains, or gains so high that there is no equilibrium within the torque limits
            return 1e4
        if worst > allowed:
            return _UNFIT * worst / allowed
        rms = np.sqrt(np.mean(np.square(_tip_errors(plants, policy, _SEED)), axis=0))
        return float(min(rms.mean() + _tip_errors(noisy, policy, 0).max(), _UNFIT))

    return cost


def _largest_allowed(arm: ArmParameters) -> float:
    return float(_LARGEST_RADIUS ** (_PERIODS / periods_of(arm)))


def _worst_radius(policy: ElasticObserverPolicy, arm: ArmParameters) -> float:
    nominal = linearise_path(policy, arm, PERIOD)
    plants = [(with_stiffness(arm, factor), None) for factor in _STIFFNESS] + [(arm, Payload(heaviest(arm)))]
    others = [largest_radius(linearise_path(policy, plant, PERIOD, payload)) for plant, payload in plants]
    return max(*(largest_radius(nominal, gain, delay) for gain, delay in _SAMPLED), *others)


def _random_arms(arm: ArmParameters) -> gym.vector.VectorEnv:
    """Return the environment of the random arms under random tip forces; a reset with `_SEED` draws the arms."""
    generator, largest = np.random.default_rng(_SEED), _LARGEST_FORCE * force_factor(arm)
    latest = 0.5 * periods_of(arm) * PERIOD
    disturbances = []
    for _ in range(_LANES):
        force, angle = generator.uniform(0.0, largest), generator.uniform(-math.pi, math.pi)
        start = generator.uniform(0.0, latest)
        push = ConstantForce((force * math.cos(angle), force * math.sin(angle)), start)
        disturbances.append(Disturbance(tip_force=push, encoder_noise=_NOISE))
    plants = DomainRandomisation(**_WITHIN, payload=(0.0, heaviest(arm)))
    return gym.make_vec("FuzzyArm-v0", num_envs=_LANES, disturbance=disturbances, randomisation=plants, parameters=arm)


def _tip_errors(envs: gym.vector.VectorEnv, policy: ElasticObserverPolicy, seed: int) -> np.ndarray:
    """Return the tip errors (steps, lanes) [mm] of an episode without its last step; all inf if a lane ended early."""
    errors = []
    for step in itertools.islice(episodes(envs, policy, envs.reset(seed=seed)), periods_of(policy.parameters) - 1):
        if (step.ended & ~step.completed).any():
            return np.full((1, envs.num_envs), math.inf)
        errors.append(1e3 * step.info["tip_error"])
    return np.array(errors)


def _weights_of(logarithms: np.ndarray) -> ObserverWeights:
    """Return the rounded weights for logarithms (4,) of the quantities in `_BOX`, with the default encoder noise."""
    link_angle, link_rate, load_walk, motor_share = np.exp(logarithms)
    values = (link_angle, link_angle * link_rate, load_walk, load_walk * motor_share)
    return ObserverWeights(*rounded(values, _DIGITS))


_USUAL = ObserverWeights()
_RATE, _SHARE = _USUAL.link_velocity / _USUAL.link_angle, _USUAL.motor_torque / _USUAL.load_walk
OBSERVER_SEARCH = WeightSearch(
    usual=_USUAL,
    guess=np.log([_USUAL.link_angle, _RATE, _USUAL.load_walk, _SHARE]),
    weights_of=_weights_of,
    box=_BOX,
    seed=_SEED,
    unfit=_UNFIT,
    points=48,
    searches=2,
    evaluations=60,
    first_step=math.log(1.6),
)
"""The search of `fuzzyarm tune`."""
