"""Pictures of robots in perspective: a camera that is one, and what is drawn where the robot is."""

import numpy as np
import pytest
from support.robots import ROBOTS, skewed_robot

from fuzzyarm.envs._pictures import FOOTER, FORCE, HEADER, HEIGHT, PAYLOAD, REFERENCE, TRACE, WIDTH, Canvas, paint
from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.perspective import floor_of, looking_at, poses_of, upwards
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.rigid_body import frames
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.envs.scenario.robot_reference import SplineReference

LOW, HIGH = np.array([0.0, 0.0]), np.array([300.0, 200.0])


def some_paths(count=40):
    """Yield circles, lines and knots of 60 points near a robot."""
    generator, angle = np.random.default_rng(1), np.linspace(0.0, 2.0 * np.pi, 60)[:, np.newaxis]
    for number in range(count):
        center, first, second = generator.normal(size=(3, 3))
        third = generator.normal(size=3) * (number % 3 == 0)
        yield center + 0.2 * (np.cos(angle) * first + (number % 4 > 0) * np.sin(angle) * second + angle * third)


@pytest.mark.parametrize("name", ["ur5", "planar-3r", "skewed"])
def test_the_camera_stands_level_and_above_and_has_the_path_to_its_right(name):
    robot = ROBOTS[name]
    up = upwards(robot)
    for path in [*some_paths(), np.outer(np.linspace(1.0, 2.0, 9), up), np.zeros((9, 3))]:
        camera = looking_at(robot, path)
        right, down, ahead = camera.axes
        np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(np.cross(right, down), ahead, atol=1e-12)
        assert abs(right @ up) < 1e-12 and down @ up < 0.0 and ahead @ up < -0.1
        assert right @ path.mean(axis=0) >= -1e-9


def test_a_path_is_seen_openly_whatever_plane_it_is_in():
    """A circle of radius 1 has the area π face-on; the arm's plane, side and floor leave at least half of that."""
    angle, robot = np.linspace(0.0, 2.0 * np.pi, 361)[:, np.newaxis], robot_named("ur5")
    x, y, z = np.eye(3)
    for first, second in ((x, z), (y, z), (x, y)):  # along the arm, across it, level
        path = x + 0.01 * (np.cos(angle) * first + np.sin(angle) * second)
        camera = looking_at(robot, path)
        a, b = (camera.pixels(path) / 0.01 * camera.depth(path.mean(axis=0))).T
        area = 0.5 * np.abs(np.sum(a[:-1] * np.diff(b) - b[:-1] * np.diff(a)))
        assert area > 0.5 * np.pi


def test_lines_stay_lines_and_keep_their_cross_ratio():
    """What a pinhole keeps: the cross ratio (AC·BD)/(BC·AD) of four points of a line."""
    generator = np.random.default_rng(0)
    camera = looking_at(robot_named("ur5"), next(some_paths()))._replace(focal=700.0, center=np.array([3.0, 4.0]))
    for start, along in generator.normal(size=(20, 2, 3)):
        places = np.array([0.0, 0.3, 0.5, 0.9])
        seen = camera.pixels(start + places[:, np.newaxis] * along)
        direction = (seen[-1] - seen[0]) / np.linalg.norm(seen[-1] - seen[0])
        t = (seen - seen[0]) @ direction
        np.testing.assert_allclose(seen, seen[0] + t[:, np.newaxis] * direction, atol=1e-9)

        def ratio(a, b, c, d):
            return (c - a) * (d - b) / ((c - b) * (d - a))

        np.testing.assert_allclose(ratio(*t), ratio(*places), rtol=1e-9)


