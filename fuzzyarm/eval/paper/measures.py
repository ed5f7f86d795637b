"""How each number is measured: functions from the evidence to values by label.

The label is a controller's key (`controllers.TITLES`) or a few words.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import MachiningForce
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.paper.controllers import FORMS, RULES, TITLES
from fuzzyarm.eval.paper.evidence import HIGH_GAIN, WITNESSES, Evidence
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.synthesis.complexity import Size, full_size, paper_formula
from fuzzyarm.synthesis.design import PAPER_WEIGHT
from fuzzyarm.synthesis.error_model import paper_form

Measure = Callable[[Evidence], Mapping[str, float]]
TABLE_2_RULES = (32, 16, 8, 4)
INSTANTS = 3001  # of the reference, evenly spaced; the middle one, where it is fastest, is among them


# Of the reference and the cases --------------------------------------------------------------------------------------


def tip_speed(evidence: Evidence) -> dict[str, float]:
    """Return the reference's largest |ṗ| [m/s]."""
    velocity = evidence.reference.tip(_instants(evidence)).velocity
    return {"reference": float(np.linalg.norm(velocity, axis=-1).max())}


def rigid_torque(evidence: Evidence) -> dict[str, float]:
    """Return the largest |Γ| [N m] of (4), rigid joints, along the reference, with viscous and Stribeck friction."""
    reference, parameters = evidence.reference, evidence.reference.parameters
    arm, motion = arm_constants(parameters), reference.sample(_instants(evidence))
    coulomb, static = np.array(parameters.coulomb_friction), np.array(parameters.static_friction)
    slip = stribeck_magnitude(motion.dq, coulomb, static, parameters.stribeck_velocity)
    torque = rigid_inverse_dynamics(*motion, arm) + np.array(parameters.motor_inertia) * motion.ddq
    torque += np.array(parameters.viscous_friction) * motion.dq + slip * np.sign(motion.dq)
    return {f"joint {number}": float(value) for number, value in enumerate(np.abs(torque).max(axis=0), start=1)}


def force_range(evidence: Evidence) -> dict[str, float]:
    """Return the smallest and the largest f_e [N] over the motion, from the force at a tip speed of 1 m/s."""
    force = CASES["machining"].disturbance.tip_force or MachiningForce()
    time = _instants(evidence)
    size = np.linalg.norm(force.at(time, np.tile([1.0, 0.0], (len(time), 1))), axis=-1)
    return {"smallest": float(size.min()), "largest": float(size.max())}


def payload_mass(evidence: Evidence) -> dict[str, float]:
    """Return the carried mass of Case 3 [kg]."""
    return {"payload": CASES["payload"].disturbance.payload.mass}


def payload_share(evidence: Evidence) -> dict[str, float]:
    """Return it in per cent of m_2."""
    return {"of m_2": 100.0 * payload_mass(evidence)["payload"] / evidence.reference.parameters.mass[1]}


# Of the inequalities and their solutions -----------------------------------------------------------------------------


def fewest_rules(evidence: Evidence) -> dict[str, float]:
    """Return the smallest number of rules with a solution of Theorem 2 proven (0: none), and how many files are."""
    proven = [evidence.witnesses[name].model.rules for name in WITNESSES if name in evidence.proven]
    return {"fewest rules": min(proven, default=0), f"proven of {len(WITNESSES)} witnesses": len(proven)}


def unbounded_gain(evidence: Evidence) -> dict[str, float]:
    """Return the largest entry of K where no bound was asked for, 0 if that file is not proven."""
    proven = HIGH_GAIN in evidence.proven
    return {"4 rules": _largest(evidence.witnesses[HIGH_GAIN].gains[..., :4]) if proven else 0.0}


def bounded_M(evidence: Evidence) -> dict[str, float]:
    """Return the largest |M_ik|, M_ik = [K_ik H_ik] P11, the left side of (24)."""
    result = {}
    for key in _printed():
        gains, n_e = evidence.controllers[key].gains, evidence.controllers[key].gains.shape[-1]
        products = gains @ evidence.controllers[key].P[:n_e, :n_e]
        result[key] = float(np.linalg.norm(products, ord=2, axis=(-2, -1)).max())
    return result


def largest_gain(array: str, columns: slice) -> Measure:
    """Return the measure of the largest entry of an array of gains of the printed forms, in some columns."""

    def measure(evidence: Evidence) -> dict[str, float]:
        return {key: _largest(getattr(evidence.controllers[key], array)[..., columns]) for key in _printed()}

    return measure


def gamma_with_other_L(evidence: Evidence) -> dict[str, float]:
    """Return the smallest γ at which Theorem 2 proves the printed form, 4 rules, with another L, see `Evidence`."""
    return dict(evidence.gamma_with)


def decay_rate(evidence: Evidence) -> dict[str, float]:
    """Return the proven α [1/s]; that it is proven was checked when the controllers were loaded."""
    return {f"{form}-{rules}": evidence.controllers[f"{form}-{rules}"].alpha for form in FORMS for rules in RULES}


