"""The benchmarks of the learned estimate: late and scaled torques, forces across the motion, and percentiles."""

import sys
from pathlib import Path

import numpy as np
import pytest

from fuzzyarm import load_policy

FOLDER = str(Path(__file__).parents[2] / "benchmarks")
sys.path.insert(0, FOLDER)  # the scripts import their neighbours
from estimate_front import Channel, with_share  # noqa: E402
from estimate_seeds import LEARNED, Across, percentiles_below  # noqa: E402

sys.path.remove(FOLDER)


class Counting:
    """A policy whose torque is the number of its call, and that starts again where it is told to."""

    def predict(self, observation, state, episode_start, deterministic=True):
        """Return 1, 2, ... since the episode began in each lane."""
        count = np.where(episode_start, 0.0, 0.0 if state is None else state) + 1.0
        return np.repeat(count[:, np.newaxis], 2, axis=1), count


def test_torques_are_late_by_half_samples_and_scaled():
    channel, state, got = Channel(Counting(), np.array([0, 1, 4]), np.array([1.0, 1.0, 2.0])), None, []
    for call in range(8):
        torque, state = channel.predict(np.zeros((3, 10)), state, np.full(3, call == 0))
        got.append(torque[:, 0])
    held = np.array([1, 1, 2, 2, 3, 3, 4, 4])
    np.testing.assert_array_equal(got, np.stack([held, [1, *held[:7]], 2 * np.array([*[1] * 4, *held[:4]])], axis=1))
    np.testing.assert_array_equal(channel.squares, 6.0)  # three changes by 1 in both joints


def test_an_episode_that_begins_between_two_samples_is_not_missed():
    channel, state = Channel(Counting(), np.zeros(2, dtype=int), np.ones(2)), None
    for begins in ([True, True], [False, False], [False, False], [False, True], [False, False]):
        torque, state = channel.predict(np.zeros((2, 10)), state, np.array(begins))
    np.testing.assert_array_equal(torque[:, 0], [3.0, 1.0])


def test_a_share_scales_the_residual_and_nothing_else():
    whole, half = load_policy(LEARNED).network, with_share(0.5).network
    for name, array in vars(whole).items():
        if isinstance(array, np.ndarray):
            np.testing.assert_array_equal(getattr(half, name), 0.5 * array if name in ("V", "G", "D") else array)


@pytest.mark.parametrize("size", [150.0, -150.0])
def test_a_force_across_the_motion_does_no_work_and_fades_out_at_rest(size):
    velocity = np.random.default_rng(0).normal(size=(50, 2))
    force = Across(size).at(np.zeros(50), velocity)
    np.testing.assert_allclose((force * velocity).sum(axis=1), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.hypot(*force.T), 150.0)
    assert np.all(np.sign(velocity[:, 0] * force[:, 1] - velocity[:, 1] * force[:, 0]) == np.sign(size))
    np.testing.assert_allclose(Across(size).at(np.zeros(1), np.array([[0.005, 0.0]])), [[0.0, 0.5 * size]])


def test_percentiles_count_where_the_errors_are_strictly_smaller():
    errors = np.arange(1.0, 101.0)
    assert percentiles_below(errors, errors) == 0
    assert percentiles_below(errors - 0.5, errors) == 99
    assert percentiles_below(np.where(errors > 90.0, np.inf, 0.0), errors) == 90
