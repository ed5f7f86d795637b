"""The matrices of `fuzzyarm linearise` against `margins`, the nonlinear loop and the equations of the module."""

import numpy as np
import pytest
import scipy.io
from support.command_line import printed

from fuzzyarm import ArmParameters, load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.eval.stability.linear_models import linear_models
from fuzzyarm.eval.stability.margins import policy_margins

ARM, PERIOD = ArmParameters(), 1e-3


@pytest.mark.parametrize("name", ["computed-torque", "fuzzy-4", "elastic-observer"])
def test_open_and_closed_loop_have_the_margins_of_the_table(name, monkeypatch):
    """Closing the open loop by hand gives the eigenvalues of the closed one, and the limits of its gain."""
    monkeypatch.setattr(
        "fuzzyarm.eval.stability._linearisation.POSTURES", 1
    )  # where the path begins, as without a posture
    policy = load_policy(name)
    models, row = linear_models(policy, ARM, PERIOD), policy_margins(policy, ARM, PERIOD)
    A, B, C, _ = models.open_loop

    def radius(gain):
        return np.abs(np.linalg.eigvals(A - gain * B @ C)).max()

    closed = np.abs(np.linalg.eigvals(models.closed_loop.A)).max()
    assert [radius(1.0), closed] == pytest.approx([row["spectral_radius"]["nominal"]] * 2, rel=1e-9)
    lower, upper = row["loop_gain"]["lower"], row["loop_gain"]["upper"]
    assert radius(1.001 * lower) < 1.0 <= radius(0.999 * lower)
    assert radius(0.999 * upper) < 1.0 <= radius(1.001 * upper)


def test_limits_of_one_motor_are_crossings_of_its_frequency_response():
    """At a limit of the gain of one motor, the others closed, 1 + κ L(z) = 0 at an eigenvalue on the unit circle."""
    models = linear_models(load_policy("computed-torque"), ARM, PERIOD)
    for joint in range(2):
        A, B, C, _ = loop = models.one_motor(joint)
        gains = np.geomspace(0.01, 10.0, 2001)
        stable = np.array([np.abs(np.linalg.eigvals(A - gain * B @ C)).max() < 1.0 for gain in gains])
        first, last = np.flatnonzero(stable)[[0, -1]]
        assert stable[first : last + 1].all() and first > 0 and last < len(gains) - 1
        for gain in gains[[first, last]]:
            values = np.linalg.eigvals(A - gain * B @ C)
            crossing = values[np.argmax(np.abs(values))]
            assert -1.0 / loop.response(np.array([crossing]))[0, 0, 0] == pytest.approx(gain, rel=1e-4)
        assert crossing == pytest.approx(-1.0, abs=0.01)  # the upper limit is at half the sampling rate


def test_a_step_of_the_reference_reaches_it_and_that_of_a_torque_leaves():
    found = linear_models(load_policy("fuzzy-4"), ARM, PERIOD, (0.5, 1.2)).closed_loop.steps(3000)[-1]
    np.testing.assert_allclose(found[:2, :2], np.eye(2), atol=1e-3)  # motors: it has an integral
    np.testing.assert_allclose(found[:2, 2:], 0.0, atol=1e-7)


def test_the_closed_loop_predicts_the_nonlinear_one():
    """A torque of 5 N m on the frozen arm, against the simulator without friction, for as long as it is small."""
    at, arm = (0.5, 1.2), ArmParameters(static_friction=(0.0, 0.0), coulomb_friction=(0.0, 0.0))
    policy = load_policy("computed-torque", robot=arm)
    models, env = linear_models(policy, arm, PERIOD, at), FuzzyArmEnv(parameters=arm)
    rest, memory = np.split(models.loop.equilibrium, [8])
    push, reference = np.array([5.0, 0.0]), np.append(at, np.zeros(4))
    _, info = env.reset(options={"initial_state": rest})
    for _ in range(20):
        torque, memory = policy.predict(np.concatenate([info["q_motor"], info["dq_motor"], reference]), memory)
        _, _, _, _, info = env.step(torque + push)
    moved = models.closed_loop.steps(21)[20][2:, 2:] @ push
    np.testing.assert_allclose(info["q_link"] - rest[2:4], moved, rtol=0.02)


def test_files_hold_the_same_matrices_and_no_date(tmp_path, capsys):
    for name in "ab":
        assert "stable from" in printed(capsys, "linearise", "fuzzy-1", "--at", "0.5,1.2", "--out", tmp_path / name)
    files, again = ({path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in "ab")
    assert files == again and set(files) == {"linear.npz", "linear.mat", "step.png", "bode.png"}
    matlab = scipy.io.loadmat(tmp_path / "a/linear.mat")
    with np.load(tmp_path / "a/linear.npz") as arrays:
        for name in arrays:
            assert np.array_equal(np.atleast_2d(arrays[name]), matlab[name])
        assert arrays["closed_loop_B"].shape == (len(arrays["closed_loop_A"]), 4)
