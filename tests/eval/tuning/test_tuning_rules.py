"""The rules that choose gains from rows that were measured, and the search for weights."""

import math

import numpy as np
import pytest

from fuzzyarm.envs.physics.dynamics import tip_jacobian
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.stability.linearisation import LocalLoop
from fuzzyarm.eval.tuning import bandwidth, fuzzy_gains, observer_search
from fuzzyarm.eval.tuning.finding import PERIODS, force_factor, heaviest, periods_of, radius_within
from fuzzyarm.eval.tuning.search import WORTH, Budget, Descent, best_of, found_weights, sobol_points
from fuzzyarm.eval.tuning.tip_bounds import largest_deviation
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.policies.tip_bound import TipClaim, find_bound

PAPER = ArmParameters()


def design(error, **changes):
    row = {
        "case_1_joint_error_rms_mrad": error,
        "gain_margin_upper": 4.1,
        "gain_margin_upper_1_sample_later": 1.6,
        "radius_worst_condition": 0.999,
        "tip_deviation_mm": 1.0,
    } | changes
    return {**row, "bears": fuzzy_gains.bears(PAPER, row)}


def test_the_fuzzy_design_with_the_smallest_error_that_bears_everything_is_chosen():
    rows = [
        design(0.1, gain_margin_upper=3.9),
        design(0.2, gain_margin_upper_1_sample_later=1.4),
        design(0.3, radius_worst_condition=radius_within(0.5, 1500) + 1e-9),
        design(0.4, gain_margin_upper=math.nan),
        design(0.6),
        design(0.5),
    ]
    assert fuzzy_gains.choice_of(rows) is rows[-1]
    assert fuzzy_gains.choice_of(rows[:4]) is None


def test_of_equally_good_fuzzy_designs_the_one_with_the_smallest_bound_is_chosen():
    rows = [
        design(0.5),
        design(0.5049, tip_deviation_mm=0.9),
        design(0.5051, tip_deviation_mm=0.8),
        design(0.5049, tip_deviation_mm=0.7, gain_margin_upper=3.9),
    ]
    assert fuzzy_gains.choice_of(rows) is rows[1]
    assert "2 designs" in (said := fuzzy_gains.equals_in_words(rows, rows[1])) and "0.9 mm" in said and "1 mm" in said
    assert fuzzy_gains.choice_of(rows, share=0.02) is rows[2]
    assert fuzzy_gains.choice_of(rows[:1]) is rows[0] and "No other" in fuzzy_gains.equals_in_words(rows[:1], rows[0])


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
    assert fuzzy_gains.gammas_for(PAPER, 20.0) == fuzzy_gains.GAMMAS
    assert fuzzy_gains.gammas_for(PAPER, 10.0)[0] == pytest.approx(2 * fuzzy_gains.GAMMAS[0])
    # A tenth of every mass, moment of inertia and rotor is a tenth of the inertia.
    tenth = ArmParameters(mass=(1.5, 0.9), inertia=(0.031, 0.019), motor_inertia=(0.271, 0.05))
    assert fuzzy_gains.gammas_for(tenth, 20.0) == pytest.approx([10 * gamma for gamma in fuzzy_gains.GAMMAS])
    points = fuzzy_gains.points_of(PAPER, 4, 20.0)
    assert len(points) == 80 and {point.gamma for point in points[-10:]} == {max(fuzzy_gains.GAMMAS)}
    assert {point.fastest_pole for point in fuzzy_gains.points_of(PAPER, 2, 20.0)} == {None}


def loop(omega, error, **changes):
    return {
        "bandwidth": omega,
        "joint_error_rms_mrad": error,
        "gain_margin_upper": 2.5,
        "radius_delayed": 0.99,
        "decays_throughout": True,
    } | changes


def test_the_bandwidth_with_the_smallest_error_within_margins_is_chosen():
    rows = [
        loop(100.0, 0.1, gain_margin_upper=1.9),
        loop(90.0, 0.2, radius_delayed=1.0),
        loop(80.0, 0.3, decays_throughout=False),
        loop(70.0, None),
        loop(60.0, 0.5),
        loop(50.0, 0.4),
    ]
    assert bandwidth.choice_of(rows) is rows[-1]
    assert bandwidth.choice_of(rows[:4]) is None


MINIMUM = np.log([0.02, 3.0])
BOX = [(1e-3, 1.0), (0.1, 100.0)]


def bowl(arm):
    return lambda point: arm + float(((np.asarray(point) - MINIMUM) ** 2).sum())


def searched(guess, budget):
    points = sobol_points(BOX, 8, seed=1)
    return found_weights(bowl, 1.0, np.asarray(guess), points, 0.5, budget, engine=Engine(jobs=1))


def test_the_minimum_of_a_bowl_is_found():
    best, guess = searched(MINIMUM + 1.0, Budget(sobol=8, searches=2, evaluations=60))
    assert guess.cost == pytest.approx(3.0) and best.cost == pytest.approx(1.0, abs=1e-4)
    assert best.point == pytest.approx(MINIMUM, abs=1e-2)


def test_the_first_guess_stays_where_nothing_is_better_by_a_share():
    nearly = MINIMUM + math.sqrt(0.9 * WORTH / 2)
    best, guess = searched(nearly, Budget(sobol=8, searches=2, evaluations=60))
    assert best == guess
    first = Descent((0.0,), 1.0)
    assert best_of(first, [Descent((1.0,), 1.0 - 0.9 * WORTH)]) == first
    assert best_of(first, [Descent((1.0,), 1.0 - 1.1 * WORTH)]).point == (1.0,)
    assert best_of(Descent((0.0,), math.inf), [Descent((1.0,), 7.0)]).cost == 7.0


def test_table_1_is_tuned_under_the_papers_loads_and_another_arm_under_its_own():
    paper, other = ArmParameters(), ArmParameters(length=(0.6, 0.45))
    assert (periods_of(paper), heaviest(paper), force_factor(paper)) == (PERIODS, 5.0, 1.0)
    assert observer_search.largest_allowed(paper) == 0.997
    assert radius_within(0.5, PERIODS) == 0.5 ** (1.0 / 1500.0)
    loads = case_for("machining", other).disturbance.tip_force, case_for("payload", other).disturbance.payload
    assert heaviest(other) == loads[1].mass != 5.0
    assert force_factor(other) == loads[0].base / 138.0 != 1.0


SOFT = ArmParameters(length=(0.5, 0.4), stiffness=(8e3, 5e3))


def policy():
    return TipPolicy(ComputedTorquePolicy(SOFT, 1e-3, 40.0))


def test_the_arm_of_a_bound_is_that_of_the_policy():
    """The soft arm follows the circle closely with the policy that knows it; its start has other motors' angles."""
    own = find_bound(TipClaim("it", steps=3), policy=policy())
    papers = find_bound(TipClaim("computed-torque-tip", steps=3))
    assert own.largest < 1e-6
    assert abs(own.steps[0].segments[0].end[0] - papers.steps[0].segments[0].end[0]) > 1e-3
