"""Controllers of the form "semidefinite": their bounds against samples, their loop, and forged ones."""

import dataclasses
import functools
import json
import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from slow_twins import slow_but
from support.dissipation import scheduled_excess
from support.plain import scheduled_torque

from fuzzyarm.envs.physics.rigid_body import inverse_dynamics, mass_matrix
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.scheduled_controller import Premise, ScheduledController, load_controller
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.fuzzy_policy.signed_files import _digest_of as digest_of
from fuzzyarm.proof.box_cover import TrigMatrix
from fuzzyarm.proof.inertia_bounds import scheduled_polynomial
from fuzzyarm.proof.invariant_set import invariant_set
from fuzzyarm.proof.scheduled_certificate import certify_scheduled, schedule_rate, scheduled_statement
from fuzzyarm.proof.verification import verify_file
from fuzzyarm.synthesis import DesignFailed, ScheduledSpecification, design_scheduled
from fuzzyarm.synthesis import _scheduled_design as scheduled_design
from fuzzyarm.synthesis._inertia_metric import relative
from fuzzyarm.synthesis._scalar_design import best_feedback

COS_2, COS_3 = Premise(1, "cos q"), Premise(2, "cos q")
TIGHT = 0.98  # share of a bound that samples reach


def quickly(specification, robot):
    """Return a design from fewer samples, which are enough for three joints: it is tested at thousands of others."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scheduled_design, "_SAMPLES", 600)
        return design_scheduled(specification, robot)


@functools.cache
def designed(*premises):
    """Return the design for α = 20 1/s: the largest with margins is 15 or 20 where LAPACK's last digits differ."""
    return quickly(ScheduledSpecification(premises=premises, alpha=20.0), robot_named("planar-3r"))


FAST, SCHEDULES = ((), (COS_2, COS_3)), ((), (COS_2,), (COS_2, COS_3))


@pytest.fixture(params=slow_but(FAST, SCHEDULES), ids=["1 rule", "2 rules", "4 rules"])
def controller(request):
    return designed(*request.param).controller


def inertias(controller, count=4000):
    robot = controller.robot
    low, high = np.array([joint.angle_range for joint in robot.joints]).T
    q = np.random.default_rng(5).uniform(low, high, (count, len(robot)))
    return q, mass_matrix(robot, q) + np.diag(robot.drive("motor_inertia")), controller.inertia_at(q)


def test_bounds_hold_at_samples_and_are_tight(controller):
    q, inertia, scheduled = inertias(controller)
    shares = relative(inertia, scheduled)
    assert shares.min() > 1.0 and shares.max() < controller.kappa
    assert shares.min() < 1.0 / TIGHT and shares.max() > TIGHT * controller.kappa
    smallest = np.linalg.eigvalsh(scheduled)[:, 0].min()
    assert controller.floor < smallest < controller.floor / TIGHT + 1e-3
    hat = TrigMatrix(scheduled_polynomial(controller.premises, controller.inertia, controller.split))
    np.testing.assert_allclose(hat.at(q[:, 1:]), scheduled, rtol=1e-12, atol=1e-12)
    for premise, rate in zip(controller.premises, controller.rates, strict=True):
        reached = 0.5 * np.abs(relative(hat.derivative(premise.joint - 1).at(q[:, 1:]), scheduled)).max()
        assert TIGHT * rate < reached < rate


@pytest.mark.parametrize("schedules", slow_but([FAST], [FAST, SCHEDULES]), ids=["1 and 4 rules", "1, 2 and 4 rules"])
def test_more_rules_bring_the_fastest_pole_down(schedules):
    """κ and the fastest pole fall with rules, and so does γ at the fastest pole of one rule."""
    controllers = [designed(*kept).controller for kept in schedules]
    kappas, poles = [c.kappa for c in controllers], [c.fastest_pole for c in controllers]
    assert kappas == sorted(kappas, reverse=True) and poles == sorted(poles, reverse=True)
    assert kappas[0] < 5.2
    rates = [20.0 + float(c.rates @ c.speeds) for c in controllers]
    gains = [best_feedback(c.kappa, rate, poles[0]).gamma / c.floor for c, rate in zip(controllers, rates, strict=True)]
    assert gains == sorted(gains, reverse=True)


def test_every_claim_is_proven_in_floats_and_in_balls(controller):
    certificate = certify_scheduled(controller, in_balls=True)
    assert certificate.proven
    rate = schedule_rate(controller)  # by the speed limits of the angles of the premises
    assert int(rate.p) / int(rate.q) == pytest.approx(15.0 * controller.rates.sum(), rel=1e-12)
    assert sum("also in balls" in claim.name for claim in certificate.claims) == 3 + 2 * len(controller.premises)


