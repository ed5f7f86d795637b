"""The figures: what is in them, and the files they become."""

import dataclasses
from unittest import mock

import matplotlib
import numpy as np
import pytest
from PIL import Image
from support.rollouts import made_rollout

from fuzzyarm.eval.evaluation.figures import _FOCUS, _time_figures, _view_of, draw_figures, write_figures

WITHOUT_FORCE = ("path", *_time_figures(2))
WITH_FORCE = (*WITHOUT_FORCE, "force")


def circle(phase):
    return np.column_stack([0.35 + 0.2 * np.cos(phase), 0.65 + 0.2 * np.sin(phase)])


def line(phase):
    return np.column_stack([0.4 + 0.1 * phase / 6.0, 0.5 + 0.0 * phase])


def episode(policy="a", case="nominal", *, samples=60, error=1e-3, completed=True, curve=circle):
    """Return a made-up rollout whose tip goes round `curve` with deviations of size `error` [m]."""
    phase = np.linspace(0.0, 2.0 * np.pi, 60)[:samples]
    wave = np.column_stack([np.sin(3.0 * phase), np.cos(5.0 * phase)])
    return made_rollout(
        0.025 * np.arange(1, samples + 1),
        policy=policy,
        case=case,
        control_period=0.025,
        completed=completed,
        reason="" if completed else "left the joint domain",
        tip=curve(phase) + error * wave,
        tip_reference=curve(phase),
        tip_error=error * np.hypot(*wave.T),
        circularity_error=error * wave[:, 0],
        circularity_error_motor=0.1 * error * wave[:, 1],
        q_motor=wave + error,
        **dict.fromkeys(("q_link", "q_reference"), wave),
        **dict.fromkeys(("dq_motor", "dq_link", "dq_reference"), 3.0 * wave),
        torque=100.0 * wave,
        friction_torque=np.sign(wave),
        external_force=wave * (150.0 if case == "machining" else 0.0),
    )


def figures_of(rollouts, *names):
    """Draw the path, the overview and these figures over time: each takes a twentieth of a second."""
    kept = {name: panels for name, panels in _time_figures(2).items() if name in names}
    with mock.patch("fuzzyarm.eval.evaluation.figures._time_figures", return_value=kept):
        return draw_figures(rollouts)


TWO = [episode("fuzzy-4"), episode("computed-torque", error=2e-3)]


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def crosses(axes):
    return [line.get_xydata()[0] for line in axes.lines if line.get_marker() == "x"]


def curves(axes, samples):
    """Return the lines of the policies: those with as many points that are neither reference."""
    return [line for line in axes.lines if len(line.get_xdata()) == samples and line.get_label() != "reference"]


@pytest.mark.slow
def test_every_figure_is_written_in_both_formats_with_the_same_bytes_whatever_the_global_settings(tmp_path):
    second, calls = tmp_path / "second", []
    rollouts = [*TWO, *(dataclasses.replace(one, case="payload") for one in TWO), episode("fuzzy-4", "machining")]
    paths = write_figures(rollouts, tmp_path, lambda: calls.append(1))
    names = {f"{case}-{name}" for case in ("nominal", "payload") for name in WITHOUT_FORCE}
    names |= {f"machining-{name}" for name in WITH_FORCE} | {"overview"}
    assert {path.name for path in paths} == {f"{name}.{kind}" for name in names for kind in ("png", "svg")}
    assert set(tmp_path.iterdir()) == set(paths) and len(calls) == len(names)
    with Image.open(tmp_path / "overview.png") as picture:
        assert picture.width >= 800 and picture.info["dpi"] == pytest.approx((150, 150), abs=0.1)
    with matplotlib.rc_context({"font.size": 20.0, "xtick.direction": "in", "axes.labelpad": 30.0}):
        before = dict(matplotlib.rcParams)
        second.mkdir()
        again = write_figures(TWO, second)
        assert dict(matplotlib.rcParams) == before
    for path in again:
        if path.suffix == ".svg" and path.name != "overview.svg":
            assert path.read_bytes() == (tmp_path / path.name).read_bytes()


@pytest.mark.parametrize("curve", [circle, line])
def test_axes_have_labels_with_units_and_legends_name_every_policy(curve):
    figures = draw_figures([episode("a", "machining", curve=curve), episode("b", "machining", curve=curve)])
    assert set(figures) == {*(f"machining-{name}" for name in WITH_FORCE), "overview"}
    for name, figure in figures.items():
        labels = [figure.axes[-1].get_xlabel(), *(axes.get_ylabel() for axes in figure.axes)]
        assert all(label.endswith("]") and "[" in label for label in labels), name
        is_round = curve is circle and name in ("machining-circularity", "overview")
        assert any("circularity" in label for label in labels) == is_round
        if name != "machining-force":
            assert set(legend(figure)) >= {"a", "b"}
        assert "ended early" not in legend(figure)


