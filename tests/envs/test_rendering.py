"""Pictures: without a display, true to the state, and a window that may be closed at any time."""

import copy
import itertools
import os
import pickle
import subprocess
import sys

import numpy as np
import pygame
import pytest
from gymnasium.error import ResetNeeded
from slow_twins import slow_but

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.pictures import (
    FOOTER,
    FORCE,
    HEADER,
    HEIGHT,
    INK,
    MAGNIFICATION,
    PAYLOAD,
    REFERENCE,
    TRACE,
    WIDTH,
    View,
    case_title,
    magnified,
    thinned,
)
from fuzzyarm.envs.scenario.cases import CASES, case_for
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, TorqueBias
from fuzzyarm.envs.scenario.reference import JointReference, joint_angles

LENGTH = ArmParameters().length
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
    """Return (right, down) of each pixel of exactly this colour between header and footer, shape (n, 2)."""
    down, right = np.nonzero((frame[FIELD] == colour).all(axis=-1))
    return np.stack([right, down + FIELD.start], axis=-1)


def at_rest(q):
    """Return a state with motors and links at the angles q."""
    return [*q, *q, 0.0, 0.0, 0.0, 0.0]


def moved(offset, **options):
    """Return reset options that put the tip `offset` [m] away from the start of the paper's reference."""
    tip = JointReference().tip(0.0).position + np.array(offset)
    return {"initial_state": at_rest(joint_angles(tip, LENGTH, 1)), **options}


@pytest.fixture
def env():
    """Return an environment that draws into arrays."""
    env = FuzzyArmEnv(render_mode="rgb_array")
    yield env
    env.close()