def test_a_fitted_camera_fills_the_field():
    generator = np.random.default_rng(0)
    camera = looking_at(robot_named("ur5"), next(some_paths()))
    for _ in range(10):
        points = generator.normal(size=(6, 3)) * 10.0 ** generator.uniform(-2.0, 0.0)
        seen = camera.fitted(points, LOW, HIGH).pixels(points)
        assert (seen > LOW - 1e-9).all() and (seen < HIGH + 1e-9).all()
        np.testing.assert_allclose(seen.min(axis=0) + seen.max(axis=0), LOW + HIGH)
        assert np.isclose(np.ptp(seen, axis=0) / (HIGH - LOW), 1.0).any()


def test_poses_end_at_the_tip_and_shadows_fall_along_gravity_onto_a_floor_below():
    robot = skewed_robot()
    q = np.random.default_rng(0).uniform(-3.0, 3.0, (20, len(robot)))
    poses = poses_of(robot, q)
    lengths = np.linalg.norm(np.diff(poses.points, axis=1), axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], lengths.shape))
    np.testing.assert_allclose(poses.points[:, -1], frames(robot, q).tip)
    floor = floor_of(robot, poses.points)
    fall = poses.points - floor.below(poses.points)
    assert (fall @ floor.up > -1e-12).all()
    np.testing.assert_allclose(fall, (fall @ floor.up)[..., np.newaxis] * floor.up, atol=1e-12)
    np.testing.assert_allclose(floor.grid @ floor.up, floor.height)


def picture(robot, disturbance, deviation=(0.0, 0.0, 0.0)):
    """Return a picture of a robot with its tip off the reference, and where the camera sees reference and tip."""
    start = np.full(len(robot), 0.4)
    reference = SplineReference(np.array([start, start + 0.3]), 0.5, robot)
    schedule = Schedule.build(reference, disturbance, 1e-3)
    longest = max(len(robot), 3)
    trace = np.zeros((1, len(VECTORS), longest))
    tip = frames(robot, start).tip
    for name, values in {
        "tip": tip + np.array(deviation),
        "tip_reference": tip,
        "q_link": start,
        "external_force": schedule.forces[0, :3],
    }.items():
        trace[0, VECTORS.index(name), : len(values)] = values
    canvas = Canvas()
    paint(canvas, schedule, trace, 0.0, robot)
    return canvas.array()


def place(frame, colour):
    """Return the middle (right, down) of the pixels of a colour in the field, and how many there are."""
    field = slice(HEADER + 2, HEIGHT - FOOTER - 2)
    down, right = np.nonzero((frame[field] == colour).all(axis=-1))
    return np.array([right.mean(), down.mean() + field.start]) if len(right) else None, len(right)


@pytest.mark.parametrize("name", ["ur5", "skewed"])
def test_the_tip_error_is_magnified_and_gravity_points_down(name):
    robot = ROBOTS[name]
    still, lower = picture(robot, Disturbance()), picture(robot, Disturbance(), -0.002 * upwards(robot))
    assert still.shape == (HEIGHT, WIDTH, 3) and place(still, REFERENCE)[1] > 20
    (at, _), (below, _) = place(still, TRACE), place(lower, TRACE)
    assert abs(below[0] - at[0]) < 3.0 and below[1] - at[1] > 5.0


def test_loads_are_drawn_where_they_act():
    robot = robot_named("ur5")
    bare, pushed = (picture(robot, Disturbance(tip_force=force)) for force in (None, ConstantForce((0.0, 0.0, -9.0))))
    assert place(bare, FORCE)[1] == 0 and place(pushed, FORCE)[1] > 50
    assert place(pushed, FORCE)[0][1] < place(bare, TRACE)[0][1]  # pushed down, the arrow comes from above
    loaded = picture(robot, Disturbance(payload=Payload(2.0)), 0.01 * upwards(robot))
    at, count = place(loaded, PAYLOAD)
    assert count > 50 and np.hypot(*(at - place(bare, TRACE)[0])) < 4.0
    weightless = Robot("weightless", robot.joints, robot.tip, (0.0, 0.0, 0.0))
    assert place(picture(weightless, Disturbance()), TRACE)[1] > 50
