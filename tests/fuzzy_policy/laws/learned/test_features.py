"""The features against a second writing of their equations, lane by lane and sample by sample."""

import math

import numpy as np
import pytest

from fuzzyarm.envs.observation import JOINTS, Observation
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws import elastic_target
from fuzzyarm.fuzzy_policy.laws.learned.definition import FeatureDefinition
from fuzzyarm.fuzzy_policy.laws.learned.features import Features, Lanes

PERIOD = 0.002
DEFINITIONS = {
    "default": FeatureDefinition(),
    "nothing remembered": FeatureDefinition(past_errors=0, past_actions=0, integral_time=0.0),
    "errors only": FeatureDefinition(past_errors=3, past_actions=0, integral_time=0.0),
    "actions and integral": FeatureDefinition(past_errors=0, past_actions=4, integral_time=0.05, error_scale=0.1),
    "elastic target": FeatureDefinition(elastic_target=True, past_actions=3),
    "elastic target, nothing remembered": FeatureDefinition(
        past_errors=0, past_actions=0, integral_time=0.0, elastic_target=True
    ),
}
LIMIT = np.array([200.0, 90.0])  # N m, lower than some of what is commanded below
ARM = ArmParameters(torque_limit=tuple(LIMIT))


def history(steps=12, lanes=3, seed=0):
    """Observations (steps, lanes, 10), actions (steps, lanes, 2), torques (steps, lanes, 2); the motion is smooth."""
    rng = np.random.default_rng(seed)
    time, phase = PERIOD * np.arange(steps)[:, np.newaxis, np.newaxis], rng.uniform(0.0, 6.0, (lanes, 2))
    motion = [np.sin(5.0 * time + phase), 5.0 * np.cos(5.0 * time + phase), -25.0 * np.sin(5.0 * time + phase)]
    observations = np.concatenate([rng.normal(size=(steps, lanes, 4)), *motion], axis=-1)
    return observations, rng.uniform(-1.0, 1.0, (steps, lanes, 2)), 150.0 * rng.normal(size=(steps, lanes, 2))


def targets(definition, observations):
    """What errors count from, (steps, lanes, 6), and u_ff, (steps, lanes, 2)."""
    if not definition.elastic_target:
        return observations[..., 4:], None
    target = elastic_target.ElasticTarget(ARM, PERIOD)
    memory = np.zeros((observations.shape[1], elastic_target.memory_size(2)))
    aims, feedforwards = np.empty((*observations.shape[:2], 6)), np.empty((*observations.shape[:2], 2))
    for observation, aim, feedforward in zip(observations, aims, feedforwards, strict=True):
        target.advance(observation, memory, aim, feedforward)
    return aims, feedforwards


def expected(definition, observations, actions, torques, k):
    """The features at instant k, from the whole history."""
    d = definition
    aims, feedforwards = targets(d, observations)
    error, rate = (aims[..., i : 2 + i] - observations[..., i : 2 + i] for i in (0, 2))
    reference, velocity, acceleration = (observations[k, :, i : i + 2] for i in (4, 6, 8))

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
    observations, actions, torques = history()
    features = Features(definition, PERIOD, ARM)
    lanes, memory, held = Lanes(features), np.zeros((3, features.memory_size)), np.empty((3, 0))
    for k in range(len(observations)):
        shown = lanes.see(observations[k], memory, held)
        wanted = expected(definition, observations, actions, torques, k)
        np.testing.assert_allclose(shown, wanted, rtol=1e-12, atol=1e-14)
        lanes.act(observations[k], actions[k], torques[k], memory, held)


def test_within_a_hold_the_last_command_counts():
    features = Features(FeatureDefinition(elastic_target=True), PERIOD, ARM)
    first, last = features.command(features.memory, (40.0, 3.0)), features.command(features.memory, (20.0, 1.0))
    assert features.command(first, (20.0, 1.0)) == last != first


def test_a_constant_error_fills_the_leaky_integral_to_its_limit():
    definition = FeatureDefinition(integral_time=0.02)
    features = Features(definition, PERIOD)
    lanes, memory, nothing = Lanes(features), np.zeros((1, features.memory_size)), np.zeros((1, 2))
    observation = np.zeros((1, 10))
    observation[0, 4] = 0.003
    for _ in range(2000):
        lanes.act(observation, nothing, nothing, memory, np.empty((1, 0)))
    leak = math.exp(-PERIOD / 0.02)
    assert memory[0, -2] == pytest.approx(0.003 * PERIOD * leak / (1.0 - leak), rel=1e-12)
    assert memory[0, -1] == 0.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"past_errors": -1}, "past_errors = -1 is out of range; allowed: 0 to 100"),
        ({"past_actions": True}, "past_actions = True"),
        ({"integral_time": math.nan}, r"integral_time = nan s is out of range; allowed: \[0, 1e\+06\] s"),
        ({"elastic_target": 1}, "elastic_target = 1 must be True or False"),
        ({"error_scale": 0.0}, r"error_scale = 0.0 is out of range; allowed: \(0, inf\)"),
    ],
)
def test_what_is_out_of_range_is_named(values, message):
    with pytest.raises((TypeError, ValueError), match=message):
        FeatureDefinition(**values)


def test_the_definition_counts_the_joints_of_the_observation():
    """It has a number of its own, because the module of the observation loads more than a definition needs."""
    assert FeatureDefinition(past_errors=0, past_actions=0, integral_time=0.0).size == JOINTS * len(Observation._fields)
