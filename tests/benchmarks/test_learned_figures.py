"""The figures of the comparison of learned policies show what they are given, at the scale they say."""

import dataclasses
import importlib.util
import sys
from pathlib import Path

import matplotlib.style
import numpy as np
import pytest
from matplotlib.figure import Figure

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.rollout import record_rollout

PATH = Path(__file__).parents[2] / "benchmarks" / "learned_figures.py"
SPEC = importlib.util.spec_from_file_location(PATH.stem, PATH)
figures = sys.modules[PATH.stem] = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(figures)

LEVELS = {
    "nominal": {"fuzzy-4-tip": 4e-4, "computed-torque": 1.7},
    "machining": {"fuzzy-4-tip": 5.0, "computed-torque": 4.0, "elastic-observer": 2.0},
    "payload": {"fuzzy-4-tip": 1.8, "computed-torque": 3.6, "elastic-observer": 0.8},
}


@pytest.fixture(scope="module")
def runs():
    """The same motion by two policies, a few millimetres off and micrometres off."""
    return [
        record_rollout(FuzzyArmEnv(), load_policy(name), policy_name=name, case="nominal", seed=0)
        for name in ("fuzzy-4", "fuzzy-4-tip")
    ]


@pytest.fixture(autouse=True)
def style():
    with matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True):
        yield


def lost(run, distance):
    """The episode with the tip this far away [m] from its 500th sample on."""
    tip, error = run.tip.copy(), run.tip_error.copy()
    tip[500:] = run.tip_reference[500:] - np.array([0.0, distance])
    error[500:] = distance
    return dataclasses.replace(run, tip=tip, tip_error=error)


def worst(*shown):
    return figures.WorstTask("a title", JointReference(), shown, 100.0)


def panels(row):
    """Return the panels of a figure with one row."""
    (part,) = figures.draw_worst_tasks([row]).subfigs
    return part, *part.axes


def crosses(axes):
    return [line for line in axes.lines if line.get_marker() == "x"]


def test_plane_and_error_tell_the_same(runs):
    part, plane, errors = panels(worst(figures.Shown(runs[0], "worse"), figures.Shown(runs[1], "better")))
    assert part.get_suptitle() == "a title"
    assert [text.get_text() for text in part.legends[0].get_texts()] == ["reference", "worse", "better"]
    assert (plane.get_xlabel(), plane.get_ylabel()) == ("y, to the side [m]", "x, down [m]")
    assert (errors.get_xlabel(), errors.get_ylabel()) == ("time [s]", "tip error [mm]")
    assert errors.get_yscale() == "log"
    factor = float(plane.get_title(loc="left").split("×")[1])
    assert factor > 1.0
    for path, error in zip(plane.lines[:2], errors.lines, strict=True):
        time, millimetres = error.get_data()
        right, down = path.get_data()
        deviation = np.column_stack([down, right]) - JointReference().tip(time).position
        assert 1e3 * np.hypot(*deviation.T) == pytest.approx(factor * np.array(millimetres), abs=2e-3 * factor)
    assert errors.lines[0].get_color() != errors.lines[1].get_color()
    assert errors.lines[0].get_linestyle() != errors.lines[1].get_linestyle()
    assert not crosses(plane) and not crosses(errors)
    assert not errors.texts


def test_lost_path_and_circle_are_both_in_view(runs):
    away = figures.Shown(lost(runs[0], 1.0), "lost", 500)
    _, plane, errors = panels(worst(away, figures.Shown(runs[1], "better")))
    assert plane.get_title(loc="left") == "tip, deviation × 1"
    left, right = plane.get_xlim()
    bottom, top = plane.get_ylim()
    assert top < bottom  # x points down
    for y, x in (line.get_data() for line in plane.lines):
        assert left <= np.min(y) and np.max(y) <= right and top <= np.min(x) and np.max(x) <= bottom
    assert max(right - left, bottom - top) < 5.0 * 0.4  # the circle has 0.4 m and is a fifth of the panel or more
    (mark,) = crosses(plane)
    assert (mark.get_ydata()[0], mark.get_xdata()[0]) == pytest.approx(tuple(away.run.tip[500]))
    (mark,) = crosses(errors)
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == pytest.approx((away.run.time[500], 1000.0))
    assert [text.get_text() for text in errors.texts] == ["lost beyond 100 mm"]
    assert any(np.allclose(line.get_ydata(), 100.0) for line in errors.lines)