@pytest.mark.parametrize(("error", "magnified"), [(1e-3, 20), (30e-3, 2)])
def test_the_path_is_drawn_with_x_down_and_magnified_deviations(error, magnified):
    axes = figures_of([episode(error=error)])["nominal-path"].axes[0]
    assert axes.get_title("left").endswith(f"× {magnified}") and axes.get_aspect() == 1.0
    bottom, top = axes.get_ylim()
    assert bottom > top
    reference, drawn = episode().tip_reference, curves(axes, 60)[0].get_xydata()
    expected = reference + magnified * (episode(error=error).tip - reference)
    np.testing.assert_allclose(drawn[:, ::-1], expected, atol=1e-12)


def test_circularity_is_that_of_the_tip_and_below_it_that_of_the_motors_on_the_same_scale():
    link, motor = figures_of([episode(error=1e-3)], "circularity")["nominal-circularity"].axes
    np.testing.assert_allclose(curves(link, 60)[0].get_ydata(), 1e3 * episode().circularity_error)
    np.testing.assert_allclose(curves(motor, 60)[0].get_ydata(), 1e3 * episode().circularity_error_motor)
    assert motor.get_ylim() == link.get_ylim()
    assert "circularity error" in link.get_ylabel() and "error" not in motor.get_ylabel()


def test_tip_errors_decades_apart_are_all_seen():
    good, bad = episode("good", error=3e-6), episode("bad", error=20e-3)
    tip = figures_of([good, bad])["overview"].axes[0]
    assert tip.get_yscale() == "log"
    lowest, peak = tip.get_ylim()  # mm; from the decade that the best one is above, but for a twentieth of the time
    assert lowest == 1e-3 and peak == pytest.approx(1.5e3 * bad.tip_error.max())
    for line, drawn in zip(curves(tip, 60), (good, bad), strict=True):
        np.testing.assert_allclose(line.get_ydata(), np.maximum(1e3 * drawn.tip_error, lowest))
        assert np.mean(line.get_ydata() > lowest) >= 0.95
    assert not tip.texts


def test_an_episode_that_ended_early_is_marked():
    short = episode("b", samples=20, completed=False)
    for name, figure in draw_figures([episode("a"), short]).items():
        assert legend(figure)[-1] == "ended early", name
        for axes in figure.axes:
            ((first, _),) = crosses(axes)
            assert first == short.time[-1] or name.endswith("path")
    for figure in draw_figures([episode(samples=1, completed=False)]).values():
        figure.draw_without_rendering()
    friction = draw_figures([short])["nominal-friction"].axes[0]
    assert tuple(crosses(friction)[0]) == (short.time[-1], short.friction_torque[-1, 0])


def test_the_path_of_a_lost_arm_is_whole_or_named():
    lost = episode("lost", samples=20, error=0.5, completed=False)
    alone = figures_of([lost])["nominal-path"].axes[0]
    (right, bottom), (left, top) = lost.tip.max(axis=0)[::-1], lost.tip.min(axis=0)[::-1]
    assert alone.get_xlim()[0] < left and right < alone.get_xlim()[1]
    assert alone.get_ylim()[1] < top and bottom < alone.get_ylim()[0]
    np.testing.assert_allclose(crosses(alone), [lost.tip[-1, ::-1]])
    assert not any(text.get_text() for text in alone.texts)
    beside = figures_of([episode("good"), lost])["nominal-path"].axes[0]
    said = [text.get_text() for text in beside.texts if text.get_text()]
    assert said == [f"off the scale:\nlost up to {1e3 * lost.tip_error.max():.3g} mm"]


@pytest.mark.parametrize("completed", [True, False])
def test_a_policy_far_off_does_not_flatten_the_others(completed):
    bad = episode("bad", samples=50, error=20 * _FOCUS * 1e-3, completed=completed)
    figures = figures_of([episode("good"), bad], "torque")
    error = figures["overview"].axes[1]
    assert error.get_ylim()[1] < 1.2  # mm; the good one reaches 1.0
    assert "bad up to" in error.texts[0].get_text()
    assert all(y in error.get_ylim() for _, y in crosses(error))
    assert not figures["nominal-torque"].axes[0].texts


def test_a_missing_folder_is_an_error_and_stays_missing(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_figures(TWO, tmp_path / "missing")
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="rollouts is empty; give at least one"):
        write_figures([], tmp_path)


@pytest.mark.parametrize(
    ("first", "second", "up"),
    [
        ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((0.6, 0.8, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)),
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
        ((1.0, 0.0, 0.0), (0.0, 0.6, 0.8), (0.0, 0.6, 0.8)),
    ],
)
def test_a_circle_in_space_is_seen_face_on_and_upright(first, second, up):
    angles = np.linspace(0.0, 2.0 * np.pi, 50)
    points = [0.3, -0.2, 0.5] + 0.2 * (np.outer(np.cos(angles), first) + np.outer(np.sin(angles), second))
    view = _view_of(points)
    np.testing.assert_allclose(view.rows @ view.rows.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(view.rows[0], -np.array(up), atol=1e-9)
    seen = view.of(points)
    np.testing.assert_allclose(np.linalg.norm(seen - seen[:-1].mean(axis=0), axis=-1), 0.2, rtol=1e-9)
    assert view.upwards
