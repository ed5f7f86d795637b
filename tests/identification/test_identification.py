"""Logs tell the arm: regressor against the equations, exact fits, stages and held-out errors, what is kept and told."""

import dataclasses
import json
from unittest.mock import Mock

import numpy as np
import pytest
from support.recorded import recorded

from fuzzyarm.cli import main
from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.equations import corners_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.identification import _two_joints, excitation
from fuzzyarm.identification._output_error import fitted
from fuzzyarm.identification._rigid import arm_of, base_of, constants_of, fit_rigid, regressor, rigid_arm, start_of
from fuzzyarm.identification._simulation import ELASTIC, RIGID, simulated, windows_of
from fuzzyarm.identification.excitation import SHARE, suggested
from fuzzyarm.identification.excitation import _Excitation as Excitation
from fuzzyarm.identification.log import Log, Motion
from fuzzyarm.identification.result import identify

TRUTH = ArmParameters()
STIFF = dataclasses.replace(TRUTH, static_friction=TRUTH.coulomb_friction)  # 40 Hz: hardly bends in slow motion
WITHOUT_DRY_FRICTION = dataclasses.replace(STIFF, coulomb_friction=(0.0, 0.0), static_friction=(0.0, 0.0))


def motion_of(duration=2.5):
    rng = np.random.default_rng(5)
    sine, cosine = rng.normal(size=(2, 4, 2)) / np.arange(1, 5)[:, np.newaxis]
    return Excitation(np.array([0.0, 0.5]), 0.3 * sine, 0.3 * cosine, 0.4, duration, TRUTH)


def wrong(factor=1.1, arm=TRUTH):
    """An arm that is off by a factor in what a log may tell, up and down in turns."""
    theta = start_of(arm)
    return arm_of(theta * np.where(np.arange(len(theta)) % 2, factor, 1.0 / factor), arm)


def torque_of(arm, q, dq, ddq):
    rows = regressor(q, dq, ddq, arm.length[0], arm.gravity)
    return np.stack([row @ base_of(arm) for row in rows], axis=-1)


@pytest.fixture(scope="module")
def logs():
    return [recorded(STIFF, seed, duration=3.0, period=4e-3, noise=0.01) for seed in (0, 1)]


@pytest.fixture(scope="module")
def found(logs):
    return identify(logs, wrong(1.2, STIFF))


def test_the_regressor_is_linear_in_what_the_equations_say():
    (q, dq, ddq), arm = np.random.default_rng(0).normal(size=(3, 50, 2)), wrong(1.3)
    links = rigid_inverse_dynamics(q, dq, ddq, arm_constants(arm))
    motors = np.array(arm.motor_inertia) * ddq + np.array(arm.viscous_friction) * dq
    dry = np.array(arm.coulomb_friction) * np.sign(dq)
    np.testing.assert_allclose(torque_of(arm, q, dq, ddq), links + motors + dry, rtol=1e-12, atol=1e-12)


def test_theta_and_the_arm_are_the_same_numbers():
    arm = wrong(1.2)
    assert arm_of(start_of(arm), TRUTH) == arm
    constants = constants_of(start_of(arm)[:, np.newaxis], TRUTH)[:, 0]
    np.testing.assert_array_equal(constants, np.array(flat(arm_constants(arm))))
    # A published fit of a double pendulum has joint and center 0.3 and 0.47 m from each other.
    beyond = dataclasses.replace(TRUTH, mass_center=(TRUTH.length[0], 1.5 * TRUTH.length[1]))
    np.testing.assert_allclose(start_of(rigid_arm(base_of(beyond), beyond)), start_of(beyond), rtol=1e-9)


def test_least_squares_find_a_rigid_arm_in_spite_of_the_start():
    sample = motion_of(8.0).sample(np.linspace(0.0, 8.0, 4000))
    base = fit_rigid([Motion(*sample, torque_of(TRUTH, *sample), slice(0, 4000), 4000.0)], wrong(1.3))
    np.testing.assert_allclose(base, base_of(TRUTH), rtol=2e-3)
    np.testing.assert_allclose(base_of(rigid_arm(base, wrong())), base, rtol=1e-9)
    assert min(rigid_arm(np.zeros(9), STIFF).motor_inertia) > 0.0  # an arm even without any inertia


