"""A robot as text: what is written is read back to an equal robot."""

import pytest

from fuzzyarm.envs.physics.equations import chosen_arm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import shipped_robots


@pytest.mark.parametrize("name", shipped_robots())
def test_a_shipped_robot_survives_the_text(tmp_path, name):
    path = tmp_path / "robot.toml"
    path.write_text(chosen_arm(name, None).to_toml(), encoding="utf-8")
    assert chosen_arm(path, None) == chosen_arm(name, None)


def test_a_two_joint_arm_survives_the_text(tmp_path):
    arm = ArmParameters(length=(0.5, 0.4), stiffness=(8e3, 1 / 3e-4))
    (tmp_path / "robot.toml").write_text(arm.to_toml(), encoding="utf-8")
    assert chosen_arm(tmp_path, None) == arm
