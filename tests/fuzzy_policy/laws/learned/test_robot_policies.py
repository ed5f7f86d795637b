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
from fuzzyarm.fuzzy_policy.laws.learned.features import Features, Lanes
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


def test_features_of_three_joints_are_those_of_the_equations():
    d, n = FeatureDefinition(joints=3, past_errors=1, past_actions=2, integral_time=0.05), 3
    features, rng = Features(d, PERIOD, ROBOT), np.random.default_rng(0)
    lanes, memory, held = Lanes(features), np.zeros((4, features.memory_size)), np.empty((4, 0))
    errors, actions, integral = [np.zeros((4, n))], [np.zeros((4, n))] * 2, np.zeros((4, n))
    for _ in range(5):
        observation, action = rng.normal(size=(4, 5 * n)), rng.uniform(-1.0, 1.0, (4, n))
        q, dq, q_d, dq_d, ddq_d = np.split(observation, 5, axis=1)
        seen = lanes.see(observation, memory, held)
        expected = [
            np.arcsinh((q_d - q) / d.error_scale),
            np.arcsinh((dq_d - dq) / d.rate_scale),
            q_d,
            dq_d / d.velocity_scale,
            ddq_d / d.acceleration_scale,
            np.arcsinh(errors[-1] / d.error_scale),
            actions[-1],
            actions[-2],
            np.arcsinh(integral / d.integral_scale),
        ]
        np.testing.assert_allclose(seen, np.concatenate(expected, axis=1), rtol=1e-12, atol=1e-15)
        lanes.act(observation, action, 10.0 * action, memory, held)
        errors, actions = [*errors, q_d - q], [*actions, action]
        integral = (integral + PERIOD * (q_d - q)) * np.exp(-PERIOD / d.integral_time)
    with pytest.raises(ValueError, match="the features are for 3 joints, the arm has 2"):
        Features(d, PERIOD)


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
    for robot in ("ur5", "paper", dataclasses.replace(ROBOT, gravity=(9.8, 0.0, 0.0))):
        with pytest.raises(ValueError, match=r"^mine was trained on planar-3r and knows no other") as refused:
            load_policy(mine, robot=robot)
        assert "\n" not in str(refused.value)
    load_policy(mine, robot=dataclasses.replace(ROBOT, name="the same numbers"))
    with pytest.raises(ValueError, match="ppo-nominal was trained on the arm of Table 1"):
        load_policy("ppo-nominal", robot="ur5")


def test_a_bundle_of_another_two_joint_arm(tmp_path):
    robot_bundle(Robot.of(OTHER_ARM)).save(tmp_path / "mine")
    assert load_policy(tmp_path / "mine", robot=OTHER_ARM).parameters == OTHER_ARM
    with pytest.raises(ValueError, match="mine was trained on two-joint arm"):
        load_policy(tmp_path / "mine")


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


def test_what_a_name_says_reaches_the_terminal_harmlessly(tmp_path):
    robot_bundle(name="\x1b[31mred\nline").save(tmp_path / "mine")
    with pytest.raises(ValueError, match=r"mine was trained on \\x1b") as refused:
        load_policy(tmp_path / "mine", robot="ur5")
    assert "\n" not in str(refused.value)