def simulation(plant, windows, arm):
    theta = start_of(arm)
    lanes = np.repeat(theta[:, np.newaxis], len(windows), axis=1)
    return simulated(plant, windows, lanes, plant.states(windows, theta, arm), arm)


def test_the_rigid_arm_is_the_elastic_one_with_stiff_springs(logs):
    """Without friction, which is smooth around rest in one and sticks in the other."""
    stiff = {"viscous_friction": (0.0, 0.0), "stiffness": (4e6, 1e6), "damping": (2e3, 300.0)}
    free = dataclasses.replace(WITHOUT_DRY_FRICTION, **stiff)
    windows = windows_of(logs[0], 0, 0.2, 0.2, 20)
    rigid, elastic = (simulation(plant, windows, free) for plant in (RIGID, ELASTIC))
    assert np.ptp(rigid, axis=0).max() > 0.05
    np.testing.assert_allclose(rigid, elastic, atol=2e-4)


def test_output_error_finds_what_windows_were_simulated_with(logs):
    """The windows' measurements are simulations of the rigid arm; the search begins elsewhere."""
    windows = windows_of(logs[0], 0, 0.4, 0.4, 20)
    windows = dataclasses.replace(windows, measured=simulation(RIGID, windows, STIFF))
    search = _two_joints._rigid_search(wrong(1.1, STIFF), np.array([1.0, 1.0, 5.0, 5.0]), stribeck=False)
    weak = dataclasses.replace(search, likely=np.full(9, np.inf))
    found = fitted([windows], RIGID, weak, STIFF, noise=1e-9, steps=30, close=1e-12)
    np.testing.assert_allclose(base_of(arm_of(found.theta, STIFF)), base_of(STIFF), rtol=1e-4)
    assert found.half_widths() is None


def test_the_stages_find_the_arm_and_say_what_is_not_told(found):
    np.testing.assert_allclose(base_of(found.arm)[:5], base_of(STIFF)[:5], rtol=0.15)
    held = found.held_out
    assert not found.doubtful and max(held["rigid"]) < min(held["start"]) and found.untold() == ()
    rows = {row["name"]: row for row in found.rows()}
    assert not rows["stiffness[0]"]["told"] and found.arm.stiffness == found.start.stiffness
    told = rows["inertia[0] + motor_inertia[0]"]
    assert told["told"] and told["low"] < told["value"] < told["high"]
    assert any("not determined: elastic joints in the model do not lower" in remark for remark in found.remarks())