def curve(rng, count, early=0):
    """Errors at random; the first evaluations ended early."""
    return [
        {
            "steps": 250_000 * k,
            **{f"{case}_rms_mm": float(rng.uniform(0.1, 900.0)) for case in CASES},
            **{f"{case}_share": 0.5 if k <= early else 1.0 for case in CASES},
        }
        for k in range(1, count + 1)
    ]


def test_curves_of_every_seed_in_every_case():
    rng = np.random.default_rng(0)
    first = figures.Training("first", {3: curve(rng, 8), 1: curve(rng, 8, early=2), 2: curve(rng, 8)}, 1)
    second = figures.Training("second", {0: curve(rng, 1)}, 0)
    figure = figures.draw_learning_curves([first, second], LEVELS)
    *parts, foot = figure.subfigs
    assert [part.get_suptitle() for part in parts] == ["first", "second"]
    for part, training in zip(parts, (first, second), strict=True):
        assert part.axes[0].get_ylabel() == "rms tip error [mm]"
        for axes, case in zip(part.axes, CASES.values(), strict=True):
            assert axes.get_title(loc="left") == case.title
            assert axes.get_xlabel() == "environment steps [million]"
            assert axes.get_yscale() == "log"
            lines = [line for line in axes.lines if line.get_marker() == "."]
            for line, (seed, rows) in zip(lines, training.curves.items(), strict=True):
                assert line.get_xdata() == pytest.approx([row["steps"] / 1e6 for row in rows])
                assert line.get_ydata() == pytest.approx([row[f"{case.name}_rms_mm"] for row in rows])
                others = [other.get_linewidth() for other in lines if other is not line]
                assert all(line.get_linewidth() > width for width in others) == (seed == training.median_seed)
            early = [point for line in crosses(axes) for point in line.get_xdata()]
            assert early == (pytest.approx([0.25, 0.5]) if training is first else [])
    texts = [text.get_text() for text in foot.legends[0].get_texts()]
    assert texts == ["a seed", "median seed", "fuzzy-4-tip", "computed-torque", "elastic-observer", "ended early"]


def test_lines_for_orientation_are_told_apart_without_colour():
    training = figures.Training("one", {0: curve(np.random.default_rng(0), 4)}, 0)
    part, foot = figures.draw_learning_curves([training], LEVELS).subfigs
    looks = {}
    for handle, text in zip(foot.legends[0].legend_handles, foot.legends[0].get_texts(), strict=True):
        looks[text.get_text()] = str(handle._dash_pattern), handle.get_color()
    assert "ended early" not in looks
    assert len({dashes for dashes, _ in looks.values()}) == 4  # the seeds' are solid
    for axes, case in zip(part.axes, CASES, strict=True):
        flat = {
            line.get_ydata()[0]: (str(line._dash_pattern), line.get_color())
            for line in axes.lines
            if line.get_marker() == "None"
        }
        assert flat == {level: looks[policy] for policy, level in LEVELS[case].items()}
        low, high = axes.get_ylim()
        assert all(low < level < high for level in flat)


@pytest.mark.parametrize(("low", "labels"), [(1e-3, {"0.01", "1", "100"}), (30.0, {"50", "100", "200"})])
def test_numbers_at_the_axis_are_plain(low, labels):
    rows = [
        {"steps": 10**6 * k, **{f"{case}_rms_mm": rms for case in CASES}} for k, rms in enumerate((low, 900.0), start=1)
    ]
    figure = figures.draw_learning_curves([figures.Training("one", {0: rows}, 0)], {case: {} for case in CASES})
    figure.draw_without_rendering()
    axes = figure.subfigs[0].axes[0]
    ticks = [*axes.yaxis.get_majorticklabels(), *axes.yaxis.get_minorticklabels()]
    written = {text.get_text() for text in ticks if text.get_text()}
    assert labels <= written
    assert all(float(text) > 0.0 and "e" not in text for text in written)


def test_png_is_drawn_in_the_style_of_the_project():
    def draw():
        seen.append(matplotlib.rcParams["axes.titlelocation"])
        return Figure()

    seen = []
    with matplotlib.style.context("default"):
        assert figures.png(draw).startswith(b"\x89PNG")
    assert seen == ["left"]
