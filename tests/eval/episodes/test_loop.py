"""Episodes, single and batched, in one call and in passes; their metrics; and what a policy believed in them."""

import dataclasses
import re
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest
from slow_twins import slow_but
from support.results import identical
from support.rollouts import made_rollout

from fuzzyarm import ArmParameters, Controller, MarginsConfig, robot_named, run_episode
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.scenario.cases import Case
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise, MachiningForce, TorqueBias
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import TipErrors, episodes
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import Rollout, record_passes, record_rollout, rollout_of
from fuzzyarm.eval.episodes.rollout_file import read_rollouts, write_rollouts
from fuzzyarm.eval.evaluation.recheck import recheck_results
from fuzzyarm.eval.evaluation.results_file import _check_rollout, _check_row, read_results
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate, row_of, write_results
from fuzzyarm.eval.report._belief_charts import belief_section
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.policies import load_policy, resolve

NOISY = Disturbance(tip_force=MachiningForce(), encoder_noise=EncoderNoise(1e-5, 1e-3))
REFERENCES = [JointReference(duration=duration) for duration in (1.4, 1.2, 1.5)]


class Escaping:
    """Computed torque, but full torque in lane 1 from call 300 on: that episode is terminated."""

    def __init__(self):
        self.law, self.starts = load_policy("computed-torque"), []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        torque, state = self.law.predict(observation, state, episode_start, deterministic)
        self.starts.append(episode_start.copy())
        if len(self.starts) > 300:
            torque[1] = self.law.parameters.torque_limit
        return torque, state


def recorded(policy, **given):
    """Return the rollout of each of three lanes, and the tip errors of all."""
    envs, errors = FuzzyArmVectorEnv(3, threads=1, **given), TipErrors(3)
    steps = list(episodes(envs, policy, envs.reset(seed=5)))
    for step in steps:
        errors.add(step)
    named = {"policy": "", "case": "", "control_period": 1e-3, "parameters": ArmParameters()}
    return [rollout_of(steps, lane, seed=5 + lane, **named) for lane in range(3)], errors


@pytest.mark.parametrize("name", slow_but(["elastic-observer"], ["computed-torque", "elastic-observer"]))
def test_each_lane_is_the_single_arm(name):
    runs, errors = recorded(load_policy(name), disturbance=NOISY, reference=REFERENCES)
    for lane, (run, reference) in enumerate(zip(runs, REFERENCES, strict=True)):
        env = FuzzyArmEnv(disturbance=NOISY, reference=reference)
        alone = record_rollout(env, load_policy(name), policy_name="", case="", seed=5 + lane)
        assert alone.step_time > 0.0
        same = {name for name, value in vars(alone).items() if identical(getattr(run, name), value)}
        assert {field.name for field in dataclasses.fields(Rollout)} - same == {"step_time"}
        assert errors.largest[lane] == alone.tip_error.max()
        assert errors.rms[lane] == pytest.approx(np.sqrt(np.mean(alone.tip_error**2)), rel=1e-12)
        assert errors.steps[lane] == len(alone.time) == round(1e3 * reference.duration)
    assert errors.completed.all()


def test_a_terminated_lane_stops_there_and_the_others_go_on():
    policy = Escaping()
    (first, escaped, last), errors = recorded(policy, reference=JointReference(duration=1.2))
    assert [first.completed, escaped.completed, last.completed] == errors.completed.tolist() == [True, False, True]
    assert escaped.reason.endswith("left the domain (25)")
    assert first.reason == last.reason == ""
    assert escaped.domain_use[-1] > 1.0 >= escaped.domain_use[:-1].max()
    assert 300 < len(escaped.time) < len(first.time) == 1200
    assert escaped.time[-1] == pytest.approx(1e-3 * len(escaped.time))  # not the instant of the next episode
    assert errors.steps.tolist() == [len(first.time), len(escaped.time), len(last.time)]
    starts = np.array(policy.starts)
    assert starts[0].all() and not starts[1:, [0, 2]].any()
    assert np.flatnonzero(starts[1:, 1])[0] + 1 == len(escaped.time)


