"""Pictures: true to the state, in perspective for robots, without a display or in a window that may be closed."""

import contextlib
import copy
import dataclasses
import os
import pickle
import subprocess
import sys

import numpy as np
import pygame
import pytest
from gymnasium.error import ResetNeeded
from support.robots import ROBOTS

from fuzzyarm.envs._pictures import FOOTER, FORCE, HEADER, HEIGHT, INK, PAYLOAD, REFERENCE, TRACE, WIDTH, Canvas, paint
from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.perspective import floor_of, looking_at, poses_of, upwards
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import frames
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.envs.scenario.reference import JointReference, joint_angles
from fuzzyarm.envs.scenario.robot_reference import SplineReference

LENGTH = ArmParameters().length
LOW, HIGH = np.array([0.0, 0.0]), np.array([300.0, 200.0])
FIELD = slice(HEADER + 2, HEIGHT - FOOTER - 2)
HEADLESS = """
import pygame
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
env = FuzzyArmEnv(render_mode="rgb_array")
env.reset()
env.step([0.0, 0.0])
assert env.render().max() == 255
assert not pygame.display.get_init() and not pygame.get_init()
env.close()
"""


def pixels(frame, colour):
    """(right, down) of each pixel of exactly this colour between header and footer, shape (n, 2)."""
    down, right = np.nonzero((frame[FIELD] == colour).all(axis=-1))
    return np.stack([right, down + FIELD.start], axis=-1)


def at_rest(q):
    return [*q, *q, 0.0, 0.0, 0.0, 0.0]


def moved(offset, **options):
    """Return reset options that put the tip `offset` [m] away from the start of the paper's reference."""
    tip = JointReference().tip(0.0).position + np.array(offset)
    return {"initial_state": at_rest(joint_angles(tip, LENGTH, 1)), **options}


def stepped(*envs, steps=1, torque=(0.0, 0.0)):
    for env in envs:
        for _ in range(steps):
            env.step(np.array(torque))


@pytest.fixture
def env():
    with contextlib.closing(FuzzyArmEnv(render_mode="rgb_array")) as env:
        yield env


