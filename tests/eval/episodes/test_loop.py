"""The episode loop, single and batched: the same signals for the same arm, and lanes that end at different times."""

import dataclasses

import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm import ArmParameters, Controller, EvaluationConfig, MarginsConfig, load_policy, metrics_of, run_episode
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise, MachiningForce
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import TipErrors, episodes
from fuzzyarm.eval.episodes.rollout import Rollout, Signals, record_passes, record_rollout
from fuzzyarm.eval.evaluation.recheck import recheck_results
from fuzzyarm.eval.evaluation.results_file import read_results
from fuzzyarm.eval.evaluation.run import evaluate, write_results
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.policies import resolve

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
    signals, errors = [Signals(lane) for lane in range(lanes)], TipErrors(lanes)
    for step in episodes(envs, policy, envs.reset(seed=5)):
        errors.add(step)
        for one in signals:
            one.add(step)
    parameters = load_policy("computed-torque").parameters
    given = {"policy": "", "case": "", "control_period": 1e-3, "parameters": parameters}
    return [one.rollout(seed=5 + lane, **given) for lane, one in enumerate(signals)], errors


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


def test_what_the_policy_reads_and_what_the_motors_get_can_be_changed():
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
    with pytest.raises(ControllerFileError, match=r"^the controller is not proven \(\d+ inequalities fail"):
        load_policy(dataclasses.replace(SHIPPED, gamma=0.5 * SHIPPED.gamma))
    assert load_policy(dataclasses.replace(SHIPPED, gamma=0.5 * SHIPPED.gamma), allow_unproven=True).joints == 2
    with pytest.raises(ControllerFileError, match=r"^the controller was designed for another robot \(mass differ"):
        load_policy(SHIPPED, robot=OTHER)
    with pytest.raises(TypeError, match="a policy is a name, a path or a controller; int was given"):
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
        with pytest.raises(TypeError, match="it must be a name, the path of a TOML file, a Robot or ArmParameters"):
            config(robot=3)
