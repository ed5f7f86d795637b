"""Tip curves: derivatives, closure, the shapes they claim to be, and paths by points of a file."""

import math

import numpy as np
import pytest
from support.differences import LOOP, WAYPOINTS, central_difference
from support.differences import PATHS as REACHED

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.envs.scenario.paths import Circle, Line, Placed, Spline, Square, TipPath

PATHS = REACHED | {
    "two turns": Circle(center=(0.3, 0.3), radius=0.1, start_angle=-1.0, turns=2.0),
    "square": Square((0.1, -0.2), 0.3),
    "two-point spline": Spline(np.array(WAYPOINTS[:2])),
}


@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
def test_paths_are_values_whose_shapes_follow_s_and_whose_derivatives_match_central_differences(path):
    s = np.random.default_rng(0).uniform(0.01, 0.99, 200)
    _, dp, ddp = path.points(s)
    np.testing.assert_allclose(central_difference(lambda x: path.points(x)[0], s), dp, rtol=0, atol=2e-7)
    np.testing.assert_allclose(central_difference(lambda x: path.points(x)[1], s), ddp, rtol=0, atol=1e-5)
    s = np.linspace(0.0, 1.0, 12).reshape(3, 4)
    for whole, single in zip(path.points(s), path.points(s[2, 1]), strict=True):
        assert whole.shape == (3, 4, 2) and single.shape == (2,)
        np.testing.assert_allclose(single, whole[2, 1], rtol=1e-14, atol=1e-14)
        whole[0] = 0.0  # the caller owns the arrays
    assert isinstance(path, TipPath)
    assert hash(path) == hash(type(path)(**{name: getattr(path, name) for name in path.__dataclass_fields__}))


@pytest.mark.parametrize("name", ["paper circle", "two turns", "lemniscate", "closed spline"])
def test_closed_paths_close_with_both_derivatives(name):
    np.testing.assert_allclose(PATHS[name].points(0.0), PATHS[name].points(1.0), rtol=0, atol=1e-12)


def test_circle_square_and_lemniscate_satisfy_their_equations():
    p, dp, _ = Circle().points(np.array([0.0, 0.25]))
    np.testing.assert_allclose(p, [[0.35, 0.85], [0.55, 0.65]], atol=1e-15)  # from psi = pi/2 down to psi = 0
    np.testing.assert_allclose(dp[0], [2.0 * math.pi * 0.2, 0.0], atol=1e-15)
    p = PATHS["arc"].points(np.linspace(0.0, 1.0, 20))[0] - 0.3
    np.testing.assert_allclose(np.hypot(p[:, 0], p[:, 1]), 0.3, rtol=1e-14)
    assert math.atan2(p[-1, 1], p[-1, 0]) == pytest.approx(0.4 + 0.6 * math.pi)
    p = PATHS["square"].points(np.linspace(0.0, 1.0, 401))[0]
    np.testing.assert_allclose(np.sum((p - (0.1, -0.2)) ** 8, axis=1), 0.3**8, rtol=1e-10)
    p = PATHS["lemniscate"].points(np.linspace(0.0, 1.0, 101))[0] - 0.4
    x = math.cos(0.5) * p[:, 0] + math.sin(0.5) * p[:, 1]
    y = -math.sin(0.5) * p[:, 0] + math.cos(0.5) * p[:, 1]
    np.testing.assert_allclose(x**4, 0.2**2 * (x**2 - y**2), rtol=0, atol=1e-16)
    assert (x.max(), y[10]) == pytest.approx((0.2, 0.1 * math.sin(0.4 * math.pi)), rel=1e-12)


@pytest.mark.parametrize(("points", "closed"), [(WAYPOINTS, False), (LOOP, True)])
def test_spline_passes_its_waypoints_at_their_chord_lengths(points, closed):
    corners = np.array(points + points[:1] if closed else points)
    chords = np.cumsum(np.hypot(*np.diff(corners, axis=0).T))
    s, path = np.append(0.0, chords / chords[-1]), Spline(np.array(points), closed)
    np.testing.assert_allclose(path.points(s)[0], corners, atol=1e-14)
    inner = s[1:-1]  # where it is twice continuously differentiable
    np.testing.assert_allclose(path.points(inner - 1e-9), path.points(inner + 1e-9), atol=1e-5)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Circle(turns=0), r"turns = 0.0 is out of range; allowed: ±\[1e-06, 1e\+06\]"),
        (lambda: Line((0.1, 0.2), (0.1, 0.2)), r"start = .* and end = .* are 0 m apart; allowed: \[1e-06, inf\) m"),
        (lambda: Line((0.1, 0.2, 0.3, 0.4), (0.0, 0.0)), r"start = .* must be 2 real numbers"),
        (lambda: Line((0.1, 0.2, 0.3), (0.0, 0.0)), r"end = \(0.0, 0.0\) must be 3 real numbers"),
        (lambda: Spline(((0.1, 0.2, 0.3), (0.0, 0.0))), r"waypoints\[1\] = .* must be 3 real numbers"),
        (lambda: Spline([(0.1, 0.2)]), r"waypoints has fewer than 2 points; allowed: 2 to"),
        (lambda: Spline([(0.1, 0.2), (0.3, 0.4), (0.3, 0.4)]), r"waypoints\[1\] .* and waypoints\[2\] .* 0 m apart"),
        (lambda: Placed(Circle(), (0.0,) * 3, (1.0, 0.0, 0.0), (0.1, 1.0, 0.0)), "must be unit vectors at right"),
        (lambda: Placed(Circle(), (0.0,) * 3, (2.0, 0.0, 0.0), (0.0, 1.0, 0.0)), "right angles; their lengths are"),
        (lambda: Placed(1.0, (0.0,) * 3, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), "needs a method points"),
        (lambda: Placed(Circle(), (0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), "first = .* must be 2 real numbers"),
        (lambda: Spline([*LOOP, LOOP[0]], closed=True), r"waypoints\[4\] .* and waypoints\[0\] .* 0 m apart"),
    ],
)
def test_bad_values_raise_with_name_value_and_range(build, message):
    with pytest.raises((TypeError, ValueError), match=message):
        build()


