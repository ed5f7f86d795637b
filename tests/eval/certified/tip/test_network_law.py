"""Learned policies on balls: every answer of the policy near a point lies in what is said of all of them."""

import dataclasses

import numpy as np
import pytest
from flint import arb, ctx
from slow_twins import slow_but
from support.bundles import bundle

from fuzzyarm import load_policy
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.certified.tip.bound import TipClaim, find_bound
from fuzzyarm.eval.certified.tip.enclosures import BITS, NoBound
from fuzzyarm.eval.certified.tip.network_law import BallNetwork, NetworkLaw, _clipped
from fuzzyarm.eval.certified.tip.plant_set import SETS
from fuzzyarm.eval.certified.tip.sampled_law import sampled_law
from fuzzyarm.eval.certified.tip.zonotope import Zonotope
from fuzzyarm.learned_policy.network import Network
from fuzzyarm.learned_policy.policy import LearnedPolicy

REFERENCES = Schedule.build(JointReference(), Disturbance(), 1e-3, 2).references[:301]


@pytest.fixture(autouse=True)
def precision():
    with ctx.workprec(BITS):
        yield


@pytest.fixture(scope="module", params=slow_but(["ppo-residual"], ["ppo-residual", "ppo-nominal"]))
def policy(request):
    return load_policy(request.param)


def remembered(policy):
    """Return where the numbers that a `NetworkLaw` remembers lie in the policy's memory."""
    d = policy.bundle.features
    past = 2 * (1 + d.past_errors + d.past_actions + 1 + d.past_excesses)
    base = [policy._base_memory, policy._base_memory + 1] if policy.base is not None else []
    return [*range(1, 1 + past), *base]