@pytest.fixture
def window(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with contextlib.closing(FuzzyArmEnv(render_mode="human")) as env:
        yield env


def test_arrays_need_no_display_in_a_fresh_interpreter():
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    seen = {name: value for name, value in os.environ.items() if name not in hidden}
    done = subprocess.run([sys.executable, "-W", "error", "-c", HEADLESS], env=seen, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_each_frame_is_a_new_array_and_a_reset_begins_again(env):
    with pytest.raises(ResetNeeded, match=r"env\.reset"):
        env.render()
    env.reset()
    first = env.render()
    assert first.shape == (HEIGHT, WIDTH, 3) and first.dtype == np.uint8 and first.flags.c_contiguous
    kept = first.copy()
    first[:] = 0
    np.testing.assert_array_equal(env.render(), kept)
    stepped(env, steps=400)
    assert (env.render()[FIELD] != kept[FIELD]).any()
    env.reset()
    np.testing.assert_array_equal(env.render(), kept)
    with pytest.raises(ValueError, match="initial_state"):
        env.reset(options={"initial_state": [9.0] * 8})
    with pytest.raises(ResetNeeded, match=r"env\.reset"):
        env.render()


@pytest.mark.parametrize("offset", [(0.0, 0.002), (-0.003, -0.001)])
def test_trace_shows_the_magnified_error(env, offset):
    env.reset(options=moved(offset))
    frame = env.render()
    curve = pixels(frame, REFERENCE)
    # The curve is a circle of 0.2 m that starts at its rightmost point: scale and origin follow from the picture.
    right, low, high = curve[:, 0].max(), curve[:, 1].min(), curve[:, 1].max()
    expected = np.array([right, (low + high) / 2.0]) + 25.0 * (high - low) / 0.4 * np.array(offset)[::-1]
    np.testing.assert_allclose(pixels(frame, TRACE).mean(axis=0), expected, atol=4.0)


@pytest.mark.parametrize("robot", [None, "planar-3r"])
def test_a_thrown_arm_and_its_trace_stay_in_the_field(robot):
    env, ended = FuzzyArmEnv(render_mode="rgb_array", robot=robot), False
    env.reset()
    start = env.render()
    while not ended:
        *_, ended, _, info = env.step(env.action_space.high)
    frame = env.render()
    env.close()
    assert info["tip_error"] > 0.3
    for colour in (INK, TRACE):
        seen = pixels(frame, colour)
        assert len(seen) > 20 and (seen > [2, HEADER + 4]).all() and (seen < [WIDTH - 2, HEIGHT - FOOTER - 4]).all()
    # The legend says that the trace is magnified by another factor than at the start.
    assert (frame[HEIGHT - FOOTER + 4 :, : WIDTH // 2] != start[HEIGHT - FOOTER + 4 :, : WIDTH // 2]).any()


def test_trace_holds_every_step_even_if_drawn_once(env):
    frames = []
    env.reset()
    for _ in range(15):
        env.step(np.zeros(2))
        frames.append(env.render())
    env.reset()
    stepped(env, steps=15)
    np.testing.assert_array_equal(env.render(), frames[-1])
    assert len(pixels(frames[-1], TRACE)) > len(pixels(frames[0], TRACE))


@pytest.mark.parametrize("case", CASES)
def test_force_and_payload_only_where_they_act(env, case):
    env.reset(options={"case": case})
    stepped(env, steps=100)
    frame = env.render()
    assert (len(pixels(frame, FORCE)) > 100) == (case == "machining")
    assert (len(pixels(frame, PAYLOAD)) > 100) == (case == "payload")


def test_force_arrow_ends_at_the_tip_and_points_along_the_force(env):
    # 3 N down, 4 N to the right: the arrow lies up and left of the tip, which starts at the right end of the curve.
    env.reset(options={"disturbance": Disturbance(tip_force=ConstantForce((3.0, 4.0)))})
    stepped(env)
    frame = env.render()
    curve, arrow = pixels(frame, REFERENCE), pixels(frame, FORCE)
    tip = np.array([curve[:, 0].max(), (curve[:, 1].min() + curve[:, 1].max()) / 2.0])
    back = tip - arrow.mean(axis=0)
    np.testing.assert_allclose(back / np.hypot(*back), [0.8, 0.6], atol=0.15)
    assert np.hypot(*(arrow - tip).T).max() < 130.0


def test_payload_hangs_where_it_is_attached(env):
    centers = {}
    for at in ("tip", "link"):
        # The trace's dot is moved away, so that the disc is whole.
        env.reset(options=moved((-0.005, 0.0), disturbance=Disturbance(payload=Payload(5.0, at))))
        centers[at] = pixels(env.render(), PAYLOAD).mean(axis=0)
    # 0.25 m apart along link 2, which points towards the start of the reference.
    q = joint_angles(JointReference().tip(0.0).position, LENGTH, 1)
    apart = centers["tip"] - centers["link"]
    np.testing.assert_allclose(apart / np.hypot(*apart), [np.sin(q.sum()), np.cos(q.sum())], atol=0.03)


@pytest.mark.parametrize("q", [(0.0, 0.0), (3.1, 0.0), (1.57, 0.0), (-1.57, 0.0), (-2.5, 2.9)])
@pytest.mark.parametrize("length", [(1.0, 1.2), (0.3, 0.7)])
def test_every_pose_of_every_arm_fits_and_leaves_the_header_alone(length, q):
    env = FuzzyArmEnv(parameters=ArmParameters(length=length, mass_center=(0.15, 0.25)), render_mode="rgb_array")
    env.reset()
    header = env.render()[: HEADER - 2]
    env.reset(options={"initial_state": at_rest(q)})
    frame = env.render()
    arm = pixels(frame, INK)
    assert (arm > [10, HEADER + 10]).all() and (arm < [WIDTH - 10, HEIGHT - FOOTER - 10]).all()
    assert len(pixels(frame, REFERENCE)) > 200
    # Only the tip error, at the right, reads differently.
    np.testing.assert_array_equal(frame[: HEADER - 2, : WIDTH // 2], header[:, : WIDTH // 2])


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_after_a_picture_draws_its_own(copied, env):
    env.reset(seed=0)
    stepped(env, steps=3)
    before = env.render()
    twin = copied(env)
    stepped(env, torque=(400.0, 0.0))
    np.testing.assert_array_equal(twin.render(), before)
    stepped(twin, torque=(400.0, 0.0))
    np.testing.assert_array_equal(twin.render(), env.render())
    assert (twin.render() != before).any()
    twin.close()


def test_window_follows_a_control_slower_than_its_frames(monkeypatch):
    """A control period of 0.1 s against frames of 0.02 s: each step is drawn."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    slow, pictures = FuzzyArmEnv(control_period=0.1, render_mode="human"), []
    slow.reset()
    for _ in range(3):
        pictures.append(pygame.surfarray.array3d(pygame.display.get_surface()))
        slow.step(np.zeros(2))
    slow.close()
    assert (pictures[0] != pictures[1]).any() and (pictures[1] != pictures[2]).any()


def test_window_shows_what_the_array_shows_and_closes_twice(window, env):
    window.reset()
    env.reset()
    stepped(window, env, steps=20)
    assert window.render() is None
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
    np.testing.assert_array_equal(shown, env.render())
    twin = copy.deepcopy(window)
    window.close()
    window.close()
    assert not pygame.display.get_init()
    twin.reset()
    assert pygame.display.get_surface() is not None
    twin.close()


def test_window_keeps_real_time_and_may_be_closed_by_the_user(window):
    window.reset()
    start = pygame.time.get_ticks()
    stepped(window, steps=300)
    # 15 frames at 50 per second; a busy machine may be slower, never faster.
    assert pygame.time.get_ticks() - start >= 0.9 * 300
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    stepped(window, steps=60)
    assert not pygame.display.get_init()
    window.reset()  # the run goes on without a window
    stepped(window)
    window.close()
    window.reset()  # a closed environment opens a new one
    assert pygame.display.get_surface() is not None


def some_paths():
    """Yield circles, lines and knots of 60 points near a robot."""
    generator, angle = np.random.default_rng(1), np.linspace(0.0, 2.0 * np.pi, 60)[:, np.newaxis]
    for number in range(40):
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
    angle, robot = np.linspace(0.0, 2.0 * np.pi, 361)[:, np.newaxis], ROBOTS["ur5"]
    x, y, z = np.eye(3)
    for first, second in ((x, z), (y, z), (x, y)):  # along the arm, across it, level
        path = x + 0.01 * (np.cos(angle) * first + np.sin(angle) * second)
        camera = looking_at(robot, path)
        a, b = (camera.pixels(path) / 0.01 * camera.depth(path.mean(axis=0))).T
        area = 0.5 * np.abs(np.sum(a[:-1] * np.diff(b) - b[:-1] * np.diff(a)))
        assert area > 0.5 * np.pi


def cross_ratio(a, b, c, d):
    return (c - a) * (d - b) / ((c - b) * (d - a))


def test_lines_stay_lines_and_keep_their_cross_ratio_and_a_fitted_camera_fills_the_field():
    """What a pinhole keeps: the cross ratio (AC·BD)/(BC·AD) of four points of a line."""
    generator, places = np.random.default_rng(0), np.array([0.0, 0.3, 0.5, 0.9])
    camera = looking_at(ROBOTS["ur5"], next(some_paths()))
    pinhole = camera._replace(focal=700.0, center=np.array([3.0, 4.0]))
    for start, along in generator.normal(size=(20, 2, 3)):
        seen = pinhole.pixels(start + np.outer(places, along))
        direction = (seen[-1] - seen[0]) / np.linalg.norm(seen[-1] - seen[0])
        t = (seen - seen[0]) @ direction
        np.testing.assert_allclose(seen, seen[0] + np.outer(t, direction), atol=1e-9)
        np.testing.assert_allclose(cross_ratio(*t), cross_ratio(*places), rtol=1e-9)
    for _ in range(10):
        points = generator.normal(size=(6, 3)) * 10.0 ** generator.uniform(-2.0, 0.0)
        seen = camera.fitted(points, LOW, HIGH).pixels(points)
        assert (seen > LOW - 1e-9).all() and (seen < HIGH + 1e-9).all()
        np.testing.assert_allclose(seen.min(axis=0) + seen.max(axis=0), LOW + HIGH)
        assert np.isclose(np.ptp(seen, axis=0) / (HIGH - LOW), 1.0).any()


def test_poses_end_at_the_tip_and_shadows_fall_along_gravity_onto_a_floor_below():
    robot = ROBOTS["skewed"]
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
    start = np.full(len(robot), 0.4)
    schedule = Schedule.build(SplineReference(np.array([start, start + 0.3]), 0.5, robot), disturbance, 1e-3)
    trace = np.zeros((1, len(VECTORS), max(len(robot), 3)))
    tip, force = frames(robot, start).tip, schedule.forces[0, :3]
    shown = {"tip": tip + np.array(deviation), "tip_reference": tip, "q_link": start, "external_force": force}
    for name, values in shown.items():
        trace[0, VECTORS.index(name), : len(values)] = values
    canvas = Canvas()
    paint(canvas, schedule, trace, 0.0, robot)
    return canvas.array()


@pytest.mark.parametrize("name", ["ur5", "skewed"])
def test_the_tip_error_of_a_robot_is_magnified_and_gravity_points_down(name):
    robot = ROBOTS[name]
    still, lower = picture(robot, Disturbance()), picture(robot, Disturbance(), -0.002 * upwards(robot))
    assert still.shape == (HEIGHT, WIDTH, 3) and len(pixels(still, REFERENCE)) > 20
    right, down = pixels(lower, TRACE).mean(axis=0) - pixels(still, TRACE).mean(axis=0)
    assert abs(right) < 3.0 and down > 5.0


def test_loads_are_drawn_where_they_act():
    robot = ROBOTS["ur5"]
    bare, pushed = (picture(robot, Disturbance(tip_force=force)) for force in (None, ConstantForce((0.0, 0.0, -9.0))))
    tip, arrow = pixels(bare, TRACE).mean(axis=0), pixels(pushed, FORCE)
    assert len(pixels(bare, FORCE)) == 0 and len(arrow) > 50
    assert arrow.mean(axis=0)[1] < tip[1]  # pushed down, the arrow comes from above
    disc = pixels(picture(robot, Disturbance(payload=Payload(2.0)), 0.01 * upwards(robot)), PAYLOAD)
    assert len(disc) > 50 and np.hypot(*(disc.mean(axis=0) - tip)) < 4.0
    assert len(pixels(picture(dataclasses.replace(robot, gravity=(0.0, 0.0, 0.0)), Disturbance()), TRACE)) > 50
