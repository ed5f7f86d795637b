"""Figures 2-10: the data they show, and their files."""

import numpy as np
import pytest

from fuzzyarm.eval.paper.figures import draw_figures

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def figures(evidence):
    return draw_figures(evidence)


def curves(axes):
    """Return the curves by their stroke: dotted and solid."""
    return {"solid" if line.get_linestyle() == "-" else "dotted": line.get_xydata() for line in axes.lines}


@pytest.mark.parametrize(("number", "case"), [(4, "nominal"), (5, "machining"), (6, "payload")])
def test_circularity_is_drawn_on_both_sides_in_millimetres(figures, evidence, number, case):
    grid = np.reshape(figures[number].axes, (2, 2))
    for column, form in enumerate(("printed", "consistent")):
        for rules, stroke in ((32, "dotted"), (4, "solid")):
            run = evidence.rollouts[f"{form}-{rules}", case]
            for row, error in enumerate((run.circularity_error, run.circularity_error_motor)):
                np.testing.assert_array_equal(curves(grid[row, column])[stroke], np.c_[run.time, 1e3 * error])


@pytest.mark.parametrize(
    ("number", "signal"),
    [
        (7, lambda run: run.torque),
        (8, lambda run: run.dq_motor),
        (9, lambda run: 1e3 * (run.q_motor - run.q_reference)),
        (10, lambda run: run.friction_torque),
    ],
)
def test_joint_figures_have_rules_by_row_and_joints_by_stroke(figures, evidence, number, signal):
    grid = np.reshape(figures[number].axes, (2, 2))
    for row, rules in enumerate((32, 4)):
        assert grid[row, 0].get_ylabel().startswith(f"{rules} rules")
        for column, form in enumerate(("printed", "consistent")):
            run, drawn = evidence.rollouts[f"{form}-{rules}", "nominal"], curves(grid[row, column])
            for joint, stroke in enumerate(("dotted", "solid")):
                np.testing.assert_array_equal(drawn[stroke], np.c_[run.time, signal(run)[:, joint]])
