"""Features and functions of learned policies, against a second writing of their equations and more digits."""

import math

import numpy as np
import pytest

from fuzzyarm import ArmParameters, robot_named
from fuzzyarm.fuzzy_policy.laws._elastic_target import ElasticTarget
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, FeatureDefinition
from fuzzyarm.fuzzy_policy.laws.learned.features import FeatureLanes, Features, guided
from fuzzyarm.fuzzy_policy.laws.learned.network import _LARGEST, add_product, area_sine, hyperbolic_tangent
from fuzzyarm.numbers.functions import Cells
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

PERIOD = 0.002
NOTHING = {"past_errors": 0, "past_actions": 0, "integral_time": 0.0}
DEFINITIONS = {
    "default": FeatureDefinition(),
    "nothing remembered": FeatureDefinition(**NOTHING),
    "three joints": FeatureDefinition(joints=3, past_errors=3, past_actions=2, integral_time=0.05),
    "actions and integral": FeatureDefinition(past_errors=0, past_actions=4, integral_time=0.05, error_scale=0.1),
    "elastic target": FeatureDefinition(elastic_target=True, past_actions=3),
    "elastic target, nothing remembered": FeatureDefinition(**NOTHING, elastic_target=True),
}
ARM = ArmParameters(torque_limit=(200.0, 90.0))  # N m, lower than some of what is commanded below


def history(n, steps=12, lanes=3):
    """Observations (steps, lanes, 5 n), actions and torques (steps, lanes, n); the motion is smooth."""
    rng = np.random.default_rng(0)
    time, phase = PERIOD * np.arange(steps)[:, np.newaxis, np.newaxis], rng.uniform(0.0, 6.0, (lanes, n))
    motion = [np.sin(5.0 * time + phase), 5.0 * np.cos(5.0 * time + phase), -25.0 * np.sin(5.0 * time + phase)]
    observations = np.concatenate([rng.normal(size=(steps, lanes, 2 * n)), *motion], axis=-1)
    return observations, rng.uniform(-1.0, 1.0, (steps, lanes, n)), 150.0 * rng.normal(size=(steps, lanes, n))


def targets(definition, observations):
    """What errors count from, (steps, lanes, 6), and u_ff, (steps, lanes, 2)."""
    if not definition.elastic_target:
        return observations[..., 2 * definition.joints :], None
    target = ElasticTarget(ARM, PERIOD)
    memory = np.zeros((observations.shape[1], target.memory_size))
    aims, feedforwards = (np.empty((*observations.shape[:2], size)) for size in (6, 2))
    for observation, aim, feedforward in zip(observations, aims, feedforwards, strict=True):
        target.advance(observation, memory, aim, feedforward)
    return aims, feedforwards