def test_sensors_and_actuators_can_be_changed_and_every_step_says_what_the_policy_remembers():
    env, law = FuzzyArmEnv(reference=JointReference(duration=0.6)), load_policy("fuzzy-4")
    seen, memory = env.reset(seed=0), np.full(law.memory_size, 1e-3)
    changed = {"sense": lambda observation, info: observation + info["time"], "actuate": lambda torque: 0.5 * torque}
    run = episodes(env, law, seen, memory=memory, **changed)
    for _ in range(2):
        torque, memory = law.predict(seen[0] + seen[1]["time"], memory)
        step = next(run)
        np.testing.assert_array_equal(step.info["torque"], 0.5 * torque)
        np.testing.assert_array_equal(step.memory, memory)
        assert 0.0 < step.seconds < 1.0
        seen = step.observation, step.info


def test_link_side_measurement_is_unstable_where_motor_side_is_not():
    """Why the motors are measured: 30 rad/s, half the shipped bandwidth, chatters at the torque limits."""

    def link_side(observation, info):
        return np.concatenate([info["q_link"], info["dq_link"], observation[4:]])

    env, rates = FuzzyArmEnv(), []
    for sense in (None, link_side):
        steps = episodes(env, ComputedTorquePolicy(bandwidth=30.0), env.reset(seed=0), sense=sense)
        run = rollout_of(steps, parameters=env.parameters, policy="", case="nominal", seed=0, control_period=1e-3)
        rates.append(metrics_of(run)["torque_rate_rms"])
    assert rates[0] < 1e3 and rates[1] > 1e4


def test_each_pass_begins_with_what_begin_pass_returned(short):
    class Counting:
        """A policy that tells in its torque which pass it is in."""

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.array([float(state or 0), 0.0]), state or 0

        begin_pass = mock.Mock(side_effect=lambda state: state + 1)

        def repeated(self):
            return self

    runs = record_passes(FuzzyArmEnv(), Counting(), 3, policy_name="counting", case="nominal", seed=0)
    assert [(run.torque[0, 0], run.seed) for run in runs] == [(0.0, 0), (1.0, 1), (2.0, 2)]
    assert Counting.begin_pass.call_count == 2  # nothing is learned from the last one


def test_rows_hold_the_errors_of_every_pass_and_the_file_is_read_back(tmp_path, short):
    config = EvaluationConfig(policies=("fuzzy-4-tip",), cases=("machining",), passes=2)
    (row,) = (done := evaluate(config)).rows
    assert row["pass_2_max_mm"] == row["tip_error_max_mm"] < row["pass_1_max_mm"]
    assert row["pass_2_rms_mm"] == pytest.approx(row["tip_error_rms_mm"], rel=1e-12)
    assert config.command() == "fuzzyarm evaluate --policy fuzzy-4-tip --case machining --passes 2"
    write_results(done, tmp_path)
    assert not recheck_results(read_results(tmp_path)).differences


SHIPPED = Controller.load(resolve("fuzzy-1").path)
OTHER = ArmParameters(mass=(15.0, 10.0))


def test_it_is_the_episode_of_an_evaluation():
    (row,) = evaluate(EvaluationConfig(policies=("fuzzy-1",), cases=("payload",))).rows
    run = run_episode("fuzzy-1", "payload")
    assert (run.policy, run.case) == ("fuzzy-1", "payload")
    assert metrics_of(run) | {"predict_us": 0.0} == {key: row[key] for key in metrics_of(run)} | {"predict_us": 0.0}


def test_a_controller_is_a_policy_as_its_file_is():
    by_name, by_controller = run_episode("fuzzy-1"), run_episode(SHIPPED)
    np.testing.assert_array_equal(by_name.torque, by_controller.torque)
    assert by_controller.policy == "Controller"
    unproven = dataclasses.replace(SHIPPED, gamma=0.5 * SHIPPED.gamma)
    with pytest.raises(ControllerFileError, match=r"^the controller is not proven \(failed inequalities: \d+, the"):
        load_policy(unproven)
    assert load_policy(unproven, allow_unproven=True).joints == 2
    with pytest.raises(ControllerFileError, match=r"^the controller was designed for another robot \(different: mass"):
        load_policy(SHIPPED, robot=OTHER)
    with pytest.raises(TypeError, match="a policy must be a name, a path or a controller, not int"):
        load_policy(3)


