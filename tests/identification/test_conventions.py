"""A log in other conventions is recognised, said and put right; a right one is left alone."""

import dataclasses
import json
import math
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm.cli import main
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.identification._rigid import base_of, regressor
from fuzzyarm.identification.conventions import _SIGNS as SIGNS
from fuzzyarm.identification.conventions import Reading, diagnosed
from fuzzyarm.identification.log import Log
from fuzzyarm.identification.reading import held_mean, read_log

TRUTH = ArmParameters()
GUESS = dataclasses.replace(
    TRUTH, mass_center=(0.375, 0.375), inertia=(0.3, 0.2), motor_inertia=(0.5, 0.5), coulomb_friction=(1.0, 1.0)
)
GEAR = 50.0


def recorded(seed):
    """A log of the rigid arm with torques that have an error of 5 %."""
    rng = np.random.default_rng(seed)
    time, order = 4e-3 * np.arange(1500), 2.0 * math.pi * 0.25 * np.arange(1, 6)
    phase = time[:, np.newaxis] * order + rng.uniform(0.0, 6.0, size=5)
    size = rng.normal(size=(5, 2)) / np.sqrt(np.arange(1, 6))[:, np.newaxis]
    q, dq = np.sin(phase) @ size + [0.1, 0.4], (np.cos(phase) * order) @ size
    ddq = -(np.sin(phase) * order**2) @ size
    torque = np.stack([row @ base_of(TRUTH) for row in regressor(q, dq, ddq, TRUTH.length[0], TRUTH.gravity)], axis=1)
    torque[:-1] = 0.5 * (torque[:-1] + torque[1:])  # held from an instant to the next
    return Log(4e-3, q, torque + 0.05 * torque.std(axis=0) * rng.normal(size=torque.shape))


def turned(angle=lambda q: q, torque=lambda tau: tau):
    return lambda log: dataclasses.replace(log, angle=angle(log.angle), torque=torque(log.torque), velocity=None)


def late(delay):
    """Torques that are recorded later than the angles."""

    def changed(log):
        time = log.period * np.arange(len(log.angle))
        return dataclasses.replace(log, torque=held_mean(time, log.torque, time - delay, log.period))

    return changed


VARIANTS = {
    "degrees": turned(np.degrees),
    "turns": turned(lambda q: q / (2.0 * math.pi)),
    "from the vertical": turned(lambda q: np.cumsum(q, axis=1)),
    "the joints seem to be exchanged": turned(lambda q: q[:, ::-1], lambda tau: tau[:, ::-1]),
    "the torques seem to be exchanged": turned(torque=lambda tau: tau[:, ::-1]),
    "in N mm": turned(torque=lambda tau: 1e3 * tau),
    "the angles and torques seem to be on the joint's side": turned(lambda q: q / GEAR, lambda tau: GEAR * tau),
    "the angles seem to be on the joint's side": turned(lambda q: q / GEAR),
    "the torques seem to be on the joint's side": turned(torque=lambda tau: GEAR * tau),
    "50 ms late": late(0.05),
    "30 ms early": late(-0.03),
    **{words: turned(lambda q, s=signs: q * s[:2], lambda tau, s=signs: tau * s[2:]) for signs, words in SIGNS.items()},
    **{
        f"the zero of joint {j + 1} seems to be off by {math.degrees(zero):+.0f} degrees": turned(
            lambda q, j=j, zero=zero: q + zero * (np.arange(2) == j)
        )
        for j in range(2)
        for zero in (0.5 * math.pi, math.pi, -0.5 * math.pi)
    },
}
FEW = ("degrees", "the torques seem to be exchanged", "50 ms late", "torque 1 has the opposite sign")


def gone(reading, right, wrong):
    """Whether a reading of the wrong log is the right one, but for whole turns, its mirror image and a few ms."""
    angle, torque = reading.of_angles(wrong.angle), reading.applied(wrong).torque
    for mirror in (1.0, -1.0):
        away = np.abs((angle - mirror * right.angle + math.pi) % (2.0 * math.pi) - math.pi).max()
        rough = np.abs(torque - mirror * right.torque)[50:-50].max() / np.abs(right.torque).max()
        if away < 1e-9 and rough < (0.3 if reading.delay else 1e-9):
            return True
    return False


