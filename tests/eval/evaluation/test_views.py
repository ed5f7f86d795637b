"""The view of a path: a plane of unit vectors in which a plane curve keeps its lengths, upright where it can be."""

import numpy as np
import pytest

from fuzzyarm.eval.evaluation.figures import view_of

ANGLES = np.linspace(0.0, 2.0 * np.pi, 50)


def circle(first, second):
    return np.array([0.3, -0.2, 0.5]) + 0.2 * (
        np.cos(ANGLES)[:, np.newaxis] * np.array(first) + np.sin(ANGLES)[:, np.newaxis] * np.array(second)
    )


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
    points = circle(first, second)
    view = view_of(points)
    np.testing.assert_allclose(view.rows @ view.rows.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(view.rows[0], -np.array(up), atol=1e-9)
    seen = view.of(points)
    np.testing.assert_allclose(np.linalg.norm(seen - seen[:-1].mean(axis=0), axis=-1), 0.2, rtol=1e-9)
    assert view.upwards


def test_the_plane_of_the_two_joint_arm_is_taken_as_it_is():
    points = circle((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))[:, :2]
    view = view_of(points)
    assert np.array_equal(view.of(points), points) and not view.upwards
