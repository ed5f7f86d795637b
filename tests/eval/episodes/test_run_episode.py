"""A policy by any handle, on any arm, in one call: the episode is that of the environment and the evaluation."""

import dataclasses

import numpy as np
import pytest

from fuzzyarm import ArmParameters, Controller, EvaluationConfig, MarginsConfig, load_policy, metrics_of, run_episode
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.eval.evaluation.run import evaluate
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.policies import resolve

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