def test_parameters_are_a_robot_wherever_one_is_asked_for(tmp_path):
    (tmp_path / "other.toml").write_text("mass = [15.0, 10.0]")
    assert FuzzyArmEnv(robot=OTHER).parameters == OTHER == load_policy("computed-torque", robot=OTHER).parameters
    assert run_episode("computed-torque", robot=OTHER).tip_error.max() < 0.01
    for robot in (OTHER, tmp_path / "other.toml", str(tmp_path / "other.toml")):
        config = EvaluationConfig(robot=robot)
        assert (config.robot, config.parameters, config.arm) == (None, OTHER, OTHER)
        assert MarginsConfig(robot=robot).arm == OTHER
    assert EvaluationConfig(robot="ur5").arm == MarginsConfig(robot="ur5").arm == robot_named("ur5")
    assert EvaluationConfig(robot="ur5").command() == "fuzzyarm evaluate --robot ur5"
    assert MarginsConfig(robot=OTHER).command() is None
    with pytest.raises(TypeError, match="give a name, the path of a TOML file, a Robot or ArmParameters"):
        EvaluationConfig(robot=3)


N = 1000
TIME = 1e-3 * np.arange(1, N + 1)


def test_all_zero_signals_give_zero_but_for_the_margin_and_the_time():
    values = metrics_of(made_rollout(TIME))
    assert (values.pop("domain_margin"), values.pop("predict_us")) == (1.0, pytest.approx(4.0))
    assert set(values.values()) == {0.0}
    assert np.isfinite(list(metrics_of(made_rollout(TIME[:1])).values())).all()  # of one step


def edges(*last):
    """A tip error of 1 mm, larger in the first and the last tenth of a second, and at the samples beside these."""
    error = np.full(N, 1e-3)
    error[:100], error[-100:], error[100], error[-101] = 9e-3, 8e-3, 2e-3, *last
    return error


SINE = np.sin(2 * np.pi * np.arange(N) / N)
STILL, RAMP = np.zeros(N), np.linspace(-2e-3, 6e-3, N)
OF_SIGNALS = [
    ({"tip_error": 1e-3 * np.abs(SINE)}, {"tip_error_max_mm": 1.0, "tip_error_rms_mm": np.sqrt(0.5)}),
    ({"tip_error": edges(3e-3)}, {"tip_error_max_mid_mm": 3.0}),
    ({"tip_error": edges(1e-3)}, {"tip_error_max_mid_mm": 2.0}),
    *(
        ({f"circularity_error{of}": RAMP}, {f"circularity_{side}_min_mm": -2.0, f"circularity_{side}_max_mm": 6.0})
        for of, side in (("", "link"), ("_motor", "motor"))
    ),
    # The joint error is over both joints, and on the motor side.
    ({"q_motor": np.stack([STILL + 3e-3, STILL], 1), "q_link": np.ones((N, 2))}, {"joint_error_rms_mrad": 4.5**0.5}),
    (  # Joint 1 climbs 0.1 N m a step, joint 2 not at all.
        {"torque": np.stack([np.linspace(0, 99.9, N), STILL - 7.0], axis=1)},
        {"torque_peak_1": 99.9, "torque_peak_2": 7.0, "torque_rms_2": 7.0, "torque_rate_rms": 5000.0**0.5},
    ),
    # Braking is work, too.
    ({"torque": np.full((N, 2), 10.0), "dq_motor": np.stack([SINE, STILL], axis=1)}, {"energy": 20.0 / np.pi}),
]


@pytest.mark.parametrize(("changes", "expected"), OF_SIGNALS, ids=[next(iter(one)) for _, one in OF_SIGNALS])
def test_a_metric_is_what_its_description_says(changes, expected):
    values = metrics_of(made_rollout(TIME, **changes))
    assert {name: values[name] for name in expected} == pytest.approx(expected, rel=1e-5)


@pytest.fixture(scope="module")
def runs():
    env = FuzzyArmEnv(case="machining")
    names = ("adaptive-observer", "elastic-observer")
    return [record_rollout(env, load_policy(name), policy_name=name, case="machining", seed=0) for name in names]


def test_beliefs_come_back_from_the_file_and_are_checked(runs, tmp_path):
    noted = dataclasses.replace(runs[0], note="its filter diverged, or its torques swung, at 0.002 s")
    path = write_rollouts([noted, runs[1]], tmp_path)
    first, second = read_rollouts(path)
    np.testing.assert_array_equal(first.beliefs, runs[0].beliefs)
    assert (first.belief_names, first.note) == (runs[0].belief_names, noted.note)
    assert (second.beliefs.size, second.belief_names, second.note) == (0, (), "")
    for damaged in (
        {"belief_names": runs[0].belief_names[:-1]},
        {"belief_names": (*runs[0].belief_names[:-1], "payload")},  # twice
        {"beliefs": np.where(runs[0].beliefs == runs[0].beliefs[3, 2], np.inf, runs[0].beliefs)},
    ):
        with pytest.raises(ValueError, match=r"rollouts\.npz is damaged \(belief"):
            read_rollouts(write_rollouts([dataclasses.replace(runs[0], **damaged)], tmp_path))


