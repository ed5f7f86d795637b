"""Episodes, single and batched, in one call and in passes; their metrics; and what a policy believed in them."""

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pytest
from slow_twins import slow_but
from support.rollouts import made_rollout

from fuzzyarm import ArmParameters, Controller, MarginsConfig, run_episode
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise, MachiningForce, TorqueBias
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import TipErrors, episodes
from fuzzyarm.eval.episodes.metrics import METRICS, add_metric, metrics_of
from fuzzyarm.eval.episodes.rollout import Rollout, record_passes, record_rollout, rollout_of
from fuzzyarm.eval.episodes.rollout_file import read_rollouts, write_rollouts
from fuzzyarm.eval.evaluation.recheck import recheck_results
from fuzzyarm.eval.evaluation.results_file import _check_rollout as _check_stored
from fuzzyarm.eval.evaluation.results_file import _check_row, read_results
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate, row_of, write_results
from fuzzyarm.eval.report._belief_charts import belief_section
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.policies import load_policy, resolve

NOISY = Disturbance(tip_force=MachiningForce(), encoder_noise=EncoderNoise(1e-5, 1e-3))
REFERENCES = [JointReference(duration=duration) for duration in (1.4, 1.2, 1.5)]


class Escaping:
    """Computed torque, but full torque in lane 1 from call 300 on: that episode is terminated."""

    def __init__(self):
        self.law, self.calls, self.starts = load_policy("computed-torque"), 0, []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        torque, state = self.law.predict(observation, state, episode_start, deterministic)
        self.calls += 1
        self.starts.append(episode_start.copy())
        if self.calls > 300:
            torque[1] = self.law.parameters.torque_limit
        return torque, state


def recorded(envs, policy, lanes):
    """Return the rollout of each lane, and the tip errors of all."""
    steps, errors = list(episodes(envs, policy, envs.reset(seed=5))), TipErrors(lanes)
    for step in steps:
        errors.add(step)
    parameters = load_policy("computed-torque").parameters
    given = {"policy": "", "case": "", "control_period": 1e-3, "parameters": parameters}
    return [rollout_of(steps, lane, seed=5 + lane, **given) for lane in range(lanes)], errors


@pytest.mark.parametrize("name", slow_but(["elastic-observer"], ["computed-torque", "elastic-observer"]))
def test_each_lane_is_the_single_arm(name):
    envs = FuzzyArmVectorEnv(3, disturbance=NOISY, reference=REFERENCES, threads=1)
    runs, errors = recorded(envs, load_policy(name), 3)
    for lane, (run, reference) in enumerate(zip(runs, REFERENCES, strict=True)):
        env = FuzzyArmEnv(disturbance=NOISY, reference=reference)
        alone = record_rollout(env, load_policy(name), policy_name="", case="", seed=5 + lane)
        assert alone.step_time > 0.0
        for field in dataclasses.fields(Rollout):
            if field.name != "step_time":
                np.testing.assert_array_equal(getattr(run, field.name), getattr(alone, field.name), err_msg=field.name)
        assert errors.largest[lane] == alone.tip_error.max()
        assert errors.rms[lane] == pytest.approx(np.sqrt(np.mean(alone.tip_error**2)), rel=1e-12)
        assert errors.steps[lane] == len(alone.time) == round(1e3 * reference.duration)
    assert errors.completed.all()


def test_a_terminated_lane_stops_there_and_the_others_go_on():
    policy = Escaping()
    envs = FuzzyArmVectorEnv(3, reference=JointReference(duration=1.2), threads=1)
    (first, escaped, last), errors = recorded(envs, policy, 3)
    assert (first.completed, escaped.completed, last.completed) == (True, False, True)
    assert errors.completed.tolist() == [True, False, True]
    assert escaped.reason.endswith("left the domain (25)")
    assert first.reason == last.reason == ""
    assert escaped.domain_use[-1] > 1.0 >= escaped.domain_use[:-1].max()
    assert 300 < len(escaped.time) < len(first.time) == 1200
    assert escaped.time[-1] == pytest.approx(1e-3 * len(escaped.time))  # not the instant of the next episode
    assert errors.steps.tolist() == [len(first.time), len(escaped.time), len(last.time)]
    starts = np.array(policy.starts)
    assert starts[0].all()
    assert not starts[1:, [0, 2]].any()
    assert np.flatnonzero(starts[1:, 1])[0] + 1 == len(escaped.time)


