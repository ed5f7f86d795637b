"""The set from which the arm stays in the box: by hand, against worst motions of the rigid arm, and forged."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from flint import fmpq
from support.rigid_loop import RigidLoop
from support.shipped import CONTROLLERS

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.ts_model import TSModel
from fuzzyarm.proof._residual import feedforward_residual
from fuzzyarm.proof.definiteness import exact
from fuzzyarm.proof.invariant_set import Bounds, _is_invariant, _largest, invariant_set

CIRCLE, STEP = JointReference(), 5e-4
# x_1' = -2 x_1 and x_2' = -2 x_2 + w with V = x_1² + x_2²/4, P = diag(1, 4): V' = -4V + x_2 w/2 <= -2V + w²/8, for
# x_2 w/2 <= x_2²/2 + w²/8. In |x_1| <= 3, |x_2| <= 4 that gives r = min(9, 16/4) = 4 and w² <= 16 r = 64; w = 8 leads
# to x_2 = 4, which is V = 4 and the border of the box.
BY_HAND = Bounds(spread=exact([1, 4]), room=exact([3, 4]), alpha=fmpq(1), gamma2=fmpq(1, 8))


def test_two_states_by_hand_and_none_where_the_reference_or_the_residual_takes_all_room():
    assert _largest(BY_HAND) == (4.0, 8.0)
    assert _largest(BY_HAND._replace(residual=fmpq(3))) == (4.0, 5.0)
    assert _largest(BY_HAND._replace(room=(3, fmpq(0))))[0] == _largest(BY_HAND._replace(residual=fmpq(9)))[0] == 0.0


@pytest.mark.parametrize(
    ("level", "disturbance", "changed"),
    [
        (4.001, 8.0, {}),
        (4.0, 8.001, {}),
        (3.999, 8.0, {}),
        (4.0, 8.0, {"residual": fmpq(1, 1000)}),
        (4.0, 0.0, {"room": (3, fmpq(3999, 1000))}),
        (4.0, 0.0, {"room": (-3, 4)}),
        (0.0, 0.0, {}),
        (4.0, -9.0, {}),
    ],
)
def test_a_forged_set_is_refused(level, disturbance, changed):
    assert _is_invariant(4.0, 8.0, BY_HAND)
    assert not _is_invariant(level, disturbance, BY_HAND._replace(**changed))


@pytest.fixture(scope="module")
def found():
    """Return the loop of fuzzy-4, its set, and the largest |w|: d and the residual together."""
    controller = Controller.load(CONTROLLERS["fuzzy-4"])
    stays = invariant_set(controller)
    residual = np.hypot(*feedforward_residual(controller.model, CIRCLE).bound)
    return RigidLoop(controller), stays, stays.disturbance + residual


def largest_of(loop, level, W, lanes=40, duration=0.05):
    """Return the largest V of motions about the circle from V = level, and whether all of them stay in the box.

    The torque |w| = W along Gᵀ P⁻¹ x makes V' largest at every instant.
    """
    rng, P = np.random.default_rng(7), loop.controller.P
    start, inverse, largest, inside = rng.normal(size=(lanes, loop.states)), np.linalg.inv(P), 0.0, True
    x = np.sqrt(level) * start / np.linalg.norm(start, axis=1, keepdims=True) @ np.linalg.cholesky(P).T
    begin, limits = rng.uniform(0.0, CIRCLE.duration, lanes), [*loop.arm.joint_limit, *loop.arm.velocity_limit]

    def rate(t, x):
        q, dq, _ = CIRCLE.sample(begin + t)
        F, G = loop.frozen(q + x[:, :2], dq + x[:, 2:4])
        push = np.einsum("lij,li->lj", G, x @ inverse)
        w = W * push / np.linalg.norm(push, axis=1, keepdims=True)
        return np.einsum("lij,lj->li", F, x) + np.einsum("lij,lj->li", G, w)

    for t in STEP * np.arange(round(duration / STEP)):
        largest = max(largest, np.einsum("li,ij,lj->l", x, inverse, x).max())
        inside &= bool((np.abs(np.hstack(CIRCLE.sample(begin + t)[:2]) + x[:, :4]) <= limits).all())
        x = x + STEP * rate(t + 0.5 * STEP, x + 0.5 * STEP * rate(t, x))
    return largest, inside


def test_no_worst_motion_leaves_the_set_and_three_tenths_more_torque_leads_out(found):
    loop, stays, W = found
    largest, inside = largest_of(loop, stays.level, W)
    assert largest <= stays.level * (1.0 + 1e-9) and inside
    assert largest_of(loop, stays.level, 1.3 * W)[0] > 1.05 * stays.level


def test_a_larger_set_has_a_point_outside_the_box_and_a_start_just_above_the_stated_one_is_outside(found):
    loop, stays, _ = found
    P, fastest = loop.controller.P, np.abs(CIRCLE.sample(np.linspace(0.0, CIRCLE.duration, 5001)).dq).max(axis=0)
    reach = [fastest[1] + np.sqrt(share * stays.level * P[3, 3]) for share in (1.0, 1.002)]
    assert reach[0] <= loop.arm.velocity_limit[1] < reach[1]
    steepest = np.linalg.eigvalsh(np.linalg.inv(P)[:2, :2])[-1]
    assert steepest * stays.start**2 <= stays.level < 1.01 * steepest * stays.start**2


def test_the_numbers_of_the_page_are_those_of_the_words(found):
    page = (Path(__file__).parents[2] / "docs" / "theory" / "certificate.md").read_text(encoding="utf-8")
    assert found[1][:3] == (0.0002022, 526.3, 0.03764)
    for number in ("0.0002022", "0.0376 rad", "526$ N m", "116 N m", "49.8", "below 0.03,"):
        assert number in page
    assert "|w| <= 0.029, but" in invariant_set(Controller.load(CONTROLLERS["paper-4-integral-common"])).statement


def test_the_words_round_downwards_and_say_why_there_is_no_set(found):
    stays = found[1]
    assert f"|d| <= {np.floor(stays.disturbance):.0f} N m at every instant beside the feedforward" in stays.statement
    assert f"never rises above {stays.level} (SI units)" in stays.statement and "|e| <= 0.0376 rad" in stays.statement
    four, short = Controller.load(CONTROLLERS["fuzzy-4"]), TSModel(ArmParameters(length=(0.2, 0.2)))
    cases = {
        "reference alone reaches |r| = 49.8": Controller.load(CONTROLLERS["paper-4"]),
        "does not follow the paper's circle, the path leaves the reach": dataclasses.replace(four, model=short),
        "of which the feedforward residual may take 116 N m": dataclasses.replace(four, gamma=0.001),
    }
    for words, controller in cases.items():
        none = invariant_set(controller)
        assert none[:3] == (0.0, 0.0, 0.0) and none.statement.startswith("No set from which it stays in the box")
        assert words in none.statement