def found_in(logs, start, name):
    """Whether the change of a name is recognised in logs."""
    wrong = [VARIANTS[name](log) for log in logs]
    found = diagnosed(wrong, start, (GEAR,) if name.endswith("the joint's side") else ())
    return found.doubtful and all(gone(found.reading, *pair) for pair in zip(logs, wrong, strict=True)), found


@pytest.fixture(scope="module")
def logs():
    return [recorded(1), recorded(2)]


def test_right_logs_are_left_alone(logs):
    for some in (logs, logs[:1], logs[1:]):
        found = diagnosed(some, GUESS)
        assert not found.doubtful and found.misfit < 0.3, found
        np.testing.assert_array_equal(found.reading.applied(logs[0]).torque, logs[0].torque)


@pytest.mark.parametrize("name", slow_but(FEW, VARIANTS))
def test_a_changed_convention_is_found_and_put_right(logs, name):
    right, found = found_in(logs, GUESS, name)
    assert right, found.sentence()
    assert found.after < 0.75 * found.misfit
    assert name in found.sentence()


def test_derivatives_turn_with_the_angles():
    rng = np.random.default_rng(0)
    q, dq, h = *rng.normal(size=(2, 20, 2)), 1e-6
    reading = Reading(("",), (2.0, 3.0), (1.0, 1.0), "both", (1, -1, 1, 1), absolute=True, zero=(0.3, 0.4))
    slope = (reading.of_angles(q + h * dq) - reading.of_angles(q - h * dq)) / (2.0 * h)
    np.testing.assert_allclose(reading.of_angles(dq, order=1), slope, atol=1e-8)


def test_the_command_says_it_and_applies_it(logs, tmp_path, capsys, monkeypatch):
    found, seen = {"interrupted": False, "doubtful": False, "untold": tuple, "to_dict": dict}, []

    def identify(logs, *_, **__):
        if np.abs(logs[0].angle).max() > 10.0:
            raise ValueError("no valid arm")
        seen.append(logs)
        return SimpleNamespace(**found)

    monkeypatch.setattr("fuzzyarm.identification.result.identify", identify)
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for path, log in zip(paths, logs, strict=True):
        path.write_text(VARIANTS["degrees"](log).to_csv())
    words = ["identify", *map(str, paths), "--json"]
    assert main(words) == 2
    out, err = capsys.readouterr()
    said = "no valid arm. Perhaps the logs use other conventions: the angles seem to be in degrees; with this interpr"
    assert out == "" and said in err.splitlines()[-1]
    assert main([*words, "--apply"]) == 0
    conventions = json.loads(capsys.readouterr().out)["conventions"]
    assert conventions["applied"] and conventions["likely"] == ["the angles seem to be in degrees"]
    np.testing.assert_allclose(seen[0][1].angle, logs[1].angle, atol=1e-12)
    assert main([*words, str(paths[0])]) == 2 and f"{paths[0]} is given twice" in capsys.readouterr().err


FOLDER = os.environ.get("FUZZYARM_REAL_LOGS", "")


@pytest.mark.slow
@pytest.mark.skipif(not FOLDER, reason="FUZZYARM_REAL_LOGS does not name the folder of the recorded logs")
def test_conventions_of_recorded_logs_are_recognised():
    """No remark on the four logs as they are; 95 % of the changes are found in the two sets of two."""
    found = []
    for design, length in (("A0", (0.3, 0.2)), ("C1", (0.2, 0.3))):
        logs = [log for path in sorted(Path(FOLDER).glob(f"design_{design}_*.csv")) for log in read_log(path)]
        rods = {"mass_center": tuple(0.75 * one for one in length), "inertia": tuple(0.05 * one**2 for one in length)}
        start = dataclasses.replace(TRUTH, mass=(0.6, 0.6), length=length, motor_inertia=(0.01, 0.002), **rods)
        assert not any(diagnosed(some, start).doubtful for some in (logs, *([log] for log in logs)))
        found += [found_in(logs, start, name)[0] for name in VARIANTS]
    assert np.mean(found) >= 0.95
