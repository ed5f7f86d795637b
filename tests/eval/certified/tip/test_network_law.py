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
from fuzzyarm.eval.certified.tip.bends import ASINH, STRAIGHT, TANH, Clip
from fuzzyarm.eval.certified.tip.bound import TipClaim, find_bound
from fuzzyarm.eval.certified.tip.enclosures import BITS, NoBound
from fuzzyarm.eval.certified.tip.forms import Forms
from fuzzyarm.eval.certified.tip.network_law import BallNetwork, NetworkLaw
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
    first = 3 + policy._features.memory_size
    base = [first, first + 1] if policy.base is not None else []
    return [*range(1, 1 + past), *base]


def after(policy, law, steps):
    """Return the policy's memory after some samples near the target."""
    memory, rng = None, np.random.default_rng(3)
    for k in range(steps):
        measured = law._aims[k // 2] + rng.normal(size=4) * [1e-4, 1e-4, 0.01, 0.01]
        _, memory = policy.predict(np.concatenate([measured, REFERENCES[k]]), memory)
    return memory


@pytest.mark.parametrize("k", slow_but([6], [0, 1, 6, 7]))
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


def test_a_network_is_held_on_a_box_also_where_it_is_clipped():
    rng = np.random.default_rng(0)
    weights = rng.normal(size=(6, 3)), rng.normal(size=(2, 6))
    network = Network(np.zeros(3), np.ones(3), 0.8, weights, (rng.normal(size=6), np.array([0.2, -0.1])))
    middle, radius = np.array([0.1, 0.75, -0.2]), 0.1  # the second feature is clipped at 0.8
    there, worst = np.empty((1, 2)), np.zeros(2)
    box = Zonotope(3, 0)
    box.add(radius * np.eye(3), 0)
    forms = Forms(middle, box)
    BallNetwork(network).act(forms, np.eye(3), [arb(x) for x in middle])
    gain, rest = forms.over_base(slice(-2, None))
    for _ in range(200):
        away = radius * rng.choice([-1.0, 1.0, rng.uniform(-1.0, 1.0)], 3)
        network.act((middle + away)[np.newaxis], there)
        worst = np.maximum(worst, np.abs(there[0] - forms.middle[-2:] - gain @ away) / rest)
    assert (worst <= 1.0).all() and worst.max() > 0.3
    assert (rest < 0.5 * radius * np.abs(weights[1]) @ np.abs(weights[0]).sum(axis=1)).all()


@pytest.mark.parametrize("bend", [TANH, ASINH, Clip(0.8), STRAIGHT], ids=["tanh", "asinh", "clip", "straight"])
@pytest.mark.parametrize(("z", "r"), [(0.0, 0.5), (0.7, 0.3), (-2.0, 0.1), (0.3, 3.0), (1.5, 1e-6)])
def test_a_line_holds_the_function_and_its_rest_is_nearly_reached(bend, z, r):
    exact = {id(TANH): np.tanh, id(ASINH): np.arcsinh, id(STRAIGHT): lambda x: x}.get(id(bend))
    x = z + r * np.linspace(-1.0, 1.0, 401)
    values = np.clip(x, -0.8, 0.8) if exact is None else exact(x)
    line = bend.line(arb(z), r)
    left = np.abs(values - float(line.value.mid()) - line.slope * (x - z))
    assert left.max() <= line.rest + 1e-15
    assert left.max() >= 0.1 * line.rest or r < 1e-3


def test_the_floats_of_a_network_err_within_their_allowance(policy):
    network, rng = policy.bundle.network, np.random.default_rng(1)
    features = network.mean + network.std * rng.normal(size=(20, len(network.mean)))
    action, balls = np.empty((20, 2)), BallNetwork(network)
    network.act(features, action)
    for row, floats in zip(features, action, strict=True):
        exact, allowed = exactly(network, row), balls.rounding(np.abs(row))
        missed = [float((e - x).abs_upper()) for e, x in zip(exact, floats.tolist(), strict=True)]
        assert (np.array(missed) <= allowed).all() and allowed.max() < 1e-6


def exactly(network, features):
    """Return the action of a network, layer by layer in balls."""
    clip = network.clip
    layer = [(arb(f) - arb(m)) / arb(s) for f, m, s in zip(features, network.mean, network.std, strict=True)]
    layer = [min(max(x, arb(-clip)), arb(clip)) for x in layer]
    for number, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        layer = [
            sum((arb(float(w)) * h for w, h in zip(row, layer, strict=True)), arb(float(offset)))
            for row, offset in zip(weight, bias, strict=True)
        ]
        layer = [x.tanh() if number < len(network.weights) - 1 else min(max(x, arb(-1)), arb(1)) for x in layer]
    return layer


def test_learned_policies_have_a_tube():
    bound = find_bound(TipClaim("ppo-residual", "nominal", "table-1", SETS["table-1"], steps=8))
    assert bound.largest < 1e-5
    with pytest.raises(NoBound, match="no bound beyond t = 0"):
        find_bound(TipClaim("ppo-residual", "nominal", "near", SETS["near"], steps=20))


@pytest.mark.parametrize("kind", [{"activation": "relu"}, {"output": "tanh"}])
def test_layers_of_another_kind_have_no_bound(kind):
    made = bundle()
    policy = LearnedPolicy(dataclasses.replace(made, network=dataclasses.replace(made.network, **kind)))
    with pytest.raises(NoBound, match="there is no bound for layers of"):
        sampled_law(policy, REFERENCES)