def expected(definition, observations, actions, torques, k):
    """The features at instant k, from the whole history."""
    d = definition
    aims, feedforwards = targets(d, observations)
    (q, dq, *_), (aim, speed, *_) = (np.split(x, x.shape[-1] // d.joints, axis=-1) for x in (observations, aims))
    error, rate = aim - q, speed - dq
    reference, velocity, acceleration = np.split(observations[k, :, 2 * d.joints :], 3, axis=-1)

    def before(signal, n):
        return signal[k - n] if k >= n else np.zeros_like(signal[0])

    parts = [np.arcsinh(error[k] / d.error_scale), np.arcsinh(rate[k] / d.rate_scale), reference]
    parts += [velocity / d.velocity_scale, acceleration / d.acceleration_scale]
    parts += [np.arcsinh(before(error, n) / d.error_scale) for n in range(1, d.past_errors + 1)]
    parts += [before(actions, n) for n in range(1, d.past_actions + 1)]
    if d.integral_time > 0.0:
        weights = PERIOD * np.exp(-PERIOD * np.arange(k, 0, -1) / d.integral_time)
        parts.append(np.arcsinh(np.tensordot(weights, error[:k], axes=1) / d.integral_scale))
    if d.elastic_target:
        excess = np.clip(torques, *np.outer([-1.0, 1.0], ARM.torque_limit)) - feedforwards
        parts += [before(excess, n) / d.excess_scale for n in range(1, d.past_actions + 1)]
    return np.hstack(parts)


@pytest.mark.parametrize("definition", DEFINITIONS.values(), ids=DEFINITIONS)
def test_features_are_those_of_the_equations(definition):
    observations, actions, torques = history(definition.joints)
    features = Features(definition, PERIOD, ARM if definition.joints == 2 else robot_named("planar-3r"))
    lanes, memory, held = FeatureLanes(features, guided(None)), np.zeros((3, features.memory_size)), np.empty((3, 0))
    for k in range(len(observations)):
        wanted = expected(definition, observations, actions, torques, k)
        np.testing.assert_allclose(lanes.see(observations[k], memory), wanted, rtol=1e-12, atol=1e-14)
        lanes.act(observations[k], actions[k], torques[k], memory, held)
    if definition.joints == 3:
        with pytest.raises(ValueError, match="the features are for 3 joints, but the arm has 2"):
            Features(definition, PERIOD)


def test_within_a_hold_the_last_command_counts():
    features = Features(FeatureDefinition(elastic_target=True), PERIOD, ARM)
    first, last = features.command(features.memory, (40.0, 3.0)), features.command(features.memory, (20.0, 1.0))
    assert features.command(first, (20.0, 1.0)) == last != first


def test_what_is_out_of_range_is_named():
    for kind, values, message in (
        (FeatureDefinition, {"past_errors": -1}, "past_errors = -1 is out of range; allowed: 0 to 100"),
        (FeatureDefinition, {"integral_time": math.nan}, "integral_time = nan s is .* allowed: .0, 1e.06. s"),
        (FeatureDefinition, {"error_scale": 0.0}, r"error_scale = 0.0 is out of range; allowed: \(0, inf\)"),
        (ActionDefinition, {"scale": (0.0, 1.0)}, r"scale\[0\] = 0.0 N m is out of range"),
        (ActionDefinition, {"scale": ()}, "the number of scales = 0 is out of range"),
        (ActionDefinition, {"base": "fuzzy-4"}, r"scale\[0\] = 400.0 rad is out of range; allowed: \(0, 0.5\] rad"),
        (ActionDefinition, {"smoothing_time": -1.0}, "smoothing_time = -1.0 s is out of range"),
        (ActionDefinition, {"base": ""}, "base = ''"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            kind(**values)


RANDOM = np.random.default_rng(0)


def many(function, numbers):
    return np.array([function(float(number)) for number in numbers])


@pytest.mark.parametrize(
    ("function", "exact", "largest", "error"),
    [(hyperbolic_tangent, np.tanh, 2.0, 2e-15), (area_sine, np.arcsinh, 18.0, 1e-15)],
)
def test_the_functions_are_as_exact_as_they_say(function, exact, largest, error):
    if np.finfo(np.longdouble).eps > 1e-18:
        pytest.skip("no number type with more digits on this machine")
    sizes = 10.0 ** np.concatenate([RANDOM.uniform(-12.0, 2.0, 300), RANDOM.uniform(0.0, largest, 300)])
    wanted = exact(sizes.astype(np.longdouble))
    assert np.abs((many(function, sizes) - wanted) / wanted).max() < error
    np.testing.assert_array_equal(many(function, -sizes), -many(function, sizes))
    assert function(0.0) == 0.0 and np.isnan(function(np.nan)) and function(np.inf) == function(_LARGEST)


@pytest.mark.parametrize("columns", [1, 4, 5, 12, 63])
def test_products_on_the_machine_have_the_same_bits(columns):
    transposed, x, start = RANDOM.normal(size=(columns, 7)), RANDOM.normal(size=columns), RANDOM.normal(size=7)
    plain, found = start.copy(), start.copy()[np.newaxis]

    def product(x, y, _, transposed):
        add_product(x, transposed, y)
        return x, y

    add_product(x, transposed, plain)
    kernel = Kernel(Program(product, (Cells((columns,)), Cells((7,))), (), [transposed.shape]))
    kernel((x[np.newaxis].copy(), found), np.empty(0), (transposed,))
    np.testing.assert_array_equal(found[0], plain)
    np.testing.assert_allclose(plain, start + x @ transposed, rtol=1e-13)