def test_the_page_shows_what_is_believed_beside_the_truth(runs):
    drawn = belief_section(runs)
    assert drawn.count("<figure>") == drawn.count('class="belief-band"') == 1 and "adaptive-observer" in drawn
    assert belief_section(runs[1:]) == ""
    columns = "payload", "stiffness_1", "stiffness_2", "offset_1", "offset_2", "lateness"
    names = (*columns, *(f"{name}_deviation" for name in columns))
    numbers = np.tile([4.2, 1.04, 0.97, -1e-9, 0.3, 2e-3, 1.5, 0.02, 0.1, 2.0, 0.0, 5e-4], (3, 1))
    numbers[2] = np.nan  # the filter has diverged
    run = dataclasses.replace(runs[0], beliefs=numbers, belief_names=names, note="a <note>")
    pushed = Case("pushed", "pushed", Disturbance(payload=Payload(7.5), torque_bias=TorqueBias((3.0, -1.0))))
    drawn = belief_section([run, dataclasses.replace(run, seed=1, note="")], {"machining": pushed})
    rows = re.findall(r"<tr><th scope=.row.>(.*?)</th>(.*?)</tr>", drawn)
    assert {label: re.findall(r"<td.*?>(.*?)</td>", cells) for label, cells in rows} == {
        "payload [kg]": ["4.2 ± 1.5", "7.5"],
        "stiffness": ["1.040 ± 0.020", "0.97 ± 0.10", "1"],
        "offset [N m]": ["0.0 ± 2.0", "0.3000 ± 0.0000", "3, -1"],
        "lateness [ms]": ["2.00 ± 0.50", "0"],
    }
    assert "at 0.002 s" in drawn and "seed 0: a &lt;note&gt;" in drawn and "seed 1" not in drawn
    assert "<svg" not in drawn  # no force is believed


class Diverging:
    """A policy at rest whose filter diverges at the sixth sample; before that an estimate stands at its end twice."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros(2), 0 if state is None else state + 1

    def beliefs(self, state):
        ends = {"payload": np.array(state == 4), "joint_stiffness": np.array(state in (1, 3)), "mass": np.array(False)}
        kept = dict.fromkeys(("force", "force_deviation", "offset"), np.zeros(2))  # the offset has no deviation
        kept |= {"payload": np.array(state), "payload_deviation": np.array(np.inf if state == 2 else 1.0)}
        return SimpleNamespace(**kept, diverged=np.array(state >= 5), at_end=ends, other_path=state >= 3)


def test_what_has_to_be_known_is_in_the_results_in_the_file_and_on_the_page(tmp_path):
    run = record_rollout(FuzzyArmEnv(), Diverging(), policy_name="own", case="nominal", seed=0)
    said = (
        "from 0.003 s on, its path differs from that of the previous pass, and it no longer expects the forces of "
        "that pass; at 0.005 s, its filter diverged or its torques oscillated, and its fallback has acted since; "
        "estimates that reached an end of their range: joint stiffness (first at 0.001 s), "
        "payload (first at 0.004 s, and at the end)"
    )
    row = row_of(run)
    assert run.note == row["note"] == said
    _check_row(row, ("nominal", "own", 0))
    assert read_rollouts(write_rollouts([run], tmp_path))[0].note == said
    _check_rollout(run, row)
    with pytest.raises(ValueError, match="note of own in case nominal is 'all is well', but its rollout gives"):
        _check_rollout(run, row | {"note": "all is well"})
    assert said in belief_section([run])
    # Once its filter has diverged it believes nothing.
    assert "offset_1" not in run.believed
    np.testing.assert_array_equal(run.believed["payload"][:7], [0.0, 1.0, 2.0, 3.0, 4.0, np.nan, np.nan])
    np.testing.assert_array_equal(run.believed["payload_deviation"][:4], [1.0, 1.0, np.nan, 1.0])