@pytest.mark.parametrize("curve", [PATHS["spline"], PATHS["paper circle"]], ids=["spline", "circle"])
def test_a_placed_curve_is_the_plane_one_in_its_axes(curve):
    axes, origin, s = ((0.0, 0.6, 0.8), (1.0, 0.0, 0.0)), (0.1, 0.2, 0.3), np.linspace(0.0, 1.0, 41)
    placed = Placed(curve, origin, *axes)
    mine, plane = np.array(placed.points(s)), np.array(curve.points(s))
    mine[0] -= origin
    np.testing.assert_allclose(mine @ np.array(axes).T, plane, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(mine, axis=-1), np.linalg.norm(plane, axis=-1), atol=1e-14)
    np.testing.assert_array_equal(placed.corners, getattr(curve, "corners", ()))
    if isinstance(curve, Circle):  # which turns clockwise: the left normal points outwards
        outwards = (curve.points(s)[0] - curve.center) / curve.radius
        np.testing.assert_allclose(placed.normals(s), outwards @ np.array(axes), atol=1e-14)


UNEVEN = ArmParameters(length=(0.5, 0.2), mass_center=(0.25, 0.1))


def test_points_of_a_file_are_followed(tmp_path):
    csv = tmp_path / "way.csv"
    csv.write_text("x,y\n0.4,0.5\n0.5,0.4\n0.5,0.6\n0.4,0.5\n", encoding="utf-8")
    given = GivenPath.read(csv)
    assert given == GivenPath(((0.4, 0.5), (0.5, 0.4), (0.5, 0.6)), closed=True)
    reference = given.reference(ArmParameters())
    assert reference.elbow_sign == 1
    tip = reference.tip(np.linspace(0.0, reference.duration, 4001)).position
    for point in given.points:
        assert np.linalg.norm(tip - point, axis=1).min() < 1e-3
    toml = tmp_path / "way.toml"
    toml.write_text("points = [[0.4, 0.5], [0.5, 0.4]]\nduration = 3.0\n", encoding="utf-8")
    assert GivenPath.read(toml).reference(UNEVEN).duration == 3.0


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "\n1,2\n3,x\n", "entry 2 of line 3 is 'x', which is not a number; each .* be x,y or x,y,z in metres"),
        ("a.csv", "O.4,0.5\n0.5,0.4\n0.5,0.6\n", "entry 1 of line 1 is 'O.4'"),
        ("a.csv", "x;y\n0.4;0.5\n0.5;0.6\n", "entry 1 of line 1 is 'x;y'"),
        ("a.csv", "x,y\n0.4,0.5\nx,y\n0.5,0.4\n", "entry 1 of line 3 is 'x'"),
        ("a.csv", "0.4,nan\n0.5,0.4\n0.5,0.6\n", "entry 2 of line 1 is 'nan'"),
        ("a.csv", "0.4\n0.5\n", "point 1 = .* must be 2 real numbers"),
        ("a.csv", "0.4,0.5\n", "fewer than 2 points"),
        ("a.toml", "pts = [[0.4, 0.5]]\n", "unknown field pts; known: closed, duration, points"),
        ("a.toml", "points = [[0.4, 0.5], [0.5, 0.4]]\nduration = -1.0\n", "duration = -1.0 s is out of range"),
    ],
)
def test_a_bad_file_is_named(name, text, message, tmp_path):
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message) as caught:
        GivenPath.read(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path))


@pytest.mark.parametrize(
    ("points", "arm", "message"),
    [
        (((1.5, 0.0), (0.5, 0.5)), ArmParameters(), r"--path: .* 1.5 m from .* reaches 0 to 1 m; .* 0.5 m"),
        (((0.5, -0.2), (0.0, 0.0), (0.5, 0.2)), UNEVEN, r"reaches 0.3 to 0.7 m; move .* by 0.3 m"),
        (((0.5, 0.0, 0.2), (2.0, 0.0, 0.0)), "ur5", r"--path: point \(2, 0, 0\) m is 2\.\d* m from the base"),
        (((0.5, 0.0), (0.5, 0.5)), "ur5", "the points have 2 coordinates; needed: x, y, z for ur5"),
    ],
)
def test_a_path_out_of_reach_says_by_how_much(points, arm, message):
    with pytest.raises(ValueError, match=message):
        GivenPath(points).reference(robot_named(arm) if arm == "ur5" else arm)
