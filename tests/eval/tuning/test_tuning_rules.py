"""The rules that choose gains from rows that were measured, and the search for weights."""

import math

import numpy as np
import pytest

from fuzzyarm import ArmParameters, Engine, TipClaim, find_bound
from fuzzyarm.envs.physics.dynamics import tip_jacobian
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.eval.stability._linearisation import LocalLoop
from fuzzyarm.eval.tuning import _fuzzy_gains, _observer_search, _steps
from fuzzyarm.eval.tuning._finding import force_factor, halving_radius, heaviest, periods_of
from fuzzyarm.eval.tuning._fuzzy_gains import largest_deviation
from fuzzyarm.eval.tuning._search import WORTH, Context, WeightSearch
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy

PAPER = ArmParameters()


def design(error, **changes):
    measured = {"case_1_joint_error_rms_mrad": error, "radius_worst_condition": 0.999, "tip_deviation_mm": 1.0}
    measured |= {"gain_margin_upper": 4.1, "gain_margin_upper_1_sample_later": 1.6} | changes
    return _fuzzy_gains._Made(None, measured, _fuzzy_gains._bears(measured, halving_radius(PAPER)))


def test_of_the_fuzzy_designs_with_the_smallest_error_that_bear_everything_the_smallest_bound_is_chosen():
    rows = [
        design(0.1, gain_margin_upper=3.9),
        design(0.2, gain_margin_upper_1_sample_later=1.4),
        design(0.3, radius_worst_condition=0.5 ** (1 / 1500) + 1e-9),
        design(0.4, gain_margin_upper=math.nan),
        design(0.6),
        design(0.5),
        design(0.5049, tip_deviation_mm=0.9),
        design(0.5051, tip_deviation_mm=0.8),  # not within 1 %
    ]
    assert not _fuzzy_gains._equals_of(rows[:4])
    for some, equals, said in (
        (rows[:6], [rows[5]], ["No other"]),
        (rows, [rows[6], rows[5]], ["2 designs", "0.9 mm", "1 mm"]),
    ):
        assert _fuzzy_gains._equals_of(some) == equals
        assert all(part in _fuzzy_gains._equals_in_words(equals) for part in said)


def test_the_tips_deviation_is_reached_by_one_friction():
    """From rest, x_N = Σ Φ^(N-1-k) B w_k; along d the worst w_k has the signs of dᵀ J Φ^(N-1-k) B."""
    rng, periods = np.random.default_rng(5), 30
    plant = np.hstack([0.9 * np.linalg.qr(rng.normal(size=(8, 8))).Q, rng.normal(size=(8, 2))])
    law = np.vstack([np.zeros((2, 10)), 0.1 * rng.normal(size=(2, 10))])
    loop = LocalLoop(plant, plant, law, rng.normal(size=10), np.zeros(2))
    matrix, B, static = loop.matrix(), np.vstack([plant[:, 8:], np.zeros((2, 2))]), np.array(PAPER.static_friction)
    powers = [np.linalg.matrix_power(matrix, k) @ B for k in reversed(range(periods))]

    def deviation(row, friction):
        x = np.zeros(10)
        for torque in friction:
            x = matrix @ x + B @ torque
        return row @ x[2:4]

    reached = []
    for turn in np.pi / 16 * np.arange(16):
        row = np.array([np.cos(turn), np.sin(turn)]) @ tip_jacobian(loop.equilibrium[2:4], PAPER.length)
        signs = np.sign([row @ power[2:4] for power in powers])
        reached.append(deviation(row, static * signs))
        assert deviation(row, static * rng.choice([-1.0, 1.0], (periods, 2))) < reached[-1]
    assert largest_deviation([loop, loop], PAPER, periods) == pytest.approx(max(reached), rel=1e-12)


