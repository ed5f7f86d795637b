"""The feedforward residual between the instants: never below what a dense sampling finds, and close to it."""

import contextlib
import itertools

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from slow_twins import slow_but

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.paths import Circle
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, VELOCITY, TSModel, _descriptor_terms
from fuzzyarm.proof import _residual as residual
from fuzzyarm.proof._residual import Residual, feedforward_residual

RULES = st.sampled_from(list(NAMED_RULES.values()))
PATHS = {"circle": Circle(), "arc": Circle(center=(0.4, 0.5), radius=0.15, start_angle=1.0, turns=0.37)}


def dense(model, reference, count):
    """Return the largest residual (2,) at evenly spaced instants, from the premise bounds and slopes themselves."""
    motion = reference.sample(np.linspace(0.0, reference.duration, count))
    signals = {"A": np.hstack([motion.q, motion.dq]), "E": np.hstack([motion.dq, motion.ddq])}
    total = np.zeros((count, 2))
    for k, (name, (low, high)) in enumerate(zip(("z1", "z2", "z3", "z4", "z5"), model.bounds, strict=True)):
        if name not in model.kept:
            side = "E" if k == 0 else "A"
            slope = _descriptor_terms(model.parameters)[side][1][k]
            total += np.abs(0.5 * (high - low) * signals[side] @ slope.T)[:, VELOCITY]
    return total.max(axis=0)


def random_circle(rng):
    """Return a circle somewhere about the arm."""
    radius, direction = rng.uniform(0.15, 0.85), rng.uniform(-np.pi, np.pi)
    center = tuple((radius * np.array([np.cos(direction), np.sin(direction)])).tolist())
    size, angle = float(rng.uniform(0.01, 0.3)), float(rng.uniform(-7.0, 7.0))
    return Circle(center, size, angle, turns=float(rng.uniform(-3.0, 3.0)))


# Every path with one model, and every model on the circle.
FAST = [(1, "circle"), (4, "circle"), (4, "arc"), (16, "circle")]


@pytest.mark.parametrize("case", slow_but(FAST, itertools.product((1, 4, 16), PATHS)), ids=str)
def test_the_bound_is_not_below_a_dense_sampling_and_close_to_it(case):
    kept, path = NAMED_RULES[case[0]], PATHS[case[1]]
    model, reference = TSModel(ArmParameters(), kept), JointReference(path, duration=2.0)
    found, largest = feedforward_residual(model, reference), dense(model, reference, 20_001 if kept else 50_001)
    assert np.all(found.bound >= largest)
    assert found.bound == pytest.approx(largest, rel=1e-3)
    assert found.sampled == pytest.approx(dense(model, reference, 2001), rel=1e-12)


@pytest.mark.parametrize("examples", slow_but([4], [4, 60]))
def test_it_holds_on_any_circle_and_arm(examples):
    @settings(max_examples=examples, deadline=None)
    @given(seed=st.integers(0, 2**32), kept=RULES)
    def check(seed, kept):
        rng = np.random.default_rng(seed)
        arm = ArmParameters(length=(0.5, float(rng.choice([0.4, 0.5, 0.55]))))
        model, duration, elbow = TSModel(arm, kept), float(rng.uniform(1.0, 10.0)), int(rng.choice([1, -1]))
        for _ in range(100):
            with contextlib.suppress(ValueError):  # out of reach, or too fast
                reference = JointReference(random_circle(rng), duration, elbow, arm)
                break
        else:
            reject()
        bound, largest = feedforward_residual(model, reference).bound, dense(model, reference, 20_001)
        assert bound is not None and np.all(bound >= largest * (1.0 - 1e-12))
        assert np.all(bound <= 1.02 * largest + 1e-3 * largest.max())

    check()


def test_a_search_cut_short_gives_a_looser_bound(monkeypatch):
    model, reference = TSModel(ArmParameters(), NAMED_RULES[4]), JointReference()
    close = feedforward_residual(model, reference).bound
    monkeypatch.setattr(residual, "MOST_HALVED", 8)
    assert np.all(feedforward_residual(model, reference).bound > close)


def test_what_keeps_all_premises_misses_nothing():
    found = feedforward_residual(TSModel(ArmParameters(), NAMED_RULES[32]), JointReference())
    assert not found.bound.any() and not found.sampled.any()


def test_a_path_that_leaves_the_reach_between_the_instants_is_not_bounded():
    reference = JointReference()
    sampled = reference.sample(0.0)
    object.__setattr__(reference, "path", Circle((0.35, 0.85), 0.2))
    object.__setattr__(reference, "sample", lambda t: sampled._make(np.tile(part, (2001, 1)) for part in sampled))
    assert residual.largest_motion(reference) is None


def test_the_words_say_whether_it_is_bounded():
    bounded, sampled = np.array([158.4999, 98.3001]), np.array([158.484, 98.3])
    assert "is at most (159, 98.4) N m along" in Residual(sampled, bounded).statement
    text = Residual(sampled, None).statement
    assert "sampled at 2001 instants, not bounded between them" in text and "at most" not in text
    assert "reaches (159, 98.3) N m" in text