def after(policy, law, steps):
    """Return the policy's memory after some samples near the target."""
    memory, rng = None, np.random.default_rng(3)
    for k in range(steps):
        measured = law._aims[k // 2] + rng.normal(size=4) * [1e-4, 1e-4, 0.01, 0.01]
        _, memory = policy.predict(np.concatenate([measured, REFERENCES[k]]), memory)
    return memory


@pytest.mark.parametrize("k", [0, 1, 6, 7])
def test_at_a_point_it_is_the_policy(policy, k):
    law = NetworkLaw(policy, REFERENCES)
    memory, where = after(policy, law, k), remembered(policy)
    point = np.concatenate([law._aims[k // 2] + 1e-4, np.zeros(len(where)) if memory is None else memory[where]])
    assert law.memory == len(where)
    found = law.respond(k, point, Zonotope(len(point), 0))
    torque, memory = policy.predict(np.concatenate([point[:4], REFERENCES[k]]), memory)
    allowed = np.abs(found.columns).sum(axis=1) + found.box
    assert (np.abs(found.middle - np.concatenate([torque, memory[where]])) <= allowed).all()
    assert allowed.max() < 1e-8


@pytest.mark.parametrize(("k", "size"), [(6, 1e-2), (6, 1e-4), (7, 1.0)])
def test_every_answer_near_the_point_is_held_and_what_is_not_linear_is_needed(policy, k, size):
    """At an even sample the network acts, at an odd one its action is held."""
    law, where, rng = NetworkLaw(policy, REFERENCES), remembered(policy), np.random.default_rng(k)
    memory = after(policy, law, k)
    point = np.concatenate([law._aims[k // 2] + 1e-4, memory[where]])
    units = np.repeat([1e-5, 1e-3, 1e-2, 1e-2, 1e-7], [2, 2, 2, len(where) - 4, 2])
    units[law._at.errors], units[law._at.integral] = 1e-5, 1e-7
    seen = Zonotope(len(point), 0)
    seen.add(np.diag(size * units), 0)
    found, worst = law.respond(k, point, seen), np.zeros(2 + len(where))
    given, own = np.split(found.columns, [len(point)], axis=1)
    rest = np.abs(own).sum(axis=1) + found.box
    for _ in range(30):
        g = rng.choice([-1.0, 1.0], len(point)) * rng.uniform(0.5, 1.0, len(point))
        other, state = point + seen.columns @ g, memory.copy()
        state[where] = other[4:]
        torque, state = policy.predict(np.concatenate([other[:4], REFERENCES[k]]), state)
        exact = np.concatenate([torque, state[where]])
        worst = np.maximum(worst, np.abs(exact - found.middle - given @ g) / np.maximum(rest, 1e-14))
    assert (worst <= 1.0).all()
    assert k == 7 or worst[:2].max() > 1e-5
    assert (rest[:2] < 400.0 * size * np.abs(given[:2]).sum(axis=1)).all()


def test_derivatives_of_a_network_hold_every_secant_also_where_it_is_clipped():
    rng = np.random.default_rng(0)
    weights = rng.normal(size=(6, 3)), rng.normal(size=(2, 6))
    network = Network(np.zeros(3), np.ones(3), 0.8, weights, (rng.normal(size=6), np.array([0.2, -0.1])))
    middle, radius = np.array([0.1, 0.75, -0.2]), 0.1  # the second feature is clipped at 0.8
    balls = BallNetwork(network)
    value, slopes = balls.output([arb(x, radius) for x in middle])
    here, there = np.empty((1, 2)), np.empty((1, 2))
    network.act(middle[np.newaxis], here)
    inside = [[arb(x) for x in row] for row in slopes.tolist()]
    assert all(
        x.overlaps(arb(y, 1e-12)) for x, y in zip(balls.output([arb(x) for x in middle])[0], here[0], strict=True)
    )
    for _ in range(50):
        away = radius * rng.uniform(-1.0, 1.0, 3)
        network.act((middle + away)[np.newaxis], there)
        for i in range(2):
            assert value[i].contains(arb(there[0, i]))
            secant = sum((s * a for s, a in zip(inside[i], away.tolist(), strict=True)), arb(0))
            assert secant.overlaps(arb(there[0, i] - here[0, i], 1e-12))


def test_the_floats_of_a_network_err_within_their_allowance(policy):
    network, rng = policy.bundle.network, np.random.default_rng(1)
    features = network.mean + network.std * rng.normal(size=(20, len(network.mean)))
    action, balls = np.empty((20, 2)), BallNetwork(network)
    network.act(features, action)
    for row, floats in zip(features, action, strict=True):
        exact, allowed = balls.output([arb(x) for x in row.tolist()])[0], balls.rounding(np.abs(row))
        missed = [float((e - x).abs_upper()) for e, x in zip(exact, floats.tolist(), strict=True)]
        assert (np.array(missed) <= allowed).all() and allowed.max() < 1e-6


def test_a_clip_is_the_number_the_limit_or_both():
    assert [float(x.mid()) for x in _clipped(arb(0.5, 0.1), 1.0)] == [0.5, 1.0]
    assert [float(x.mid()) for x in _clipped(arb(-3.0, 0.1), 1.0)] == [-1.0, 0.0]
    value, rate = _clipped(arb(0.95, 0.1), 1.0)
    assert value.contains(arb(0.86)) and value.contains(arb(1.0)) and not value.contains(arb(1.1))
    assert rate.contains(arb(0)) and rate.contains(arb(1))


def test_learned_policies_have_a_tube():
    bound = find_bound(TipClaim("ppo-residual", "nominal", "table-1", SETS["table-1"], steps=8))
    assert bound.largest < 1e-5
    with pytest.raises(NoBound, match="no bound beyond t = 0"):
        find_bound(TipClaim("ppo-robust", "nominal", "near", SETS["near"], steps=20))


@pytest.mark.parametrize("kind", [{"activation": "relu"}, {"output": "tanh"}])
def test_layers_of_another_kind_have_no_bound(kind):
    made = bundle()
    policy = LearnedPolicy(dataclasses.replace(made, network=dataclasses.replace(made.network, **kind)))
    with pytest.raises(NoBound, match="there is no bound for layers of"):
        sampled_law(policy, REFERENCES)
