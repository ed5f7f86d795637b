"""Every policy's law on affine numbers: its answers at all points of a zonotope lie in what is said of them."""

import dataclasses
import functools

import numpy as np
import pytest
from slow_twins import slow_but
from support.bundles import bundle

from fuzzyarm import load_policy
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.law import Law, LawPolicy
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy
from fuzzyarm.numbers.functions import floor, select
from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.plant import SETS
from fuzzyarm.proof.tip.sampled_law import SampledLaw
from fuzzyarm.proof.tip.zonotope import Zonotope

REFERENCES = Schedule.build(JointReference(), Disturbance(), 1e-3, 2).references[:321]
MEMORY = {"fuzzy-4": 2, "fuzzy-16-tip": 2, "computed-torque-tip": 2}
MEMORY |= {"elastic-observer": 10, "ppo-residual": 18, "smooth-observer": 10}
NAMES = slow_but(["fuzzy-4", "elastic-observer", "ppo-residual"], [*MEMORY])


pytestmark = pytest.mark.usefixtures("precision")


@functools.cache
def known(name):
    policy = load_policy(name)
    return policy, SampledLaw(policy, REFERENCES)


def near(law, k):
    """Return a point (θ, θ̇, m) undecided at a sample, and how far it may be from there."""
    one, other = law._held[k][3:5, law.remembered]
    away = np.random.default_rng(k).normal(size=4) * [1e-4, 1e-4, 1e-2, 1e-2]
    units = np.concatenate([[1e-4, 1e-4, 1e-2, 1e-2], np.abs(one - other)])
    return np.concatenate([REFERENCES[k, :4] + away, one]), units


def answer(policy, law, k, point):
    """Return what the policy itself answers."""
    memory, torque = law._held[k, :1].copy(), np.empty((1, 2))
    memory[0, law.remembered] = point[4:]
    policy.act(np.concatenate([point[:4], REFERENCES[k]])[np.newaxis], memory, torque)
    return np.concatenate([torque[0], memory[0, law.remembered]])


def shares(policy, law, k, point, units, count=25):
    """Return how far answers in a box are from the lines, as shares of what is allowed; and that, beside the lines."""
    seen = Zonotope(len(point), 0)
    seen.add(np.diag(units), 0)
    found, rng, rows = law.respond(k, point, seen), np.random.default_rng(0), []
    given, own = np.split(found.columns, [seen.columns.shape[1]], axis=1)
    gains, rest = np.zeros((len(given), len(point))), np.abs(own).sum(axis=1) + found.box
    gains[:, units > 0.0] = given / units[units > 0.0]
    for _ in range(count):
        moved = point + 0.999 * units * rng.choice([-1.0, 1.0], len(point)) * rng.uniform(0.5, 1.0, len(point))
        linear = found.middle + gains @ (moved - point)
        missed = np.abs(answer(policy, law, k, moved) - linear)
        slack = 1e-15 * (np.abs(found.middle) + np.abs(gains) @ np.abs(moved - point))  # of the sums here
        assert (missed <= rest + slack).all()
        rows.append(missed / np.maximum(rest, 1e-14))
    return np.array(rows), rest, np.abs(given).sum(axis=1)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("k", [0, 1, 12, 300])
def test_at_a_point_it_is_the_policy(name, k):
    policy, law = known(name)
    assert law.memory == MEMORY[name]
    point, _ = near(law, k)
    found = law.respond(k, point, Zonotope(len(point), 0))
    allowed = np.abs(found.columns).sum(axis=1) + found.box
    assert (np.abs(found.middle - answer(policy, law, k, point)) <= allowed).all()
    assert (allowed < 1e-11 * np.maximum(np.abs(found.middle), 1.0)).all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("k", "size"), [(0, 0.1), (12, 0.3), (300, 1.0), (300, 0.01)])
def test_every_answer_near_a_point_is_held_and_what_is_not_linear_is_needed(name, k, size):
    policy, law = known(name)
    point, units = near(law, k)
    size *= 0.02 if "ppo" in name else 1.0
    worst, rest, linear = shares(policy, law, k, point, size * units)
    assert worst[:, :2].max() > 1e-3 or rest[:2].max() < 1e-11
    assert (rest[:2] < 0.1 * linear[:2] + 1e-9).all()


