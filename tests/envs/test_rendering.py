"""Pictures: without a display, true to the state, and a window that may be closed at any time."""

import copy
import os
import pickle
import subprocess
import sys

import numpy as np
import pygame
import pytest
from gymnasium.error import ResetNeeded

from fuzzyarm.envs._pictures import FOOTER, FORCE, HEADER, HEIGHT, INK, PAYLOAD, REFERENCE, TRACE, WIDTH
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.envs.scenario.reference import JointReference, joint_angles

LENGTH = ArmParameters().length
FIELD = slice(HEADER + 2, HEIGHT - FOOTER - 2)
HEADLESS = """
import pygame
from fuzzyarm.envs import _pictures as pictures
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


def test_arrays_need_no_display_in_a_fresh_interpreter():
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    command = [sys.executable, "-W", "error", "-c", HEADLESS]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
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
    for _ in range(400):
        env.step(np.zeros(2))
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
    scale = (high - low) / 0.4
    dot = pixels(frame, TRACE).mean(axis=0)
    expected = np.array([right, (low + high) / 2.0]) + 25.0 * scale * np.array(offset)[::-1]
    np.testing.assert_allclose(dot, expected, atol=4.0)


@pytest.mark.parametrize("arm", [{}, {"robot": "planar-3r"}], ids=["paper", "robot"])
def test_a_thrown_arm_and_its_trace_stay_in_the_field(arm):
    env, ended = FuzzyArmEnv(render_mode="rgb_array", **arm), False
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
    frames, often = [], FuzzyArmEnv(render_mode="rgb_array")
    for one in (env, often):
        one.reset()
        for _ in range(15):
            one.step(np.zeros(2))
            frames.append(one.render() if one is often else None)
    np.testing.assert_array_equal(env.render(), frames[-1])
    assert len(pixels(frames[-1], TRACE)) > len(pixels(frames[15], TRACE))


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


@pytest.mark.parametrize("q", [(0.0, 0.0), (3.1, 0.0), (1.57, 0.0), (-1.57, 0.0), (-2.5, 2.9)])
@pytest.mark.parametrize("length", [(1.0, 1.2), (0.3, 0.7)])
def test_every_pose_of_every_arm_fits_and_leaves_the_header_alone(length, q):
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


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_after_a_picture_draws_its_own(copied, env):
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(2))
    before = env.render()
    twin = copied(env)
    env.step(np.array([400.0, 0.0]))
    np.testing.assert_array_equal(twin.render(), before)
    twin.step(np.array([400.0, 0.0]))
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
    for _ in range(20):
        window.step(np.zeros(2))
        env.step(np.zeros(2))
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
