"""Who is at a torque limit for long is named, with the stability of the loop."""

from types import SimpleNamespace

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.evaluation import result_table as module
from fuzzyarm.eval.evaluation.result_table import saturation
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate

PERIOD = 1e-3


def rollout(policy, clipped, steps=1000):
    torque = np.tile([499.9, -249.9], (steps, 1))
    torque[:clipped, 1] = -250.0
    return SimpleNamespace(policy=policy, torque=torque)


@pytest.mark.parametrize(
    ("radius", "words"),
    [
        (1.7, "its loop is unstable on this arm (spectral radius 1.7 at rest, see fuzzyarm margins)"),
        (0.98, "its loop is stable (spectral radius 0.98 at rest, see fuzzyarm margins), the motion asks for more"),
        (ValueError("no\nequilibrium"), "whether its loop is stable on this arm was not found: no equilibrium"),
    ],
)
def test_a_policy_that_saturates_is_named_once_with_what_its_loop_does(radius, words, monkeypatch):
    def found(policy, arm, *, control_period):
        if isinstance(radius, ValueError):
            raise radius
        return radius

    monkeypatch.setattr(module, "spectral_radius", found)
    policies = dict.fromkeys(("soft", "hard"), SimpleNamespace(action_period=PERIOD))
    runs = [rollout("soft", 10), rollout("hard", 400), rollout("soft", 10), rollout("hard", 0)]
    (line,) = saturation(runs, policies, ArmParameters(), PERIOD)
    assert line.startswith(f"hard: a motor is at its torque limit in 20 % of the steps; {words}")


def test_a_law_whose_loop_is_unstable_on_a_light_arm_is_said_to_be_so():
    """Light rotors on soft joints, for which the law's bandwidth is too large; it follows the path all the same."""
    arm = ArmParameters(
        length=(0.3, 0.2),
        mass=(0.5594, 0.6043),
        mass_center=(0.3, 0.18378),
        inertia=(0.00313, 0.00351),
        motor_inertia=(0.00276, 0.00276),
        coulomb_friction=(0.093, 0.078),
        static_friction=(0.12, 0.1),
        stiffness=(500.0, 100.0),
        damping=(0.1, 0.05),
        torque_limit=(10.0, 10.0),
        velocity_limit=(20.0, 20.0),
    )
    found = evaluate(
        EvaluationConfig(policies=("computed-torque", "elastic-observer"), cases=("nominal",), parameters=arm)
    )
    (line,) = found.remarks
    assert line.startswith("computed-torque: ") and "its loop is unstable on this arm (spectral radius" in line
    assert load_policy("computed-torque").action_period == PERIOD
