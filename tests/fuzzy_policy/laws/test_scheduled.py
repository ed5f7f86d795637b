"""The policy of the semidefinite form: against its law in plain NumPy, on the elastic robot, and what it refuses."""

import dataclasses
import functools

import numpy as np
import pytest
from support.plain import scheduled_torque

from fuzzyarm import (
    ArmParameters,
    EvaluationConfig,
    Robot,
    ScheduledSpecification,
    design_scheduled,
    evaluate,
    load_policy,
    robot_named,
)
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.fuzzy_policy.known_arm import with_drives
from fuzzyarm.fuzzy_policy.laws.scheduled import ScheduledPolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.fuzzy_policy.scheduled_controller import FUNCTIONS, Premise
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.proof.policy_certificate import certificate_of

ARM, N = robot_named("planar-3r"), 3


@functools.cache
def designed():
    return design_scheduled(ScheduledSpecification(premises=()), ARM).controller


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("scheduled") / "p3.json"
    designed().save(path)
    return path


def with_premises(*premises):
    """A controller of these premises with the gains of `designed` and rules that differ at random; not proven."""
    rng = np.random.default_rng(7)
    spread = rng.normal(scale=0.01, size=(2 ** len(premises), N, N))
    inertia = designed().inertia + (spread + np.swapaxes(spread, 1, 2))  # in this order it is symmetric exactly
    return dataclasses.replace(designed(), premises=premises, rates=np.ones(len(premises)), inertia=inertia)


def observations(lanes, rng):
    """Observations (lanes, 15) with errors so small that no torque is clipped."""
    q, dq = rng.uniform(-3.0, 3.0, (lanes, N)), rng.normal(scale=0.3, size=(lanes, N))
    q_d, dq_d = q + 1e-4 * rng.normal(size=q.shape), dq + 1e-3 * rng.normal(size=q.shape)
    return np.hstack([q, dq, q_d, dq_d, rng.normal(scale=0.3, size=q.shape)])


@pytest.mark.parametrize(
    "premises",
    [(), *[(Premise(1, f), Premise(2, g)) for f, g in zip(FUNCTIONS, reversed(FUNCTIONS), strict=True)]],
    ids=lambda premises: ", ".join(premise.name for premise in premises) or "1 rule",
)
def test_the_policy_is_its_law(premises):
    controller, rng = with_premises(*premises), np.random.default_rng(0)
    policy = ScheduledPolicy(controller, control_period=2e-3)
    seen, integral = observations(20, rng), 1e-6 * rng.normal(size=(20, N))
    q, dq, *target = np.split(seen, 5, axis=1)
    torque, memory = np.empty((20, N)), integral.copy()
    policy.act(seen, memory, torque)
    np.testing.assert_allclose(torque, scheduled_torque(controller, q, dq, target, integral), rtol=1e-11, atol=1e-10)
    np.testing.assert_allclose(memory, integral + 2e-3 * (q - target[0]), rtol=1e-14)


@pytest.mark.slow
def test_the_elastic_robot_follows_its_default_reference(file):
    outcome = evaluate(EvaluationConfig(policies=(str(file), f"{file}-tip"), cases=("nominal",), robot=ARM))
    plain = outcome.rollouts[0]
    assert outcome.complete and plain.control_period == 1e-3
    # The motors start off the reference by the bending under gravity; the error must decay and stay small.
    error = np.abs(plain.q_motor - plain.q_reference).max(axis=1)
    assert error[plain.time > 0.2].max() < 0.25 * error[0]
    plain_error, tip_error = (row["tip_error_rms_mm"] for row in outcome.rows)
    assert tip_error < 1e-2 * plain_error
    claimed = {"alpha": designed().alpha, "gamma": designed().gamma, "controller_digest": designed().digest}
    assert outcome.bounds["p3-tip"] == outcome.bounds["p3"] == {"form": "semidefinite"} | claimed
    assert all(text.startswith("For the rigid arm of 3 joints in cont") for text in outcome.certificates.values())


def test_the_certificate_holds_for_every_reference(file):
    policy, reference = load_policy(file, robot=ARM), default_reference(ARM)
    assert isinstance(policy, ScheduledPolicy)
    certificate, tip = certificate_of(policy, reference), certificate_of(TipPolicy(policy), reference)
    assert certificate.any_reference and certificate.controller.digest == designed().digest
    assert not tip.any_reference and "theta_d" in tip.text


STIFFER = with_drives(ARM, stiffness=1.1 * ARM.drive("stiffness"))


@pytest.mark.parametrize("robot", ["ur5", None, ArmParameters(mass=(1.0, 2.0)), STIFFER])
def test_another_robot_is_refused(file, robot):
    with pytest.raises(ControllerFileError, match=r"for the robot 'planar-3r' \(\w{12}\), not for '.+' \(\w{12}\)"):
        load_policy(file, robot=robot)


def test_a_file_that_is_not_proven_is_refused(tmp_path):
    forged = tmp_path / "forged.json"
    dataclasses.replace(designed(), alpha=2.0 * designed().alpha).save(forged)
    with pytest.raises(ControllerFileError, match=r"is not proven .* first: decay and gain"):
        load_policy(forged, robot=ARM)
    assert load_policy(forged, robot=ARM, allow_unproven=True).controller.alpha == 2.0 * designed().alpha


def test_a_file_of_the_paper_arm_acts_on_the_paper_arm(tmp_path):
    path = tmp_path / "two.json"
    design_scheduled(ScheduledSpecification(premises=()), Robot.of(ArmParameters())).controller.save(path)
    observation = np.array([0.1, 0.2, 0.3, 0.4, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])  # without error: the feedforward alone
    torque, expected = (load_policy(name).predict(observation)[0] for name in (path, "computed-torque"))
    np.testing.assert_allclose(torque, expected, rtol=1e-11)