@pytest.fixture
def window(monkeypatch):
    """Return an environment with a window that needs no display."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = FuzzyArmEnv(render_mode="human")
    yield env
    env.close()


HIDDEN = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")


def test_arrays_need_no_display(monkeypatch):
    for name in HIDDEN:
        monkeypatch.delenv(name, raising=False)
    pygame.quit()
    exec(HEADLESS, {})


@pytest.mark.slow
def test_arrays_need_no_display_in_a_fresh_interpreter():
    environment = {name: value for name, value in os.environ.items() if name not in HIDDEN}
    command = [sys.executable, "-W", "error", "-c", HEADLESS]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_no_render_mode_records_and_loads_nothing():
    plain = FuzzyArmEnv()
    plain.reset()
    for _ in range(5):
        plain.step(np.zeros(2))
    assert plain._film._trace == []
    assert plain._film._canvas is None


def test_each_frame_is_a_new_array(env):
    env.reset()
    first = env.render()
    assert first.shape == (HEIGHT, WIDTH, 3)
    assert first.dtype == np.uint8
    assert first.flags.c_contiguous
    kept = first.copy()
    second = env.render()
    np.testing.assert_array_equal(first, second)
    second[:] = 0
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(env.render(), kept)


def test_frames_follow_the_arm(env):
    env.reset()
    before = env.render()
    for _ in range(50):
        env.step(np.zeros(2))
    assert (env.render()[FIELD] != before[FIELD]).any()


def test_render_before_reset_says_so(env):
    with pytest.raises(ResetNeeded, match=r"env\.reset"):
        env.render()


def test_render_after_a_failed_reset_says_so(env):
    env.reset()
    with pytest.raises(ValueError, match="initial_state"):
        env.reset(options={"initial_state": [9.0] * 8})
    with pytest.raises(ResetNeeded, match=r"env\.reset"):
        env.render()


def test_gravity_points_down_and_y_to_the_right():
    view = View(100.0, np.array([300.0, 200.0]))
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
    np.testing.assert_allclose(view.pixels(points), [[300, 200], [300, 300], [500, 200]])


def test_view_fills_the_field_with_any_box():
    rng = np.random.default_rng(0)
    for _ in range(100):
        points = rng.normal(size=(5, 2)) * 10.0 ** rng.uniform(-2, 2)
        right, down = View.fit(points).pixels(points).T
        assert right.min() >= 0.0 and right.max() <= WIDTH
        assert down.min() >= HEADER and down.max() <= HEIGHT - FOOTER
        np.testing.assert_allclose(right.min() + right.max(), WIDTH)
        np.testing.assert_allclose(down.min() + down.max(), HEADER + HEIGHT - FOOTER)


@pytest.mark.parametrize("offset", [(0.002, 0.0), (0.0, 0.002), (-0.003, -0.001)])
def test_trace_shows_the_magnified_error(env, offset):
    env.reset(options=moved(offset))
    frame = env.render()
    curve = pixels(frame, REFERENCE)
    # The curve is a circle of 0.2 m that starts at its rightmost point: scale and origin follow from the picture.
    right, low, high = curve[:, 0].max(), curve[:, 1].min(), curve[:, 1].max()
    scale = (high - low) / 0.4
    dot = pixels(frame, TRACE).mean(axis=0)
    expected = np.array([right, (low + high) / 2.0]) + MAGNIFICATION * scale * np.array(offset)[::-1]
    np.testing.assert_allclose(dot, expected, atol=4.0)


def test_magnified_is_the_reference_without_error():
    reference = np.random.default_rng(0).normal(size=(3, 2))
    tip = reference.copy()
    np.testing.assert_array_equal(magnified(tip, reference), reference)
    tip[1, 0] += 0.001
    np.testing.assert_allclose(magnified(tip, reference)[1] - reference[1], [0.025, 0.0], atol=1e-12)


def test_trace_holds_every_step_even_if_drawn_once(env):
    often = FuzzyArmEnv(render_mode="rgb_array")
    env.reset()
    often.reset()
    start = len(pixels(often.render(), TRACE))
    for _ in range(15):
        env.step(np.zeros(2))
        often.step(np.zeros(2))
        often.render()
    frame = env.render()
    np.testing.assert_array_equal(frame, often.render())
    assert len(pixels(frame, TRACE)) > start


def test_reset_clears_the_trace_and_the_view(env):
    env.reset()
    first = env.render()
    for _ in range(400):
        env.step(np.zeros(2))
    env.reset()
    np.testing.assert_array_equal(env.render(), first)


@pytest.mark.parametrize("case", CASES)
def test_force_and_payload_only_where_they_act(env, case):
    env.reset(options={"case": case})
    for _ in range(100):
        env.step(np.zeros(2))
    frame = env.render()
    assert (len(pixels(frame, FORCE)) > 100) == (case == "machining")
    assert (len(pixels(frame, PAYLOAD)) > 100) == (case == "payload")


def test_force_arrow_ends_at_the_tip_and_points_along_the_force(env):
    # 3 N down, 4 N to the right: the arrow lies up and left of the tip, which starts at the right end of the curve.
    env.reset(options={"disturbance": Disturbance(tip_force=ConstantForce((3.0, 4.0)))})
    env.step(np.zeros(2))
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


def test_titles():
    arm, other = ArmParameters(), ArmParameters(length=(0.3, 0.7), mass_center=(0.15, 0.25))
    for case in CASES.values():
        assert case_title(case.disturbance, arm) == case.title
        assert case_title(case_for(case.name, other).disturbance, other) == case_for(case.name, other).title
    assert case_title(Disturbance(), arm) == CASES["nominal"].title
    for own in (Disturbance(torque_bias=TorqueBias((1.0, 0.0))), Disturbance(payload=Payload(4.0))):
        assert case_title(own, arm) == "custom disturbance"


LENGTHS = (0.5, 0.5), (0.3, 0.7), (1.0, 1.2)
POSES = (0.0, 0.0), (3.1, 0.0), (1.57, 0.0), (-1.57, 0.0), (-2.5, 2.9)
# The longest arm in all directions, and each arm somewhere.
SHOWN = [*((LENGTHS[2], pose) for pose in POSES), (LENGTHS[0], POSES[1]), (LENGTHS[1], POSES[2])]


@pytest.mark.parametrize("arm_and_pose", slow_but(SHOWN, itertools.product(LENGTHS, POSES)))
def test_every_pose_of_every_arm_fits_and_leaves_the_header_alone(arm_and_pose):
    length, q = arm_and_pose
    parameters = ArmParameters(length=length, mass_center=(0.15, 0.25))
    env = FuzzyArmEnv(parameters=parameters, render_mode="rgb_array")
    env.reset()
    header = env.render()[: HEADER - 2]
    env.reset(options={"initial_state": at_rest(q)})
    frame = env.render()
    arm = pixels(frame, INK)
    assert arm[:, 0].min() > 10 and arm[:, 0].max() < WIDTH - 10
    assert arm[:, 1].min() > HEADER + 10 and arm[:, 1].max() < HEIGHT - FOOTER - 10
    assert len(pixels(frame, REFERENCE)) > 200
    # Only the tip error, at the right, reads differently.
    np.testing.assert_array_equal(frame[: HEADER - 2, : WIDTH // 2], header[:, : WIDTH // 2])


COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}


@pytest.mark.parametrize("way", COPIES)
def test_a_copy_after_a_picture_draws_its_own(way, env):
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(2))
    before = env.render()
    twin = COPIES[way](env)
    np.testing.assert_array_equal(twin.render(), before)
    env.step(np.array([400.0, 0.0]))
    np.testing.assert_array_equal(twin.render(), before)
    twin.step(np.array([400.0, 0.0]))
    np.testing.assert_array_equal(twin.render(), env.render())
    assert (twin.render() != before).any()
    twin.close()


def test_a_copy_of_an_arm_in_a_window_shows_itself_in_it(window):
    window.reset()
    twin = copy.deepcopy(window)
    window.close()
    assert not pygame.display.get_init()
    twin.reset()
    assert pygame.display.get_surface() is not None
    twin.close()


def test_thinned_keeps_the_ends():
    line = np.stack([np.linspace(0.0, 101.0, 1001), np.zeros(1001)], axis=-1)
    thin = thinned(line)
    np.testing.assert_array_equal(thin[[0, -1]], line[[0, -1]])
    assert np.diff(thin[:, 0]).max() < 2.2
    assert len(thin) < 60
    np.testing.assert_array_equal(thinned(line[:1]), line[:1])


def test_window_shows_the_arm_and_closes_twice(window):
    window.reset()
    for _ in range(60):
        window.step(np.zeros(2))
    assert window.render() is None
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
    assert len(pixels(shown, REFERENCE)) > 200
    window.close()
    assert not pygame.display.get_init()
    window.close()


def test_window_follows_a_control_slower_than_its_frames(monkeypatch):
    """A control period of 0.1 s against frames of 0.02 s: each step is drawn."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    slow = FuzzyArmEnv(control_period=0.1, render_mode="human")
    try:
        slow.reset()
        pictures = [pygame.surfarray.array3d(pygame.display.get_surface())]
        for _ in range(2):
            slow.step(np.zeros(2))
            pictures.append(pygame.surfarray.array3d(pygame.display.get_surface()))
    finally:
        slow.close()
    assert (pictures[0] != pictures[1]).any() and (pictures[1] != pictures[2]).any()


def test_window_shows_what_the_array_shows(window, env):
    window.reset()
    env.reset()
    for _ in range(20):
        window.step(np.zeros(2))
        env.step(np.zeros(2))
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
    np.testing.assert_array_equal(shown, env.render())


def test_user_may_close_the_window(window):
    window.reset()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(60):
        window.step(np.zeros(2))
    assert not pygame.display.get_init()
    window.reset()  # the run goes on without a window
    window.step(np.zeros(2))
    window.close()
    window.reset()  # a closed environment opens a new one
    assert pygame.display.get_surface() is not None


def test_window_keeps_real_time(window):
    window.reset()
    start = pygame.time.get_ticks()
    for _ in range(300):
        window.step(np.zeros(2))
    # 15 frames at 50 per second; a busy machine may be slower, never faster.
    assert pygame.time.get_ticks() - start >= 0.9 * 300
