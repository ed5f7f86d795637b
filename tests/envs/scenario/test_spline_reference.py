"""Joint splines: they pass their postures, are twice differentiable, rest at both ends, and name what fails."""

import re

import numpy as np
import pytest

from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.kinematics import home_posture
from fuzzyarm.envs.scenario.reference import quintic_time_law
from fuzzyarm.envs.scenario.robot_reference import SplineReference

DURATION = 3.0


def postures(robot, count=4):
    """Postures about home, (count, n)."""
    steps = np.random.default_rng(len(robot)).uniform(-0.15, 0.15, (count, len(robot)))
    return np.array(home_posture(robot)) + steps


@pytest.fixture(params=("planar-3r", "panda"))
def reference(request):
    robot = robot_named(request.param)
    return SplineReference(postures(robot), DURATION, robot)


def difference(function, t, h=1e-5):
    return (function(t + h) - function(t - h)) / (2.0 * h)


def test_it_passes_its_postures_and_rests_at_both_ends(reference):
    wanted = postures(reference.robot)
    np.testing.assert_allclose(reference.sample(reference.corners()).q, wanted, atol=1e-13)
    ends = reference.sample([-1.0, 0.0, DURATION, 9.0])
    assert not ends.dq.any()
    assert not ends.ddq.any()
    chords = np.linalg.norm(np.diff(wanted, axis=0), axis=1).cumsum()
    s = quintic_time_law(reference.corners()[1:-1], DURATION)[0]
    np.testing.assert_allclose(s, chords[:-1] / chords[-1], atol=1e-13)


def test_derivatives_match_central_differences_and_do_not_jump_at_the_postures(reference):
    t = np.random.default_rng(0).uniform(0.01, DURATION - 0.01, 100)
    _, dq, ddq = reference.sample(t)
    np.testing.assert_allclose(difference(lambda x: reference.sample(x).q, t), dq, rtol=0, atol=1e-8)
    np.testing.assert_allclose(difference(lambda x: reference.sample(x).dq, t), ddq, rtol=0, atol=1e-4)
    inner = reference.corners()[1:-1]
    for before, after in zip(reference.sample(inner - 1e-9), reference.sample(inner + 1e-9), strict=True):
        np.testing.assert_allclose(before, after, atol=1e-7)


def test_limits_name_the_joint_and_the_way_out():
    robot = robot_named("panda")
    home = np.array(home_posture(robot))
    beyond = home.copy()
    beyond[3] = 0.1
    with pytest.raises(
        ValueError, match=r"waypoints\[1\]: \w+ = 0\.1 rad is out of range; allowed: \[-3\.0718, -0\.0698\]"
    ):
        SplineReference((home, beyond), DURATION, robot)
    edge = np.tile(home, (4, 1))
    edge[:, 3] = (-1.5, -0.08, -0.3, -2.0)
    edge[:, 0] = (0.0, 0.1, 0.2, 0.3)
    with pytest.raises(ValueError, match=r"joint4 leaves its range at t = .* by 0\.\d+ rad .*Add waypoints"):
        SplineReference(edge, DURATION, robot)
    with pytest.raises(ValueError, match=r"turns at .* beyond its velocity limit.*Raise duration") as error:
        SplineReference((home, home - 0.5), 0.2, robot)
    needed = float(re.search(r"to (\S+) s or more", str(error.value)).group(1))
    SplineReference((home, home - 0.5), needed, robot)


@pytest.mark.parametrize(
    ("waypoints", "error", "message"),
    [
        (3.0, TypeError, "waypoints = 3.0 must be a sequence of postures"),
        ([(0.0,) * 6], ValueError, "waypoints holds 1 postures; allowed: 2 to"),
        ([(0.0,) * 6, (0.1,) * 5], ValueError, r"waypoints\[1\] = .* must be 6 real numbers"),
        ([(0.1,) * 6, (0.1,) * 6], ValueError, r"waypoints\[0\] and waypoints\[1\] are 0 rad apart"),
        ([(0.1,) * 6, ("up",) * 6], TypeError, r"waypoints\[1\]\[0\] = 'up' must be a real number"),
    ],
)
def test_bad_waypoints_are_named(waypoints, error, message):
    with pytest.raises(error, match=message):
        SplineReference(waypoints, DURATION, robot_named("ur5"))