def weight(evidence: Evidence) -> dict[str, float]:
    """Return the diagonal of Q, the same for both printed forms or NaN."""
    first, second = (evidence.controllers[key].weight for key in _printed())
    assert first is not None and second is not None  # the printed form has one
    return {
        f"Q{i + 1}{i + 1}": float(a) if a == b else float("nan")
        for i, (a, b) in enumerate(zip(first, second, strict=True))
    }


def printed_size(entry: str) -> Measure:
    """Return the measure of N_var or N_row by Remark 4's formula, `entry` a field of `Size`."""
    return _sizes(lambda model: paper_formula(len(model.A_vertices), len(model.E_vertices)), entry)


def true_size(entry: str) -> Measure:
    """Return the measure of the size of Theorem 2 (for 32 rules 1) as it is printed, without integral."""
    return _sizes(
        lambda model: full_size(paper_form(model, False, np.array(PAPER_WEIGHT), common_multiplier=True)), entry
    )


# Of the rollouts -----------------------------------------------------------------------------------------------------


def circularity(case: str, side: str, of: Callable[[np.ndarray], float]) -> Measure:
    """Return the measure of the circularity error [mm] in a case, `of` the smallest, the largest, or the largest size.

    Args:
        case: the case.
        side: "tip" (links) or "motors", as if the joints were rigid.
        of: from the errors over time to one number.
    """
    return by_controller(case, lambda run: of(1e3 * circularity_of(run, side)))


def circularity_of(run: Rollout, side: str) -> np.ndarray:
    """Return the circularity error (n,) [m] on one side."""
    return run.circularity_error if side == "tip" else run.circularity_error_motor


def peak(values: np.ndarray) -> float:
    """Return the largest absolute value."""
    return float(np.abs(values).max())


def smallest(values: np.ndarray) -> float:
    """Return the smallest value."""
    return float(values.min())


def largest(values: np.ndarray) -> float:
    """Return the largest value."""
    return float(values.max())


def worst_case(side: str) -> Measure:
    """Return the measure of the largest circularity error of Case 2 over that of Case 3."""
    second, third = (circularity(case, side, peak) for case in ("machining", "payload"))
    return lambda evidence: {key: second(evidence)[key] / third(evidence)[key] for key in TITLES}


def rule_difference(evidence: Evidence) -> dict[str, float]:
    """Return the largest difference of tip circularity between 32 and 4 rules [mm], as long as both go on."""
    result = {}
    for form in FORMS:
        for number, case in enumerate(CASES, start=1):
            many, few = (evidence.rollouts[f"{form}-{rules}", case].circularity_error for rules in RULES)
            n = min(len(many), len(few))
            result[f"{form} form, Case {number}"] = 1e3 * peak(many[:n] - few[:n])
    return result


def peak_torque(joint: int) -> Measure:
    """Return the measure of a joint's largest |Γ| in Case 1 [N m], `joint` from 0."""
    return by_controller("nominal", lambda run: peak(run.torque[:, joint]))


def shortest_episode(evidence: Evidence) -> dict[str, float]:
    """Return the end of the shortest episode of the three cases [s]: the reference's, or where it left the box (25)."""
    return {key: min(float(evidence.rollouts[key, case].time[-1]) for case in CASES) for key in TITLES}


def feedforward_at_rest(evidence: Evidence) -> dict[str, float]:
    """Return what L_hv r asks of joint 1 at t = 0, where the arm rests on the reference [N m]."""
    return {key: _feedforward(controller, evidence) for key, controller in evidence.controllers.items()}


def by_controller(case: str, of: Callable[[Rollout], float]) -> Measure:
    """Return the measure of one number of the rollout of each controller in a case."""
    return lambda evidence: {key: of(evidence.rollouts[key, case]) for key in TITLES}


def _feedforward(controller: Controller, evidence: Evidence) -> float:
    motion = evidence.reference.sample(0.0)
    policy, at_rest = FuzzyPolicy(controller), np.concatenate([motion.q, motion.dq, *motion])
    torque = np.zeros((1, 2))
    policy.act(at_rest[np.newaxis], np.zeros((1, policy.memory_size)), torque)
    return float(torque[0, 0])


def _sizes(size: Callable[[TSModel], Size], entry: str) -> Measure:
    def measure(evidence: Evidence) -> dict[str, float]:
        parameters = evidence.reference.parameters
        return {f"{n} rules": getattr(size(TSModel(parameters, NAMED_RULES[n])), entry) for n in TABLE_2_RULES}

    return measure


def _printed() -> tuple[str, ...]:
    return tuple(f"printed-{rules}" for rules in RULES)


def _largest(gains: np.ndarray) -> float:
    return float(np.abs(gains).max())


def _instants(evidence: Evidence) -> np.ndarray:
    return np.linspace(0.0, evidence.reference.duration, INSTANTS)