def test_sensors_and_actuators_can_be_changed():
    env, given = FuzzyArmEnv(reference=JointReference(duration=0.6)), []

    class Seen:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            given.append(observation)
            return np.array([1.0, 2.0]), state

    start = env.reset(seed=0)
    run = episodes(env, Seen(), start, sense=lambda o, info: o + info["time"], actuate=lambda torque: 3.0 * torque)
    step = next(run)
    np.testing.assert_array_equal(given[0], start[0] + start[1]["time"])
    np.testing.assert_array_equal(step.info["torque"], [3.0, 6.0])
    next(run)
    np.testing.assert_array_equal(given[1], step.observation + step.info["time"])


def test_every_step_says_what_the_policy_remembers_and_how_long_it_took():
    env, law = FuzzyArmEnv(reference=JointReference(duration=0.6)), load_policy("fuzzy-4")
    (observation, info), memory = env.reset(seed=0), np.full(law.memory_size, 1e-3)
    expected = law.predict(observation, memory)
    step = next(episodes(env, law, (observation, info), memory=memory))
    np.testing.assert_array_equal(step.info["torque"], expected[0])
    np.testing.assert_array_equal(step.memory, expected[1])
    assert 0.0 < step.seconds < 1.0


class Counting:
    """A policy that tells in its torque which pass it is in, and counts how often it looks back."""

    looked_back = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        count = 0 if state is None else state
        return np.array([float(count), 0.0]), count

    def begin_pass(self, state):
        self.looked_back += 1
        return state + 1

    def repeated(self):
        return self


def test_each_pass_begins_with_what_begin_pass_returned(short):
    policy = Counting()
    runs = record_passes(FuzzyArmEnv(), policy, 3, policy_name="counting", case="nominal", seed=0)
    assert [run.torque[0, 0] for run in runs] == [0.0, 1.0, 2.0]
    assert [run.seed for run in runs] == [0, 1, 2]
    assert policy.looked_back == 2  # nothing is learned from the last one


def test_rows_hold_the_errors_of_every_pass_and_the_file_is_read_back(tmp_path, short):
    config = EvaluationConfig(policies=("fuzzy-4-tip",), cases=("machining",), passes=2)
    done = evaluate(config)
    (row,) = done.rows
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
    with pytest.raises(ControllerFileError, match=r"^the controller is not proven \(failed inequalities: \d+, the"):
        load_policy(dataclasses.replace(SHIPPED, gamma=0.5 * SHIPPED.gamma))
    assert load_policy(dataclasses.replace(SHIPPED, gamma=0.5 * SHIPPED.gamma), allow_unproven=True).joints == 2
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
    for config in (EvaluationConfig, MarginsConfig):
        with pytest.raises(TypeError, match="give a name, the path of a TOML file, a Robot or ArmParameters"):
            config(robot=3)


N = 1000
T = 1e-3


def signals(**changes):
    return made_rollout(T * np.arange(1, N + 1), **changes)


def test_all_zero_signals_give_zero_but_for_the_margin_and_the_time():
    values = metrics_of(signals())
    assert values.pop("domain_margin") == 1.0
    assert values.pop("predict_us") == pytest.approx(4.0)
    assert set(values.values()) == {0.0}


def edges(*last):
    """A tip error of 1 mm, larger in the first and the last tenth of a second, and at the samples beside these."""
    error = np.full(N, 1e-3)
    error[:100], error[-100:], error[100], error[-101] = 9e-3, 8e-3, 2e-3, *last
    return error