def test_the_grid_of_table_1_is_the_papers_and_scales_with_inertia_and_decay_rate():
    def gammas(arm, alpha):
        return [point.gamma for point in _fuzzy_gains._points_of(arm, alpha)[:: len(_fuzzy_gains._POLES)]]

    papers = list(_fuzzy_gains._GAMMAS)
    assert gammas(PAPER, 20.0) == papers and gammas(PAPER, 10.0)[0] == pytest.approx(2 * papers[0])
    # A tenth of every mass, moment of inertia and rotor is a tenth of the inertia.
    tenth = ArmParameters(mass=(1.5, 0.9), inertia=(0.031, 0.019), motor_inertia=(0.271, 0.05))
    assert gammas(tenth, 20.0) == pytest.approx([10 * gamma for gamma in papers])


def loop(omega, error, upper=2.5, **radii):
    radii = {"nominal": 0.99, "one sample later": 0.99} | radii
    return {"bandwidth": omega, "motor_error": error, "loop_gain": {"upper": upper}, "spectral_radius": radii}


def test_the_bandwidth_with_the_smallest_error_within_margins_is_chosen():
    rows = [
        loop(100.0, 0.1, upper=1.9),
        loop(95.0, 0.1, upper=None),
        loop(90.0, 0.2, nominal=None),
        loop(80.0, 0.3, nominal=0.5 ** (1 / 1500) + 1e-9),
        loop(70.0, math.inf),
        loop(60.0, 0.5),
        loop(50.0, 0.4),
    ]
    assert _steps._bandwidth_of(rows, halving_radius(PAPER)) is rows[-1]
    assert _steps._bandwidth_of(rows[:5], halving_radius(PAPER)) is None


def searched(guess):
    """Search for the minimum of a bowl, which is 1, and return the best point, the first guess and the minimum."""
    steps, minimum = [], np.log([0.02, 3.0])
    search = WeightSearch(
        usual=None, guess=minimum + guess, weights_of=np.exp, box={"a": (1e-3, 1.0), "b": (0.1, 100.0)}, seed=1,
        unfit=math.inf, points=8, searches=2, evaluations=60, first_step=0.5,
    )  # fmt: skip
    context = Context(PAPER, None, Engine(jobs=1), lambda: steps.append(1), {})
    found = search.best(context, lambda: lambda point: 1.0 + float(((point - minimum) ** 2).sum()))
    assert len(steps) == search.total == 9 + 2 * 60
    return *found, minimum


def test_the_minimum_of_a_bowl_is_found_and_the_first_guess_stays_where_nothing_is_better_by_a_share():
    best, guess, minimum = searched(1.0)
    assert guess.cost == pytest.approx(3.0) and best.cost == pytest.approx(1.0, abs=1e-4)
    assert best.logarithms == pytest.approx(minimum, abs=1e-2)
    for gain, stays in ((0.9 * WORTH, True), (1.1 * WORTH, False)):
        best, guess, _ = searched(math.sqrt(gain / (1.0 - gain) / 2))
        assert (best is guess) == stays


def test_table_1_is_tuned_under_the_papers_loads_and_another_arm_under_its_own():
    other = ArmParameters(length=(0.6, 0.45))
    assert (periods_of(PAPER), heaviest(PAPER), force_factor(PAPER)) == (1500, 5.0, 1.0)
    assert _observer_search._largest_allowed(PAPER) == 0.997
    assert halving_radius(PAPER) == 0.5 ** (1.0 / 1500.0)
    assert heaviest(other) == case_for("payload", other).disturbance.payload.mass != 5.0
    assert force_factor(other) == case_for("machining", other).disturbance.tip_force.base / 138.0 != 1.0


def test_the_arm_of_a_bound_is_that_of_the_policy():
    """The soft arm follows the circle closely with the policy that knows it; its start has other motors' angles."""
    soft = ArmParameters(length=(0.5, 0.4), stiffness=(8e3, 5e3))
    own = find_bound(TipClaim("it", steps=3), policy=TipPolicy(ComputedTorquePolicy(soft, 1e-3, 40.0)))
    papers = find_bound(TipClaim("computed-torque-tip", steps=3))
    assert own.largest < 1e-6
    assert abs(own.steps[0].segments[0].end[0] - papers.steps[0].segments[0].end[0]) > 1e-3
