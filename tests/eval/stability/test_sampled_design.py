"""Designs for arms of any size by default, with margins on the sampled elastic arm, and the number in the way."""

import dataclasses

import pytest
from support.command_line import printed

from fuzzyarm import ArmParameters, Controller, DesignFailed, Specification, design, load_policy
from fuzzyarm.envs.physics.equations import corners_of
from fuzzyarm.eval.stability.margins import ends_in_words, ends_of
from fuzzyarm.eval.stability.sampled_design import first_with_margins, why_unstable
from fuzzyarm.synthesis.specification import ALPHAS, gamma_for

pytestmark = pytest.mark.usefixtures("few_postures")

PENDULUM = ArmParameters(
    length=(0.3, 0.2), mass=(0.6, 0.6), mass_center=(0.2, 0.15), inertia=(0.005, 0.004), motor_inertia=(0.007, 0.003),
    stiffness=(500.0, 100.0), damping=(0.1, 0.05), torque_limit=(6.0, 6.0), coulomb_friction=(0.09, 0.08),
    static_friction=(0.12, 0.1), velocity_limit=(20.0, 20.0), viscous_friction=(1e-3, 1e-3),
)  # fmt: skip


def scaled(mass):
    arm = ArmParameters()
    names = ("mass", "inertia", "motor_inertia", "stiffness", "damping", "viscous_friction", "torque_limit")
    return dataclasses.replace(arm, **{name: tuple(mass * one for one in getattr(arm, name)) for name in names})


@pytest.mark.parametrize("mass", [1e-4, 1e3])
def test_the_gains_of_an_arm_of_other_mass_are_those_of_table_1_in_proportion(mass):
    """All torques scale, so that γ does with their inverse."""
    arms = ArmParameters(), scaled(mass)
    assert gamma_for(arms[1]) == pytest.approx(2e-4 / mass)
    first, other = (design(Specification(kept=(), gamma=gamma_for(arm)), arm).controller.gains for arm in arms)
    assert abs(other - mass * first).max() < 0.01 * mass * abs(first).max()


@pytest.mark.slow
def test_a_light_pendulum_is_designed_by_default_with_margins(tmp_path, capsys):
    robot, out = tmp_path / "arm.toml", tmp_path / "c.json"
    PENDULUM.write_toml(robot)
    assert "WARNING" not in printed(capsys, "design", "--robot", robot, "--out", out)
    made = Controller.load(out)
    assert made.alpha in ALPHAS[1:] and made.gamma == gamma_for(PENDULUM, made.alpha)


@pytest.mark.slow
def test_the_number_in_the_way_is_named():
    arm = dataclasses.replace(PENDULUM, motor_inertia=(0.003, 0.0008))
    made = design(Specification(kept=("z1",), alpha=5.0, gamma=gamma_for(arm, 5.0)), arm).controller
    text = why_unstable(made, arm, 1e-3)
    assert "a control period of" in text and "is strict for this arm" not in text
    factor = float(text.partition("rotors ")[2].split()[0])
    heavier = dataclasses.replace(arm, motor_inertia=tuple(factor * one for one in arm.motor_inertia))
    radii = ends_of(load_policy(made), {"heavier": heavier, "own": arm}, 1e-3)
    assert radii["heavier"] < 1.0 <= radii["own"]


@pytest.mark.slow
def test_a_gamma_that_cannot_be_reached_is_an_error_that_names_the_usual_one():
    with pytest.raises(DesignFailed, match=r"relax gamma to about.*gamma = 0\.013 is usual for this arm's"):
        design(Specification(gamma=2e-4), PENDULUM)
    rates = [Specification(kept=("z1",), alpha=alpha, gamma=1e-30) for alpha in (20.0, 2.0)]
    with pytest.raises(DesignFailed):
        first_with_margins(rates, PENDULUM, 1e-3)


def test_of_several_rates_the_first_with_margins_is_taken():
    rates = [Specification(kept=("z1",), alpha=alpha, gamma=gamma_for(PENDULUM, alpha)) for alpha in (20.0, 2.0)]
    assert first_with_margins(rates, PENDULUM, 1e-3).controller.alpha == 2.0
    assert first_with_margins(rates[:1], PENDULUM, 1e-3).controller.alpha == 20.0


def test_the_end_of_a_range_that_decides_is_named(tmp_path):
    robot = tmp_path / "arm.toml"
    robot.write_text(PENDULUM.to_toml() + "[ranges]\nmotor_inertia = [[0.002, 0.01], [0.0008, 0.004]]\n")
    policy = load_policy("computed-torque", robot=PENDULUM)
    ends = ends_of(policy, corners_of(str(robot)), 1e-3)
    assert ends["motor_inertia low"] > ends["motor_inertia high"]
    text = ends_in_words(ends)
    assert "with motor_inertia low (the worst), " in text and "parameter that gives the worst value" in text