SINE = np.sin(2 * np.pi * np.arange(N) / N)
STILL = np.zeros(N)
OF_SIGNALS = [
    ({"tip_error": 1e-3 * np.abs(SINE)}, {"tip_error_max_mm": 1.0, "tip_error_rms_mm": np.sqrt(0.5)}),
    ({"tip_error": edges(3e-3)}, {"tip_error_max_mid_mm": 3.0}),
    ({"tip_error": edges(1e-3)}, {"tip_error_max_mid_mm": 2.0}),
    (
        {
            "circularity_error": np.linspace(-2e-3, 6e-3, N),
            "circularity_error_motor": np.linspace(-1e-4, 2e-4, N),
        },
        {
            "circularity_link_min_mm": -2.0,
            "circularity_link_max_mm": 6.0,
            "circularity_motor_min_mm": -0.1,
            "circularity_motor_max_mm": 0.2,
        },
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
    values = metrics_of(signals(**changes))
    assert {name: values[name] for name in expected} == pytest.approx(expected, rel=1e-5)


def test_an_episode_of_one_step_has_metrics():
    assert np.isfinite(list(metrics_of(made_rollout(np.array([T]))).values())).all()


def test_every_metric_says_what_it_is_and_a_name_that_is_taken_is_refused():
    for name, metric in METRICS.items():
        assert metric.name == name
        assert metric.description.endswith(".")
        assert name.endswith({"mm": "_mm", "mrad": "_mrad", "µs": "_us"}.get(metric.unit, ""))
    assert [name for name, metric in METRICS.items() if not metric.reproducible] == ["predict_us"]
    with pytest.raises(ValueError, match="metric 'energy' already exists"):
        add_metric(dataclasses.replace(METRICS["energy"], unit="kJ"))


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
    assert first.belief_names == runs[0].belief_names and first.note == noted.note
    assert second.beliefs.size == 0 and second.belief_names == () and second.note == ""
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
    values, deviations = (4.2, 1.04, 0.97, -1e-9, 0.3, 2e-3), (1.5, 0.02, 0.1, 2.0, 0.0, 5e-4)
    names = tuple(name + end for name in columns for end in ("", "_deviation"))
    numbers = np.tile([number for pair in zip(values, deviations, strict=True) for number in pair], (3, 1))
    numbers[2] = np.nan  # the filter has diverged
    run = dataclasses.replace(runs[0], beliefs=numbers, belief_names=names, note="a <note>")
    pushed = dataclasses.replace(
        EvaluationConfig(payload=7.5).case("payload", None),
        disturbance=Disturbance(payload=Payload(7.5), torque_bias=TorqueBias((3.0, -1.0))),
    )
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
        kept = np.zeros(2), np.zeros(2), np.array(state), np.array(np.inf if state == 2 else 1.0), np.zeros(2)
        names = "force", "force_deviation", "payload", "payload_deviation", "offset"  # which has no deviation
        return SimpleNamespace(
            **dict(zip(names, kept, strict=True)), diverged=np.array(state >= 5), at_end=ends, other_path=state >= 3
        )


def test_what_has_to_be_known_is_on_the_console_in_the_results_in_the_file_and_on_the_page(tmp_path):
    run = record_rollout(FuzzyArmEnv(), Diverging(), policy_name="own", case="nominal", seed=0)
    said = (
        "from 0.003 s on, its path differs from that of the previous pass, and it no longer expects the forces "
        "of that pass; "
        "at 0.005 s, its filter diverged or its torques oscillated, and its fallback has acted since; "
        "estimates that reached an end of their range: joint stiffness (first at 0.001 s), "
        "payload (first at 0.004 s, and at the end)"
    )
    assert run.note == said
    row = row_of(run)
    assert row["note"] == said
    _check_row(row, ("nominal", "own", 0))
    write_rollouts([run], tmp_path)
    assert read_rollouts(tmp_path / "rollouts.npz")[0].note == said
    _check_stored(run, row)
    with pytest.raises(ValueError, match="note of own in case nominal is 'all is well', but its rollout gives"):
        _check_stored(run, row | {"note": "all is well"})
    assert said in belief_section([run])


def test_a_filter_that_has_diverged_believes_nothing():
    run = record_rollout(FuzzyArmEnv(), Diverging(), policy_name="own", case="nominal", seed=0)
    assert "offset_1" not in run.believed
    np.testing.assert_array_equal(run.believed["payload"][:7], [0.0, 1.0, 2.0, 3.0, 4.0, np.nan, np.nan])
    np.testing.assert_array_equal(run.believed["payload_deviation"][:4], [1.0, 1.0, np.nan, 1.0])
