"""A log tells the arm: regressor against the equations, exact fits without noise, what is refused, what is kept."""

import dataclasses
import json

import numpy as np
import pytest
from support.documentation import ROOT

from fuzzyarm.cli import main
from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.identification import _fit as fit
from fuzzyarm.identification import excitation
from fuzzyarm.identification._rigid import (
    UNKNOWNS,
    arm_of,
    base_of,
    bounds_of,
    constants_of,
    fit_rigid,
    regressor,
    rigid_arm,
    start_of,
)  # fmt: skip
from fuzzyarm.identification.excitation import _NOISE as NOISE
from fuzzyarm.identification.excitation import SHARE, rehearsed, suggested
from fuzzyarm.identification.excitation import _Excitation as Excitation
from fuzzyarm.identification.log import Log, Motion
from fuzzyarm.identification.reading import read_log
from fuzzyarm.identification.result import identify

TRUTH = ArmParameters()
NAMES = [one.name for one in UNKNOWNS]
QUIET = EncoderNoise(1e-8, 1e-6)


def motion_of(duration=2.5):
    rng = np.random.default_rng(5)
    sine, cosine = rng.normal(size=(2, 4, 2)) / np.arange(1, 5)[:, np.newaxis]
    return Excitation(np.array([0.0, 0.5]), 0.3 * sine, 0.3 * cosine, 0.4, duration, TRUTH)


def wrong(factor=1.1):
    """An arm that is off by a factor in what a log may tell, up and down in turns."""
    factors = np.where(np.arange(len(UNKNOWNS)) % 2, factor, 1.0 / factor)
    return arm_of(start_of(TRUTH) * factors, TRUTH)


@pytest.fixture(scope="module")
def log():
    return rehearsed(motion_of(), TRUTH, wrong(), seed=1, noise=QUIET)