NUMBERS = ("kappa", "floor", "alpha", "gamma", "fastest_pole", "inertia", "rates", "feedback", "lyapunov", "robot")
BETTER = (0.98, 1.04, 1.02, 0.98, 0.98, 1.02, 0.97, 1.05, 1.1, None)


@pytest.mark.parametrize(("name", "factor"), [*zip(NUMBERS, BETTER, strict=True)])
def test_no_number_of_a_controller_may_be_better_than_it_is(tmp_path, name, factor):
    controller = designed(COS_2, COS_3).controller
    value = getattr(controller, name)
    better = value.with_payload(1.0) if factor is None else factor * value
    dataclasses.replace(controller, **{name: better}).save(tmp_path / "forged.json")
    report = verify_file(tmp_path / "forged.json")
    assert not report.certificate.proven and "NOT PROVEN" in report.to_text()
    assert report.to_dict()["statement"] is None


def test_the_inequality_of_size_three_is_that_of_all_joints(controller):
    """V' + 2αV + eᵀM̂e - γ² dᵀM̂⁻¹d < 0 for any error and disturbance at the largest speeds, with M̄ë = -M̂(k·x) + d."""
    assert scheduled_excess(controller) < 0.0
    for field, factor in (("alpha", 1.5), ("gamma", 0.5)):
        assert scheduled_excess(dataclasses.replace(controller, **{field: factor * getattr(controller, field)})) > 0.0


def test_the_stated_constants_hold_between_any_two_errors_at_any_two_postures(controller):
    """No error of the same V, at another posture, is longer than the constant times the first."""
    stated = re.findall(r"<= (\S+) exp\(-\S+ t\) \|[xe]\(0\)\|", scheduled_statement(controller))
    n, scheduled = len(controller.robot), inertias(controller, 200)[2]
    metrics = np.array([np.kron(controller.lyapunov, S) for S in scheduled])
    for constant, size in zip(map(float, stated), (3 * n, n), strict=True):
        starts, ends = (np.linalg.eigvalsh(one[:, :size, :size]).max() for one in (metrics, np.linalg.inv(metrics)))
        assert np.sqrt(starts * ends) <= constant < 3.0 * np.sqrt(starts * ends)


@pytest.mark.slow
def test_the_nonlinear_loop_decays_at_least_as_fast_as_certified(controller):
    """Rigid arm, moving reference: V falls at least as exp(-2αt) from any of many errors."""
    robot, rng = controller.robot, np.random.default_rng(1)
    amplitude, phase = rng.uniform(0.5, 1.5, 3), rng.uniform(0, 6, 3)

    def target(t):
        angle = 2.0 * t + phase
        return tuple(amplitude * f for f in (np.sin(angle), 2.0 * np.cos(angle), -4.0 * np.sin(angle)))

    def slope(t, state):
        q, dq, x_I = np.split(state, 3, axis=1)
        u = scheduled_torque(controller, q, dq, target(t), x_I)
        passive = inverse_dynamics(robot, q, dq, np.zeros(3)) + robot.drive("viscous_friction") * dq
        inertia = mass_matrix(robot, q) + np.diag(robot.drive("motor_inertia"))
        ddq = np.linalg.solve(inertia, (u - passive)[..., np.newaxis])[..., 0]
        return np.hstack([dq, ddq, q - target(t)[0]])

    def lyapunov(t, state):
        q, dq, x_I = np.split(state, 3, axis=1)
        x = np.stack([q - target(t)[0], dq - target(t)[1], x_I], axis=1)
        return np.einsum("bai,ac,bij,bcj->b", x, controller.lyapunov, controller.inertia_at(q), x)

    start = np.concatenate([*target(0.0)[:2], np.zeros(3)])
    start = start + rng.normal(size=(40, 9)) * np.repeat([0.05, 1.0, 0.002], 3)
    motion = solve_ivp(
        lambda t, state: slope(t, state.reshape(40, 9)).ravel(), (0.0, 0.05), start.ravel(), rtol=1e-9, atol=1e-12,
        t_eval=np.linspace(0.0, 0.05, 201),
    )  # fmt: skip
    V = np.array([lyapunov(t, state.reshape(40, 9)) for t, state in zip(motion.t, motion.y.T, strict=True)])
    assert np.all(V[1:] <= V[:-1] * np.exp(-2.0 * controller.alpha * 2.5e-4) * (1.0 + 1e-6))


