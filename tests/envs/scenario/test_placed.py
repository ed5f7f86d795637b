"""Plane curves placed in space."""

import numpy as np
import pytest

from fuzzyarm.envs.scenario.paths import Circle, Placed, Spline

S = np.linspace(0.0, 1.0, 41)
AXES = ((0.0, 0.6, 0.8), (1.0, 0.0, 0.0))
CURVE = Spline(((0.6, 0.1), (0.5, 0.5), (0.1, 0.6), (-0.3, 0.5)))


def test_lengths_and_derivatives_are_those_of_the_plane_curve():
    placed = Placed(CURVE, (0.1, 0.2, 0.3), *AXES)
    for order, (mine, plane) in enumerate(zip(placed.points(S), CURVE.points(S), strict=True)):
        shifted = mine - (0.1, 0.2, 0.3) if order == 0 else mine
        np.testing.assert_allclose(shifted @ np.array(AXES).T, plane, atol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(shifted, axis=-1), np.linalg.norm(plane, axis=-1), atol=1e-14)
    np.testing.assert_array_equal(placed.corners, CURVE.corners)


def test_left_normals_lie_in_the_plane_and_turn_with_the_curve():
    circle = Placed(Circle(center=(0.0, 0.0), turns=1.0), (0.0, 0.0, 0.0), *AXES)
    inwards = -circle.points(S)[0] / 0.2
    np.testing.assert_allclose(circle.normals(S), inwards, atol=1e-14)


@pytest.mark.parametrize(("first", "second"), [((1.0, 0.0, 0.0), (0.1, 1.0, 0.0)), ((2.0, 0.0, 0.0), (0.0, 1.0, 0.0))])
def test_axes_must_be_unit_vectors_at_right_angles(first, second):
    with pytest.raises(ValueError, match=r"must be unit vectors at right angles; their lengths are"):
        Placed(CURVE, (0.0, 0.0, 0.0), first, second)


def test_it_needs_a_curve_and_triples():
    with pytest.raises(TypeError, match="must have a method points"):
        Placed(1.0, (0.0, 0.0, 0.0), *AXES)
    with pytest.raises(ValueError, match=r"first = .* must be 2 real numbers"):
        Placed(CURVE, (0.0, 0.0), *AXES)