@pytest.fixture(scope="module")
def found(log):
    """Return what the first and the last of the four searches find; the slow tests run all of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit, "_SEGMENTS", (fit._SEGMENTS[0], fit._SEGMENTS[-1]))
        return identify([log], wrong())


def test_the_regressor_is_linear_in_what_the_equations_say():
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.normal(size=(3, 50, 2))
    arm = wrong(1.3)
    first, second = regressor(q, dq, ddq, arm.length[0], arm.gravity)
    torque = np.stack([first @ base_of(arm), second @ base_of(arm)], axis=-1)
    links = rigid_inverse_dynamics(q, dq, ddq, arm_constants(arm))
    motors = np.array(arm.motor_inertia) * ddq + np.array(arm.viscous_friction) * dq
    dry = np.array(arm.coulomb_friction) * np.sign(dq)
    np.testing.assert_allclose(torque, links + motors + dry, rtol=1e-12, atol=1e-12)


def test_theta_and_the_arm_are_the_same_numbers():
    arm = wrong(1.2)
    assert arm_of(start_of(arm), TRUTH) == arm
    constants = constants_of(start_of(arm)[:, np.newaxis], TRUTH)[:, 0]
    np.testing.assert_array_equal(constants, np.array(flat(arm_constants(arm))))
    # A published fit of a double pendulum has joint and center 0.3 and 0.47 m from each other.
    beyond = dataclasses.replace(TRUTH, mass_center=(TRUTH.length[0], 1.5 * TRUTH.length[1]))
    for one in (TRUTH, beyond):
        low, high = bounds_of(one, start_of(one))
        assert (low < start_of(one)).all() and (start_of(one) <= high).all()
    np.testing.assert_allclose(start_of(rigid_arm(base_of(beyond), beyond)), start_of(beyond), rtol=1e-9)


def test_least_squares_find_a_rigid_arm_exactly():
    sample = motion_of(8.0).sample(np.linspace(0.0, 8.0, 4000))
    rows = regressor(*sample, TRUTH.length[0], TRUTH.gravity)
    torque = np.stack([row @ base_of(TRUTH) for row in rows], axis=-1)
    motion = Motion(*sample, torque, slice(0, 4000), 4000.0)
    found = fit_rigid(motion, wrong())
    np.testing.assert_allclose(found.base, base_of(TRUTH), rtol=1e-9)
    assert found.undetermined == ()
    np.testing.assert_allclose(base_of(rigid_arm(found.base, wrong())), found.base, rtol=1e-9)


def test_a_quiet_log_gives_the_arm_back(found):
    np.testing.assert_allclose(found.fit.theta, start_of(TRUTH), rtol=2e-3)
    assert found.fit.determined.all() and not found.fit.at_bound.any()
    assert abs(found.fit.correlation) < 0.1
    assert found.arm.mass == TRUTH.mass and found.arm.length == TRUTH.length
    assert found.fit.noise == pytest.approx([1e-8, 1e-8, 1e-6, 1e-6], rel=0.2)


@pytest.mark.slow
def test_velocities_may_be_missing(log, tmp_path):
    """By all four searches, from a file."""
    path = tmp_path / "log.csv"
    path.write_text(dataclasses.replace(log, velocity=None).to_csv())
    found = identify(read_log(path), wrong())
    np.testing.assert_allclose(found.fit.theta, start_of(TRUTH), rtol=5e-3)
    assert len(found.fit.noise) == 2


def test_a_log_that_tells_no_arm_says_why(log):
    angle = np.full((1000, 2), 0.3) + np.random.default_rng(0).normal(scale=1e-5, size=(1000, 2))
    still = {"angle": log.angle * [1.0, 0.0] + [0.0, 0.5], "velocity": np.array(log.velocity) * [1.0, 0.0]}
    weak = dataclasses.replace(TRUTH, torque_limit=(10.0, 5.0))
    for call, message in (
        (
            lambda: identify([Log(1e-3, angle, np.full((1000, 2), 3.0))], TRUTH),
            r"does not determine inertia\[0\], .*coulomb_friction\[1\] .*--suggest",
        ),
        (lambda: identify([dataclasses.replace(log, **still)], TRUTH), r"motor_inertia\[1\]"),
        (
            lambda: identify([dataclasses.replace(log, torque=-log.torque)], TRUTH),
            r"no valid arm: least squares give inertia\[0\], .* below 0; check signs and units",
        ),
        (lambda: suggested(weak), r"to hold itself .*allowed: 0.6 times torque_limit"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_a_motion_is_smooth_and_rests_at_its_ends():
    motion, h = motion_of(), 1e-5
    t = np.linspace(0.05, 2.45, 200)
    ahead, behind, here = motion.sample(t + h), motion.sample(t - h), motion.sample(t)
    np.testing.assert_allclose((ahead.q - behind.q) / (2.0 * h), here.dq, atol=1e-6)
    np.testing.assert_allclose((ahead.dq - behind.dq) / (2.0 * h), here.ddq, atol=1e-4)
    tip = (motion.tip(t + h).position - motion.tip(t - h).position) / (2.0 * h)
    np.testing.assert_allclose(tip, motion.tip(t).velocity, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(motion.normals(np.linspace(0.0, 2.5, 50)), axis=-1), 1.0)
    ends = motion.sample(np.array([0.0, 2.5]))
    np.testing.assert_allclose(ends.q, [[0.0, 0.5]] * 2, atol=1e-12)
    assert not ends.dq.any() and not ends.ddq.any()


def test_a_suggestion_stays_within_the_limits_and_is_better_than_chance(monkeypatch):
    monkeypatch.setattr(excitation, "_DRAWS", 8)
    monkeypatch.setattr(excitation, "_REFINEMENTS", 60)
    motion = suggested(TRUTH, 10.0)
    limits = TRUTH.joint_limit, TRUTH.velocity_limit, TRUTH.torque_limit
    for used, limit in zip(motion.largest().values(), limits, strict=True):
        assert (used <= 1.01 * SHARE * np.array(limit)).all()
    monkeypatch.setattr(excitation, "_DRAWS", 1)
    monkeypatch.setattr(excitation, "_REFINEMENTS", 1)
    chance = [suggested(TRUTH, 10.0, seed).condition() for seed in range(1, 6)]
    assert motion.condition() < 0.8 * np.median(chance)
    text = motion.to_csv().splitlines()
    assert text[0].startswith("time,q1,q2,dq1") and len(text) == 10_002


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["log.csv", "--suggest", "motion.csv"], "give either a LOG or --suggest FILE"),
        (["log.csv", "--duration", "9"], "--duration is for --suggest only"),
        (["log.csv", "--out", "arm.json"], "--out arm.json must be a file ending in .toml"),
        (["log.csv", "--figure", "arm.svg"], "--figure arm.svg must be a file ending in .png"),
        (["--suggest", "motion.csv", "--out", "arm.toml"], "leave them out with --suggest"),
        (["--suggest", "motion.csv", "--duration", "1"], "duration = 1.0 s is out of range; allowed: [4, 120] s"),
        (["--suggest", "motion.csv", "--robot", "ur5"], "a robot of 6 joints"),
        (["no.csv"], "no.csv: No such file or directory"),
        (["no.csv", "--columns", "q1"], "--columns q1 must be pairs such as q1=NAME,q2=NAME, each key once"),
    ],
)
def test_bad_usage_is_one_line(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["identify", *words]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and message in err
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_the_arm_the_picture_and_the_numbers(found, log, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fuzzyarm.identification.result.identify", lambda *_: found)
    path, out, figure = (tmp_path / name for name in ("log.csv", "arm.toml", "residuals.png"))
    path.write_text(log.to_csv())
    (again,) = read_log(path)
    assert again.period == pytest.approx(1e-3) and again.name == "log.csv" and again.remarks == ()
    assert np.array_equal(again.angle, log.angle) and np.array_equal(again.torque, log.torque)
    assert main(["identify", str(path), "--out", str(out), "--figure", str(figure)]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in NAMES) and "Motors alone never tell length, mass" in printed
    assert ArmParameters.from_toml(out) == found.arm
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert main(["identify", str(path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in document["parameters"]] == NAMES
    assert document["arm"] == found.arm.to_dict() and document["kept"][0] == "length"


@pytest.mark.parametrize(
    ("factor", "lag", "words"),
    [
        (1e3, 0, r"its torques are (1|9\.\d)e\+0[23] times those of the start: check their unit"),
        (1.0, 1, r"the simulated arm does not follow it; its torque seems to be 1 ms late: shift it by 1 sample"),
        (1.0, -2, r"its torque seems to be 2 ms early: shift it by 2 sample"),
        (2.5, 0, r"does not follow it; its torques are 2\.\d times those of the start: check their unit"),
    ],
)
def test_a_torque_that_is_late_or_in_another_unit_is_named(log, monkeypatch, factor, lag, words):
    """The search that fails with such a log is left out: it takes half a minute."""

    def lost(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("fuzzyarm.identification.result.fit_elastic", lost)
    other = dataclasses.replace(log, torque=factor * np.roll(log.torque, lag, axis=0))
    with pytest.raises(ValueError, match=rf"^the log gives no valid arm: .*{words}") as caught:
        identify([other], wrong())
    assert "Singular" not in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.slow
def test_what_noise_hides_is_named_and_kept():
    truth = dataclasses.replace(TRUTH, damping=(1.0, 0.2))
    start = dataclasses.replace(wrong(), damping=(1.5, 0.3))
    log, rng = rehearsed(motion_of(4.0), truth, start, seed=2, noise=NOISE), np.random.default_rng(0)
    angle, velocity = log.angle + 1e-3 * rng.normal(size=log.angle.shape), log.velocity
    loud = dataclasses.replace(log, angle=angle, velocity=velocity + 1e-2 * rng.normal(size=angle.shape))
    found = identify([loud], start)
    hidden = ~found.fit.determined
    assert {name for name, untold in zip(NAMES, hidden, strict=True) if untold} == {"damping[0]", "damping[1]"}
    np.testing.assert_array_equal(found.fit.theta[hidden], start_of(start)[hidden])
    assert "This log does not tell damping[0], damping[1]: the values of the start are kept." in found.remarks()


def test_the_stored_intervals_cover_the_truth():
    """Each parameter in nine of ten logs, and 95 % of all."""
    document = json.loads((ROOT / "benchmarks" / "results" / "identification.json").read_text())
    log = document["logs"]["angles and velocities"]
    rows = log["rows"]
    assert [row["name"] for row in rows] == NAMES and log["runs"] >= 40
    assert all(row["told"] == log["runs"] for row in rows)
    assert sum(row["covered"] for row in rows) >= 0.93 * log["runs"] * len(rows)
    assert all(row["covered"] >= 0.9 * log["runs"] for row in rows)
