"""Learned policies of any robot: features of n joints, and bundles that say which robot they are for."""

import dataclasses
import json

import numpy as np
import pytest
from support.bundles import network

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.fuzzy_policy.laws.learned.bundle import BundleError, PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, ArmDefinition, FeatureDefinition
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy
from fuzzyarm.policies import load_policy

ROBOT, PERIOD = robot_named("planar-3r"), 2e-3
OTHER_ARM = ArmParameters(mass=(20.0, 10.0))


def robot_bundle(robot=ROBOT, name=None):
    """A bundle for a robot, or for another two-joint arm, with a random network."""
    joints, features = len(robot), FeatureDefinition(joints=len(robot), past_errors=1, past_actions=2)
    return PolicyBundle(
        features,
        ActionDefinition(scale=tuple(10.0 + k for k in range(joints)), period=PERIOD),
        network((features.size, 8, joints)),
        arm=ArmDefinition(name or robot.name, robot.digest),
    )


def test_a_bundle_of_a_robot_comes_back_and_acts_in_a_batch_as_alone(tmp_path):
    robot_bundle().save(tmp_path / "mine")
    policy = load_policy(tmp_path / "mine", robot="planar-3r")
    assert isinstance(policy, LearnedPolicy) and policy.bundle.arm == ArmDefinition("planar-3r", ROBOT.digest)
    observations = np.random.default_rng(0).normal(size=(5, 7, 15))
    state, alone = None, [None] * 7
    for observation in observations:
        torque, state = policy.predict(observation, state)
        for lane in range(7):
            own, alone[lane] = policy.predict(observation[lane], alone[lane])
            np.testing.assert_array_equal(own, torque[lane])
    assert torque.shape == (7, 3) and (np.abs(torque) <= [10.0, 11.0, 12.0]).all()


def test_a_bundle_is_for_its_arm_alone(tmp_path):
    mine = tmp_path / "mine" / "policy"  # as fuzzyarm train names it
    mine.parent.mkdir()
    robot_bundle().save(mine)
    load_policy(mine, robot=dataclasses.replace(ROBOT, name="the same numbers"))
    robot_bundle(name="\x1b[31mred\nline").save(tmp_path / "red")
    robot_bundle(Robot.of(OTHER_ARM)).save(tmp_path / "other")
    assert load_policy(tmp_path / "other", robot=OTHER_ARM).parameters == OTHER_ARM
    for policy, robot, message in (
        (mine, "ur5", r"^mine was trained on planar-3r and knows no other"),
        (mine, "paper", r"^mine was trained on planar-3r and knows no other"),
        (mine, dataclasses.replace(ROBOT, gravity=(9.8, 0.0, 0.0)), "^mine was trained on planar-3r"),
        (tmp_path / "red", "ur5", r"red was trained on \\x1b"),
        (tmp_path / "other", None, "other was trained on two-joint arm"),
        ("ppo-nominal", "ur5", "ppo-nominal was trained on the arm of Table 1"),
    ):
        with pytest.raises(ValueError, match=message) as refused:
            load_policy(policy, robot=robot)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("arm"), "it is for 3 joints and does not say of which arm"),
        (lambda d: d["features"].update(joints=2), "the features are for 2 joints, the action has 3 scales"),
        (lambda d: d["features"].update(joints=13), "joints = 13 is out of range"),
        (lambda d: d["arm"].update(digest=7), r"at `arm.digest`"),
        (lambda d: d["arm"].update(more=7), "unknown field more"),
        (lambda d: d["action"].update(scale=[1.0] * 13), "number of scales = 13"),
    ],
)
def test_a_damaged_bundle_is_refused(tmp_path, change, message):
    folder = tmp_path / "mine"
    robot_bundle().save(folder)
    content = json.loads((folder / "policy.json").read_text())
    change(content)
    (folder / "policy.json").write_text(json.dumps(content))
    with pytest.raises(BundleError, match=message):
        PolicyBundle.load(folder)
