"""The sheet of a law: equations, numbers with units, a certificate, and a state to check an implementation against."""

import csv
import dataclasses
import io
from collections.abc import Callable
from typing import Any

import numpy as np

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.common.checks import instance, listed
from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.joint import DRIVE_UNITS
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.fuzzy_policy.known_arm import QUANTITIES, per_joint_of
from fuzzyarm.fuzzy_policy.laws._gain_schedule import schedule_of
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy, SmoothObserverPolicy
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.scheduled import ScheduledPolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.ts_model import INTEGRAL, PLANT, PREMISES
from fuzzyarm.proof.invariant_set import InvariantSet, invariant_set
from fuzzyarm.proof.policy_certificate import PolicyCertificate, certificate_of

__all__ = ["certified_numbers", "default_certificate", "sheet_of"]


@dataclasses.dataclass(frozen=True)
class _Symbol:
    """A number or an array in the equations of a law."""

    name: str  # as in the equations
    unit: str  # of every entry; "-" without a unit, "SI" if rows have different units
    meaning: str  # in words, with the meaning of the axes
    values: np.ndarray  # any shape, () for one number


@dataclasses.dataclass(frozen=True)
class _LawSheet:
    """Everything needed to implement a policy."""

    policy: str  # its name
    law: str  # what it is, in words
    equations: tuple[str, ...]  # one per line, in the order of computation
    quantities: tuple[_Symbol, ...]  # the numbers in the equations
    check: tuple[_Symbol, ...]  # one observation and what an implementation must compute from it
    certificate: PolicyCertificate | None  # None if nothing is proven
    invariant: InvariantSet | None  # states from which the arm stays in the certificate's box; None also for -tip laws

    def to_text(self) -> str:
        """Return the sheet as readable text; numbers have ten significant digits."""
        lines = [f"{self.policy}: {self.law}", "", *(f"  {line}" for line in self.equations)]
        for heading, quantities in (("numbers", self.quantities), ("one state to check against", self.check)):
            lines += ["", f"{heading}:"]
            for quantity in quantities:
                unit = "" if quantity.unit == "-" else f" [{quantity.unit}]"
                lines += ["", f"  {quantity.name}{unit}: {quantity.meaning}", *_rows(quantity.values)]
        certificate = self.certificate
        numbers = {} if certificate is None else certified_numbers(certificate)
        lines += ["", "proven of the rigid arm:", "", *(f"  {name} = {value}" for name, value in numbers.items())]
        lines.append(f"  {'nothing' if certificate is None else certificate.text}")
        return "\n".join(lines if self.invariant is None else [*lines, f"  {self.invariant.statement}"])

    def to_csv(self) -> str:
        """Return every number as a row of CSV: quantity, index from 1, unit, value."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(("quantity", "index", "unit", "value"))
        for one in (*self.quantities, *self.check):
            for index, value in np.ndenumerate(one.values):
                writer.writerow([one.name, " ".join(str(k + 1) for k in index), one.unit, repr(float(value))])
        return text.getvalue().rstrip("\n")

    def to_dict(self) -> dict[str, Any]:
        """Return the sheet as plain data for JSON."""
        sheet: dict[str, Any] = {"policy": self.policy, "law": self.law, "equations": list(self.equations)}
        for part, those in (("quantities", self.quantities), ("check", self.check)):
            sheet[part] = {q.name: {"unit": q.unit, "meaning": q.meaning, "values": q.values.tolist()} for q in those}
        found = self.certificate
        sheet["certificate"] = found and {**certified_numbers(found), "scope": found.text}
        return sheet | {"invariant_set": self.invariant and self.invariant._asdict()}


_Law = tuple[str, tuple[str, ...], tuple[_Symbol, ...]]  # title, equations and numbers


def certified_numbers(certificate: PolicyCertificate) -> dict[str, str]:
    """Return the values of a certificate by name, as texts with units, rounded in the safe direction.

    They hold while angles and velocities stay in a box. If the motors' target leaves this box along the certificate's
    reference, the entry ``claim`` says that they are void.
    """
    controller = certificate.controller
    unit = {"consistent": "rad/(N m)", "paper": "SI units"}.get(getattr(controller, "form", ""), "s^2")
    numbers = {"alpha": f"{at_least(controller.alpha, 6)} 1/s", "gamma": f"{at_most(controller.gamma, 6)} {unit}"}
    if controller.fastest_pole is not None:
        numbers["fastest_pole"] = f"{at_most(controller.fastest_pole, 6)} 1/s"
    void = {} if certificate.bounds is not None else {"claim": "void along this reference, see the text"}
    return {**numbers, "digest": controller.digest, **void}


def _rows(values: np.ndarray) -> list[str]:
    """Return a line for each row of an array; each matrix of a stack begins with its indices, which count from 1."""
    table, lines = np.atleast_2d(values), []
    for *leading, row in np.ndindex(table.shape[:-1]):
        head = f"({', '.join(str(k + 1) for k in leading)})" if leading else ""
        first = head if row == 0 else " " * len(head)
        # Ten digits; JSON and CSV have the shortest number that identifies the value.
        lines.append(f"    {first} " + " ".join(f"{value:>17.10g}" for value in table[*leading, row]))
    return lines


_ERRORS = "e = q - q_d,   de = dq - dq_d,   x_I = 0 when an episode begins"
_LIMITS = (
    "tau_j = min(max(u_j, -Gamma_j), Gamma_j)",
    "x_I,j := x_I,j + T e_j, unless u_j > Gamma_j and e_j < 0, or u_j < -Gamma_j and e_j > 0",
)


def _fuzzy(policy: FuzzyPolicy) -> _Law:
    controller, model = policy.controller, policy.controller.model
    in_A = ", ".join(PREMISES[index] for index in model.kept_in_A) or "none"
    in_E = ", ".join(PREMISES[index] for index in model.kept_in_E) or "none"
    integral = " + H_ik x_I" if controller.integral else ""
    equations = (
        _ERRORS,
        "r = (q_d, dq_d, ddq_d)",
        "z1 = cos q2,   z2 = -c4 sinc(q1) - c5 sinc(q1 + q2),   z3 = -c5 sinc(q1 + q2)",
        "z4 = c2 dq2 sin q2,   z5 = -c2 dq1 sin q2,   sinc(x) = sin(x)/x, 1 at 0, with the measured q, dq",
        "w_k = min(max((z_k - zmin_k)/(zmax_k - zmin_k), 0), 1)",
        f"h_i = product over the kept premises of A ({in_A}) of w_k (bit of i-1 is 1: maximum) or 1 - w_k (0: minimum)",
        f"v_k likewise for E ({in_E}); the first premise is the lowest bit; an empty product is 1",
        f"u = sum over i, k of h_i v_k (K_ik (e, de){integral} + L_ik r)",
        *_LIMITS,
    )
    c = arm_constants(model.parameters)
    gains, low, high = controller.gains, model.bounds[:, 0], model.bounds[:, 1]
    quantities = [
        _Symbol("c2, c4, c5", "kg m^2, N m, N m", "of the premises", np.array([c.c2, c.c4, c.c5])),
        _Symbol("zmin", "as z", "smallest values of z1 to z5 in the box", low),
        _Symbol("zmax", "as z", "largest values", high),
        _Symbol("K", "N m/rad (2), N m s/rad (2)", "feedback of (e, de): (i, k, torque, entry)", gains[..., PLANT]),
    ]
    if controller.integral:
        quantities.append(_Symbol("H", "N m/(rad s)", "feedback of x_I: (i, k, torque, entry)", gains[..., INTEGRAL]))
    unit, forward = "N m/rad (2), N m s/rad (2), kg m^2 (2)", controller.feedforward_gains + 0.0  # no -0
    quantities += [
        _Symbol("L", unit, "feedforward of r: (i, k, torque, entry)", forward),
        _Symbol("A", "SI", "vertices of the model, for information: (i, row, column)", np.array(model.A_vertices)),
        _Symbol("E", "SI", "likewise: (k, row, column)", np.array(model.E_vertices)),
    ]
    return f"fuzzy law of {model.rules} rules, {controller.form} form", equations, tuple(quantities)


def sheet_of(name: str, policy: Policy) -> _LawSheet:
    """Return the sheet of a policy with its name in the heading; ValueError for kinds of policies without a sheet."""
    law, equations, quantities = _law(instance("policy", policy, Policy))  # type: ignore[type-abstract]
    common = (
        _Symbol("T", "s", "control period, the time between two calls", np.array(policy.control_period)),
        _Symbol("Gamma", "N m", "torque limits", per_joint_of(policy.parameters, "torque_limit")),
    )
    seen, state, torques = _check_observation(policy.joints), None, []
    for _ in range(3):
        torque, state = policy.predict(seen, state)
        torques.append(torque)
    check = (
        _Symbol("observation", "rad, rad/s, rad/s^2", "q, dq, q_d, dq_d, ddq_d", seen),
        _Symbol("torque", "N m", "tau in the first three calls, each with this observation", np.array(torques)),
        _Symbol("memory", "SI", "what is remembered after them", np.asarray(state)),
    )
    certificate = default_certificate(policy)
    along = None if certificate is None or isinstance(policy, TipPolicy) else invariant_set(certificate.controller)
    return _LawSheet(instance("name", name, str), law, equations, (*common, *quantities), check, certificate, along)


def default_certificate(policy: Policy) -> PolicyCertificate | None:
    """Return the certificate of a policy along the default motion of its arm; None if it has no certificate."""
    try:
        reference: Reference = default_reference(policy.parameters)
    except ValueError:  # out of reach; the claims of a fixed law do not depend on the reference
        return None if isinstance(policy, TipPolicy) else certificate_of(policy, default_reference(ArmParameters()))
    return certificate_of(policy, reference)


def _check_observation(joints: int) -> np.ndarray:
    """Return the observation (5 n,) [rad, rad/s, rad/s²] of an arm of n joints at which a law is checked."""
    k = np.arange(joints)
    return np.concatenate([0.3 + 0.5 * k, 0.5 - 0.9 * k, 0.31 + 0.48 * k, 0.45 - 0.8 * k, 1.0 - 3.0 * k])


def _law(policy: Policy) -> _Law:
    for kind, law in _LAWS.items():
        if isinstance(policy, kind):
            return law(policy)
    kinds = "fuzzy, computed-torque and -tip policies, elastic-observer and controller files"
    raise ValueError(
        f"no sheet of equations and matrices can be written for {type(policy).__name__}; choose from: {kinds}"
    )


def _computed_torque(policy: ComputedTorquePolicy) -> _Law:
    equations = (
        _ERRORS,
        "a = ddq_d - omega (3 de + omega (3 e + omega x_I))",
        "u = M(q) a + C(q, dq) dq + g(q) + I_a a + f_v dq",
        *_LIMITS,
    )
    bandwidth = _Symbol("omega", "rad/s", "of the triple pole at -omega", np.array(policy.bandwidth))
    return "computed torque with integral action", equations, (bandwidth, *_arm(policy))


def _scheduled(policy: ScheduledPolicy) -> _Law:
    controller = policy.controller
    names = listed([premise.name for premise in controller.premises]) if controller.premises else "none"
    equations = (
        _ERRORS,
        f"z_l = kept premises, in this order: {names};   w_l = (1 + z_l)/2",
        "h_r = product over l of w_l (bit l of r-1 is 1) or 1 - w_l (0); the first premise is the lowest bit",
        "u = M(q) ddq_d + C(q, dq) dq + g(q) + I_a ddq_d + f_v dq - sum_r h_r S_r (k_p e + k_d de + k_i x_I)",
        *_LIMITS,
    )
    k_p, k_d, k_i = controller.feedback
    quantities = (
        _Symbol("k_p", "1/s^2", "gain of the position error", np.array(k_p)),
        _Symbol("k_d", "1/s", "gain of its rate", np.array(k_d)),
        _Symbol("k_i", "1/s^3", "gain of its integral", np.array(k_i)),
        _Symbol("S", "kg m^2", "scheduled inertia (rule r, joint, joint)", controller.inertia),
        *_arm(policy),
    )
    return "gains scheduled over the inertia, semidefinite form", equations, quantities


def _tip(policy: TipPolicy) -> _Law:
    title, equations, quantities = _law(policy.law)
    inner = tuple(line for line in equations if line not in _LIMITS)
    own = (
        "tau_d = M(q_d) ddq_d + C(q_d, dq_d) dq_d + g(q_d);   b = B/K, joint by joint",
        "rate = (11 tau_d[k] - 18 tau_d[k-1] + 9 tau_d[k-2] - 2 tau_d[k-3])/(6 T)",
        "curvature = (2 tau_d[k] - 5 tau_d[k-1] + 4 tau_d[k-2] - tau_d[k-3])/T^2   (first call: all tau_d equal)",
        "theta = q_d + (tau_d - b (rate - b curvature))/K,   dtheta = dq_d + (rate - b curvature)/K,"
        "   ddtheta = ddq_d + curvature/K",
        "s = I_a ddtheta + f_v dtheta + tau_d;   v = dtheta + T/2 ddtheta",
        "u_ff = s + (s - s of the last call)/2 + (F_c + (F_s - F_c) exp(-(v/v_s)^2)) sign v",
        "u = law(q, dq, x_I; theta, dtheta, ddtheta) - law(theta, dtheta, 0; theta, dtheta, ddtheta) + u_ff, with law:",
    )
    known = {quantity.name for quantity in quantities}
    drives = tuple(quantity for quantity in _arm(policy) if quantity.name not in known)
    return f"{title}, leading the tip", (*own, *inner, *_LIMITS), (*quantities, *drives)


def _observer(policy: ElasticObserverPolicy) -> _Law:
    schedule, smooth = schedule_of(policy.parameters), isinstance(policy, SmoothObserverPolicy)
    moved = "without dry friction under tau - F(v) sign v, v as for -tip," if smooth else "with friction under tau"
    equations = (
        "x = (theta, q, dtheta, dq) of motors and links, d = load on the links; theta_d, dtheta_d, u_ff as for -tip",
        "(x, d) := (x, d) + L (measured motor angles and velocities - theta, dtheta)",
        "u = u_ff - d - K (x - x_d),   x_d = (theta_d - d/stiffness, q_d, dtheta_d, dq_d)",
        "tau_j = min(max(u_j, -Gamma_j), Gamma_j)",
        "(x, d) := the arm " + moved + " and d, a control period later (equations of motion in the docs)",
        "K, L interpolated linearly between the points of the schedule, even in "
        + ("cos q2 from -1 to 1" if schedule.cosine else "the kept angles"),
    )
    quantities = (
        _Symbol("K", "SI", "feedback (point, joint, x)", policy.feedback),
        _Symbol("L", "SI", "observer (point, (x, d), measurement)", policy.observer),
        _Symbol(
            "kept", "-", "numbers of the joints over whose angles K and L are tabulated", np.add(1.0, schedule.kept)
        ),
        *_arm(policy),
    )
    return "observer of links and load, state feedback", equations, quantities


def _arm(policy: Policy) -> tuple[_Symbol, ...]:
    """Return the constants of an arm: those of its equations of motion (of a robot, only masses), then its drives'."""
    arm, arrays = policy.parameters, robot_of(policy.parameters).arrays
    drives = tuple(_Symbol(name, DRIVE_UNITS[name], "of each joint", per_joint_of(arm, name)) for name in QUANTITIES)
    if isinstance(arm, ArmParameters):
        c = np.array(arm_constants(arm)[:5])
        return (_Symbol("c1..c5", "kg m^2 (3), N m (2)", "of M, C and g of the two-joint arm", c), *drives)
    return (_Symbol("mass", "kg", "of each link; the robot's file has the rest", np.array(arrays.mass)), *drives)


_LAWS: dict[type[Policy], Callable[[Any], _Law]] = {
    FuzzyPolicy: _fuzzy,
    TipPolicy: _tip,
    ScheduledPolicy: _scheduled,
    ComputedTorquePolicy: _computed_torque,
    ElasticObserverPolicy: _observer,
}