def test_files_round_trip_and_know_their_form(tmp_path, controller):
    path = tmp_path / "robot.json"
    controller.save(path)
    again, report = load_controller(path), verify_file(path)
    assert isinstance(again, ScheduledController) and again.digest == controller.digest
    assert again.robot.digest == controller.robot.digest
    assert report.certificate.proven and "NOT PROVEN" not in report.to_text() and report.to_dict()["proven"]
    with pytest.raises(ControllerFileError, match="schema"):
        Controller.load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(kappa=(2.0).hex(), digest=designed().controller.digest), "digest does not match"),
        (lambda c: c.update(split=7), "split"),
        (lambda c: c.update(lyapunov=[["0x1p0"]]), "lyapunov"),
        (lambda c: c["premises"].append({"joint": 0, "function": "cos q"}), "joint"),
        (lambda c: c["robot"].update(joints=[]), "at least one"),
        (lambda c: c["robot"]["joints"][2]["link"].update(mass=1.0), "robot's digest"),
        (lambda c: c.update(alpha="nan"), "alpha"),
        (lambda c: c.update(form="consistent"), "form"),
    ],
)
def test_damaged_and_forged_files_are_refused_in_one_line(tmp_path, change, message):
    path, content = tmp_path / "forged.json", json.loads(designed().controller.to_json())
    del content["digest"]
    change(content)
    path.write_text(json.dumps({"digest": digest_of(content)} | content))
    with pytest.raises(ControllerFileError, match=message) as refused:
        load_controller(path)
    assert "\n" not in str(refused.value)


def test_two_joints_agree_with_the_closed_form():
    """M̄ of the paper's arm is affine in cos q2: with that premise κ is 1 but for the widening, and with one rule the
    smallest fastest pole is near that of the consistent form's one-rule design (153 1/s at α = 20)."""
    two = robot_named("paper")
    exact_schedule = quickly(ScheduledSpecification(premises=(COS_2,)), two).controller
    assert exact_schedule.kappa < 1.01
    _, inertia, scheduled = inertias(exact_schedule, 200)
    diagonal = np.diagonal(inertia, axis1=-2, axis2=-1)  # the product of inertia passes through zero
    scale = np.sqrt(diagonal[..., :, np.newaxis] * diagonal[..., np.newaxis, :])
    assert np.abs((inertia - scheduled) / scale).max() < 0.02
    one = quickly(ScheduledSpecification(premises=()), two).controller
    assert (3.0 * one.kappa - 2.0) * one.alpha == pytest.approx(153.0, rel=0.2)
    asked = quickly(ScheduledSpecification(premises=(), gamma=5e-3), two).controller
    assert 4.5e-3 < asked.gamma / asked.floor <= 5e-3 * 1.001


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kappa"), [("ur5", 6.4), ("panda", 7.1)])
def test_six_and_seven_joints_are_proven(name, kappa):
    found = design_scheduled(ScheduledSpecification(premises=()), robot_named(name))
    assert found.certificate.proven and found.controller.kappa < kappa
    shares = relative(*inertias(found.controller, 1000)[1:])
    assert shares.min() > 1.0 and shares.max() < found.controller.kappa


@pytest.mark.slow
def test_the_best_premise_is_found_and_what_cannot_be_had_is_said():
    robot, plain = robot_named("planar-3r"), ScheduledSpecification(premises=(), alpha=20.0)
    assert design_scheduled(ScheduledSpecification(rules=2), robot).controller.premises == (COS_2,)
    for asked, message in (
        (dataclasses.replace(plain, fastest_pole=100.0), "no feedback was found for fastest_pole = 100 1/s"),
        (dataclasses.replace(plain, gamma=1e-12), "gamma"),
        (ScheduledSpecification(rules=8), "which allow at most 4 rules"),
    ):
        with pytest.raises(DesignFailed, match=message):
            design_scheduled(asked, robot)


def test_the_set_lies_in_half_of_the_box_and_v_falls_on_its_border(controller):
    """At random states of the border, of any posture: room to the box, and supply below decay."""
    found, X = invariant_set(controller), controller.lyapunov
    rng, M = np.random.default_rng(3), inertias(controller, 500)[2]
    x = rng.normal(size=(len(M), 3, M.shape[-1]))
    x *= np.sqrt(found.level / np.einsum("kia,ij,kab,kjb->k", x, X, M, x))[:, np.newaxis, np.newaxis]
    assert np.abs(x[:, 0]).max() <= np.pi / 2.0
    for premise, speed in zip(controller.premises, controller.speeds, strict=True):
        assert np.abs(x[:, 1, premise.joint]).max() <= speed / 2.0
    d = rng.normal(size=x[:, 0].shape)
    d *= found.disturbance / np.linalg.norm(d, axis=1, keepdims=True)
    supply = controller.gamma**2 * np.einsum("ka,kab,kb->k", d, np.linalg.inv(M), d)
    assert supply.max() <= 2.0 * controller.alpha * found.level
    assert X[0, 0] * np.linalg.eigvalsh(M).max() * found.start**2 <= found.level
    assert "for every reference in the middle half of each range of angles" in found.statement
