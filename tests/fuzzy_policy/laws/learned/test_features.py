"""The features against a second writing of their equations, lane by lane and sample by sample."""

import math

import numpy as np
import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.fuzzy_policy.laws import _elastic_target as elastic_target
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, FeatureDefinition
from fuzzyarm.fuzzy_policy.laws.learned.features import FeatureLanes, Features, guided

PERIOD = 0.002
DEFINITIONS = {
    "default": FeatureDefinition(),
    "nothing remembered": FeatureDefinition(past_errors=0, past_actions=0, integral_time=0.0),
    "three joints": FeatureDefinition(joints=3, past_errors=3, past_actions=2, integral_time=0.05),
    "actions and integral": FeatureDefinition(past_errors=0, past_actions=4, integral_time=0.05, error_scale=0.1),
    "elastic target": FeatureDefinition(elastic_target=True, past_actions=3),
    "elastic target, nothing remembered": FeatureDefinition(
        past_errors=0, past_actions=0, integral_time=0.0, elastic_target=True
    ),
}
LIMIT = np.array([200.0, 90.0])  # N m, lower than some of what is commanded below
ARM = ArmParameters(torque_limit=tuple(LIMIT))


def history(n, steps=12, lanes=3, seed=0):
    """Observations (steps, lanes, 5 n), actions and torques (steps, lanes, n); the motion is smooth."""
    rng = np.random.default_rng(seed)
    time, phase = PERIOD * np.arange(steps)[:, np.newaxis, np.newaxis], rng.uniform(0.0, 6.0, (lanes, n))
    motion = [np.sin(5.0 * time + phase), 5.0 * np.cos(5.0 * time + phase), -25.0 * np.sin(5.0 * time + phase)]
    observations = np.concatenate([rng.normal(size=(steps, lanes, 2 * n)), *motion], axis=-1)
    return observations, rng.uniform(-1.0, 1.0, (steps, lanes, n)), 150.0 * rng.normal(size=(steps, lanes, n))


def targets(definition, observations):
    """What errors count from, (steps, lanes, 6), and u_ff, (steps, lanes, 2)."""
    if not definition.elastic_target:
        return observations[..., 2 * definition.joints :], None
    target = elastic_target.ElasticTarget(ARM, PERIOD)
    memory = np.zeros((observations.shape[1], target.memory_size))
    aims, feedforwards = np.empty((*observations.shape[:2], 6)), np.empty((*observations.shape[:2], 2))
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
        ages = PERIOD * np.arange(k, 0, -1)
        weights = PERIOD * np.exp(-ages / d.integral_time)
        parts.append(np.arcsinh(np.tensordot(weights, error[:k], axes=1) / d.integral_scale))
    if d.elastic_target:
        excess = np.clip(torques, -LIMIT, LIMIT) - feedforwards
        parts += [before(excess, n) / d.excess_scale for n in range(1, d.past_actions + 1)]
    return np.hstack(parts)


@pytest.mark.parametrize("definition", DEFINITIONS.values(), ids=DEFINITIONS)
def test_features_are_those_of_the_equations(definition):
    observations, actions, torques = history(definition.joints)
    features = Features(definition, PERIOD, ARM if definition.joints == 2 else robot_named("planar-3r"))
    lanes, memory, held = FeatureLanes(features, guided(None)), np.zeros((3, features.memory_size)), np.empty((3, 0))
    for k in range(len(observations)):
        shown = lanes.see(observations[k], memory)
        wanted = expected(definition, observations, actions, torques, k)
        np.testing.assert_allclose(shown, wanted, rtol=1e-12, atol=1e-14)
        lanes.act(observations[k], actions[k], torques[k], memory, held)
    if definition.joints == 3:
        with pytest.raises(ValueError, match="the features are for 3 joints, but the arm has 2"):
            Features(definition, PERIOD)


def test_within_a_hold_the_last_command_counts():
    features = Features(FeatureDefinition(elastic_target=True), PERIOD, ARM)
    first, last = features.command(features.memory, (40.0, 3.0)), features.command(features.memory, (20.0, 1.0))
    assert features.command(first, (20.0, 1.0)) == last != first


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (FeatureDefinition, {"past_errors": -1}, "past_errors = -1 is out of range; allowed: 0 to 100"),
        (
            FeatureDefinition,
            {"integral_time": math.nan},
            "integral_time = nan s is out of range; allowed: .0, 1e.06. s",
        ),
        (FeatureDefinition, {"error_scale": 0.0}, r"error_scale = 0.0 is out of range; allowed: \(0, inf\)"),
        (ActionDefinition, {"scale": (0.0, 1.0)}, r"scale\[0\] = 0.0 N m is out of range"),
        (ActionDefinition, {"scale": ()}, "the number of scales = 0 is out of range"),
        (ActionDefinition, {"base": "fuzzy-4"}, r"scale\[0\] = 400.0 rad is out of range; allowed: \(0, 0.5\] rad"),
        (ActionDefinition, {"smoothing_time": -1.0}, "smoothing_time = -1.0 s is out of range"),
        (ActionDefinition, {"base": ""}, "base = ''"),
    ],
)
def test_what_is_out_of_range_is_named(kind, values, message):
    with pytest.raises((TypeError, ValueError), match=message):
        kind(**values)