def test_what_is_not_told_is_handed_on_as_ranges(found, tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(found.to_toml())
    assert ArmParameters.from_toml(path) == found.arm
    rotors = [corner.motor_inertia[0] for corner in corners_of(path).values()]
    whole = found.arm.motor_inertia[0] + found.arm.inertia[0]
    assert min(rotors) == pytest.approx(0.1 * whole) and max(rotors) == pytest.approx(0.9 * whole)


def test_a_joint_that_rests_keeps_the_start_and_a_resting_arm_is_refused(logs):
    still = [dataclasses.replace(log, angle=log.angle * [1.0, 0.0] + [0.0, 0.5], velocity=None) for log in logs]
    start = wrong(1.2, STIFF)
    found = identify(still, start)
    assert "motor_inertia[1]" in found.untold()
    assert found.arm.motor_inertia[1] == pytest.approx(start.motor_inertia[1])
    rest = Log(4e-3, np.full((500, 2), 0.3), np.full((500, 2), 3.0))
    with pytest.raises(ValueError, match=r"too little excitation: no joint moves .*--suggest"):
        identify(rest, TRUTH)
    with pytest.raises(ValueError, match=r"log has 2 joints, but the initial arm \(start, --robot\) has 6"):
        identify(rest, robot_named("ur5"))


def test_short_parts_are_left_out_and_said(logs, found):
    short = dataclasses.replace(logs[0], angle=logs[0].angle[:150], torque=logs[0].torque[:150], name="short")
    with_short = identify([short, *logs], wrong(1.2, STIFF))
    assert with_short.arm == found.arm and with_short.samples == found.samples
    said = "1 part(s) shorter than 0.8 s are left out; the first is short, 0.596 s."
    assert with_short.remarks() == [said, *found.remarks()]
    with pytest.raises(ValueError, match=r"but the longest one is 0.596 s; record without gaps"):
        identify(short, wrong(1.2, STIFF))


def test_logs_that_no_arm_explains_are_doubtful_and_equations_without_a_solution_are_said(logs, monkeypatch):
    angle = logs[0].angle.copy()
    angle[400] = -9999.0
    other = [dataclasses.replace(log, torque=-log.torque) for log in logs]
    for spoiled in (other, dataclasses.replace(logs[0], angle=angle)):
        found = identify(spoiled, wrong(1.2, STIFF))
        assert found.doubtful and any("Check units" in remark for remark in found.remarks())

    monkeypatch.setattr("fuzzyarm.identification.result.estimated", Mock(side_effect=np.linalg.LinAlgError))
    with pytest.raises(ValueError, match="have no solution; check their units"):
        identify(logs, STIFF)


def test_without_friction_the_arm_is_found_and_not_refused():
    log = recorded(WITHOUT_DRY_FRICTION, 3, duration=3.0, period=4e-3, noise=0.01)
    found = identify(log, wrong(1.2, WITHOUT_DRY_FRICTION))
    assert found.untold() == () and max(found.arm.coulomb_friction) < 0.02 * np.abs(log.torque).max()
    assert all(row["low"] is None for row in found.rows())
    assert any("One log does not show" in remark for remark in found.remarks())


def test_an_interrupted_search_returns_what_it_has(logs):
    found = identify(logs, wrong(1.2, STIFF), Mock(side_effect=[None, None, KeyboardInterrupt]))
    assert found.interrupted and found.held_out == {} and "was interrupted" in " ".join(found.remarks())
    np.testing.assert_allclose(base_of(found.arm)[0], base_of(STIFF)[0], rtol=0.3)


@pytest.mark.slow
def test_springs_are_told_where_they_lower_the_held_out_error():
    soft = dataclasses.replace(STIFF, stiffness=(6e3, 1.2e3), damping=(15.0, 3.0))  # 10 Hz
    logs = [recorded(soft, seed, duration=8.0, period=2e-3) for seed in range(4)]
    found = identify(logs, wrong(1.3, soft))
    assert np.less(found.held_out["elastic"], found.held_out["rigid"]).all()
    np.testing.assert_allclose(found.arm.stiffness, soft.stiffness, rtol=0.15)


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
    def tried(draws, refinements, seed):
        monkeypatch.setattr(excitation, "_DRAWS", draws)
        monkeypatch.setattr(excitation, "_REFINEMENTS", refinements)
        return suggested(TRUTH, 10.0, seed)

    motion = tried(8, 60, 0)
    limits = np.array([TRUTH.joint_limit, TRUTH.velocity_limit, TRUTH.torque_limit])
    assert (np.array([*motion.largest().values()]) <= 1.01 * SHARE * limits).all()
    assert motion.condition() < 0.8 * np.median([tried(1, 1, seed).condition() for seed in range(1, 6)])
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
        (["--suggest", "motion.csv", "--robot", "ur5"], "described by joint frames"),
        (["no.csv"], "no.csv: No such file or directory"),
        (["no.csv", "--columns", "q1"], "q1 must have the form KEY=VALUE,KEY=VALUE,..., with each KEY only once"),
    ],
)
def test_bad_usage_is_one_line(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["identify", *words]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and message in err
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_the_arm_the_picture_and_the_numbers(found, logs, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fuzzyarm.identification.result.identify", lambda *_, **__: found)
    path, out, figure = (tmp_path / name for name in ("log.csv", "arm.toml", "angles.png"))
    path.write_text(logs[0].to_csv())
    assert main(["identify", str(path), "--out", str(out), "--figure", str(figure)]) == 0
    printed = capsys.readouterr().out
    said = [row["name"] for row in found.rows()]
    for words in (*said, "motors alone do not determine them", "held-out error [mrad, rms]"):
        assert words in printed
    assert ArmParameters.from_toml(out) == found.arm and "[ranges]" in out.read_text()
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert main(["identify", str(path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in document["parameters"]] == said
    assert document["arm"] == found.arm.to_dict() and document["held_out"].keys() == found.held_out.keys()