def test_a_box_counts_like_columns():
    _, law = known("elastic-observer")
    point, units = near(law, 300)
    boxed, seen = Zonotope(14, 0), Zonotope(14, 0)
    boxed.box = 0.1 * units
    seen.add(np.diag(0.1 * units), 0)
    totals = [np.abs(r.columns).sum(axis=1) + r.box for r in (law.respond(300, point, one) for one in (boxed, seen))]
    assert (totals[0] >= 0.99 * totals[1]).all() and (totals[0] < 1.1 * totals[1]).all()


def test_an_angle_between_two_parts_of_a_table_is_on_both():
    """At cos q2 = 1/4 the gains of the observer have a corner."""
    policy, law = known("elastic-observer")
    point, units = near(law, 300)
    point[1] = point[5] = np.arccos(0.25)
    before = shares(policy, law, 300, point + 0.01 * np.eye(14)[1] + 0.01 * np.eye(14)[5], 0.1 * units)
    worst, rest, linear = shares(policy, law, 300, point, 0.1 * units)
    assert (rest <= 0.02 * linear + 3.0 * before[1]).all() and worst.max() > 0.01


@pytest.mark.parametrize("kind", ["relu", "tanh", "clipped"])
def test_layers_of_every_kind_are_held(kind):
    made = bundle()
    large = tuple(30.0 * weight for weight in made.network.weights)
    change = {"relu": {"activation": "relu"}, "tanh": {"output": "tanh"}, "clipped": {"weights": large}}[kind]
    policy = LearnedPolicy(dataclasses.replace(made, network=dataclasses.replace(made.network, **change)))
    law = SampledLaw(policy, REFERENCES[:20])
    point, units = near(law, 10)
    worst, *_ = shares(policy, law, 10, point, units)
    assert worst.max() > 1e-3


class Own(LawPolicy):
    """A policy with a law of a test's own."""

    def __init__(self, act):
        super().__init__(load_policy("fuzzy-4").parameters, 1e-3)
        self.memory_size, self._own = 2, act

    @functools.cached_property
    def control_law(self):
        return Law(self._own, (0.0, 0.0), ())


@pytest.mark.parametrize("step", [lambda v: select(v > 0.0, 1.0, 2.0), lambda v: floor(v)])
def test_a_law_that_jumps_has_no_bound(step):
    seen = Zonotope(4, 0)
    seen.add(0.1 * np.eye(4), 0)

    def jumps(memory, seen, _):
        return memory, (step(seen.dq_motor.joint1), seen.q_motor.joint2)

    law = SampledLaw(Own(jumps), REFERENCES[:3])
    assert law.respond(0, np.array([0.3, 0.0, 0.5, 0.0]), seen).middle[1] == 0.0
    with pytest.raises(NoBound, match=r"either may be larger|does not determine|but not to one value"):
        law.respond(0, np.array([0.3, 0.0, 0.0, 0.0]), seen)


@pytest.mark.parametrize(("name", "reason"), [("adaptive-observer", "covariance"), ("learned-observer", "multiply")])
def test_other_policies_have_none_and_say_why(name, reason):
    with pytest.raises(NoBound, match=rf"no bound for .*{reason}.*; choose elastic-observer"):
        SampledLaw(load_policy(name), REFERENCES[:1])


def test_a_law_of_ones_own_has_a_tube():
    def spring(memory, seen, _):
        pairs = zip(*seen[:4], strict=True)
        return memory, [4e4 * (q_d - q) + 800.0 * (dq_d - dq) for q, dq, q_d, dq_d in pairs]

    bound = find_bound(TipClaim("spring", steps=5), policy=Own(spring))
    assert 1e-6 < bound.largest < 1e-4


def test_laws_that_remember_have_a_tube():
    """Known plants: what is simulated, nearly; any friction: far wider."""
    exact, wide, learned = (
        find_bound(TipClaim(policy, "nominal", name, SETS[name], steps=8))
        for policy, name in (
            ("elastic-observer", "table-1"),
            ("elastic-observer", "any-friction"),
            ("ppo-residual", "table-1"),
        )
    )
    assert exact.largest < 2e-7 and learned.largest < 1e-5
    assert (wide.tip[1:] > exact.tip[1:]).all() and 1e-6 < wide.largest < 1e-3
