"""The search for weights: what it finds, what it keeps, and that processes do not change it."""

import math

import numpy as np
import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.tuning import observer_search
from fuzzyarm.eval.tuning.finding import PERIODS, force_factor, heaviest, periods_of, radius_within
from fuzzyarm.eval.tuning.search import WORTH, Budget, Descent, best_of, found_weights, sobol_points

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
