"""How each number is measured: functions from the evidence to values by label.

A label is the key of a controller in `evidence.TITLES`, or a few words.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.friction import DryFriction, stribeck_magnitude
from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES
from fuzzyarm.envs.scenario.disturbances import MachiningForce
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.paper.evidence import FORMS, HIGH_GAIN, RULES, SWAPPED, TITLES, WITNESSES, Evidence, key_of
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.proof.vertices import tracking_vertices
from fuzzyarm.fuzzy_policy.states import PLANT
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.synthesis.complexity import Size, full_size, paper_formula
from fuzzyarm.synthesis.specification import PAPER_WEIGHT

__all__ = [
    "TABLE_2_RULES", "Measure", "bounded_M", "circularity", "circularity_of", "decay_rate", "feedforward_at_rest",
    "fewest_rules", "force_range", "gamma_with_other_L", "largest", "largest_feedforward_gain", "largest_gain",
    "payload_mass", "payload_share", "peak", "peak_torque", "printed_size", "rigid_torque", "rule_difference",
    "shortest_episode", "smallest", "tip_speed", "true_size", "unbounded_gain", "weight", "worst_case",
]  # fmt: skip

Measure = Callable[[Evidence], Mapping[str, float]]
"""Returns numbers by what they belong to, such as the key of a controller."""
TABLE_2_RULES = (32, 16, 8, 4)
"""Numbers of rules in Table 2."""
_INSTANTS = 3001  # evenly spaced along the reference; one of them is the middle, where the reference is fastest


# Measures of the reference and of the cases ---------------------------------------------------------------------------


def tip_speed(evidence: Evidence) -> dict[str, float]:
    """Return the reference's largest |ṗ| [m/s]."""
    velocity = evidence.reference.tip(_instants(evidence)).velocity
    return {"reference": float(np.linalg.norm(velocity, axis=-1).max())}


def rigid_torque(evidence: Evidence) -> dict[str, float]:
    """Return the largest |Γ| [N m] of (4), rigid joints, along the reference; with viscous and Stribeck friction."""
    reference, parameters = evidence.reference, evidence.reference.parameters
    arm, motion = arm_constants(parameters), reference.sample(_instants(evidence))
    coulomb, static = np.array(parameters.coulomb_friction), np.array(parameters.static_friction)
    slip = stribeck_magnitude(motion.dq, DryFriction(coulomb, static, parameters.stribeck_velocity))
    torque = rigid_inverse_dynamics(*motion, arm) + np.array(parameters.motor_inertia) * motion.ddq
    torque += np.array(parameters.viscous_friction) * motion.dq + slip * np.sign(motion.dq)
    return {f"joint {number}": float(value) for number, value in enumerate(np.abs(torque).max(axis=0), start=1)}


def force_range(evidence: Evidence) -> dict[str, float]:
    """Return the smallest and the largest f_e [N] over the motion.

    The force is evaluated at a tip speed of 1 m/s, at which it is not faded.
    """
    force = CASES["machining"].disturbance.tip_force or MachiningForce()
    time = _instants(evidence)
    size = np.linalg.norm(force.at(time, np.tile([1.0, 0.0], (len(time), 1))), axis=-1)
    return {"smallest": float(size.min()), "largest": float(size.max())}


def payload_mass(evidence: Evidence) -> dict[str, float]:
    """Return the carried mass of Case 3 [kg]."""
    return {"payload": CASES["payload"].disturbance.payload.mass}


def payload_share(evidence: Evidence) -> dict[str, float]:
    """Return the carried mass of Case 3 in per cent of m_2."""
    return {"of m_2": 100.0 * payload_mass(evidence)["payload"] / evidence.reference.parameters.mass[1]}


# Measures of the inequalities and of their solutions ------------------------------------------------------------------


def fewest_rules(evidence: Evidence) -> dict[str, float]:
    """Return the smallest number of rules for which a solution of Theorem 2 is proven (0: none), and how many are."""
    proven = [evidence.witnesses[name].model.rules for name in WITNESSES if name in evidence.proven]
    return {"fewest rules": min(proven, default=0), f"proven of {len(WITNESSES)} witnesses": len(proven)}


def unbounded_gain(evidence: Evidence) -> dict[str, float]:
    """Return the largest entry of K of the design without the bound (24); 0 if its file is not proven."""
    proven = HIGH_GAIN in evidence.proven
    return {"4 rules": _largest(evidence.witnesses[HIGH_GAIN].gains[..., PLANT]) if proven else 0.0}


def bounded_M(evidence: Evidence) -> dict[str, float]:
    """Return the largest |M_ik|, M_ik = [K_ik H_ik] P11, the left side of (24)."""
    result = {}
    for key in _printed():
        gains, P = evidence.controllers[key].gains, evidence.controllers[key].P
        n_e = gains.shape[-1]
        products = gains @ P[:n_e, :n_e]
        result[key] = float(np.linalg.norm(products, ord=2, axis=(-2, -1)).max())
    return result


def largest_gain(columns: slice) -> Measure:
    """Return the measure of the largest entry of K̄ = [K H] of the printed forms in some columns, see `states`."""
    return lambda evidence: {key: _largest(evidence.controllers[key].gains[..., columns]) for key in _printed()}


def largest_feedforward_gain(evidence: Evidence) -> dict[str, float]:
    """Return the largest entry of L of the printed forms, and with that of the consistent form."""
    return {key: _largest(evidence.controllers[key].feedforward_gains) for key in (*_printed(), SWAPPED)}


def gamma_with_other_L(evidence: Evidence) -> dict[str, float]:
    """Return the smallest γ at which Theorem 2 proves the printed form, 4 rules, with another L; see `Evidence`."""
    return dict(evidence.gamma_with)


def decay_rate(evidence: Evidence) -> dict[str, float]:
    """Return α [1/s]; it is proven, since `load_policy` refuses controllers that are not."""
    keys = [key_of(form, rules) for form in FORMS for rules in RULES]
    return {key: evidence.controllers[key].alpha for key in keys}


def weight(evidence: Evidence) -> dict[str, float]:
    """Return the diagonal of Q; NaN for an entry in which the two printed forms differ."""
    first, second = (evidence.controllers[key].weight for key in _printed())
    assert first is not None and second is not None  # every controller of the printed form has a Q
    return {
        f"Q{number}{number}": float(a) if a == b else float("nan")
        for number, (a, b) in enumerate(zip(first, second, strict=True), start=1)
    }


def printed_size(entry: str) -> Measure:
    """Return the measure of N_var or N_row by the formula of Remark 4; `entry` is a field of `Size`."""
    return _sizes(lambda model: paper_formula(len(model.A_vertices), len(model.E_vertices)), entry)


def true_size(entry: str) -> Measure:
    """Return the measure of the true size of the printed theorem without integral action: 1 for 32 rules, else 2."""
    return _sizes(
        lambda model: full_size(tracking_vertices(model, False, np.array(PAPER_WEIGHT), common_multiplier=True)), entry
    )


# Measures of the rollouts ---------------------------------------------------------------------------------------------


def circularity(case: str, side: str, of: Callable[[np.ndarray], float]) -> Measure:
    """Return the measure of the circularity error [mm] of each controller in a case.

    Args:
        case: the case.
        side: "tip" (links) or "motors", as if the joints were rigid.
        of: function from the errors (n,) over time to one number: `smallest`, `largest` or `peak`.
    """
    return _by_controller(case, lambda run: of(1e3 * circularity_of(run, side)))


def circularity_of(run: Rollout, side: str) -> np.ndarray:
    """Return the circularity error (n,) [m] on one side."""
    return run.circularity_error if side == "tip" else run.circularity_error_motor


def peak(values: np.ndarray) -> float:
    """Return the largest absolute value of an array of any shape."""
    return float(np.abs(values).max())


def smallest(values: np.ndarray) -> float:
    """Return the smallest value of an array of any shape."""
    return float(values.min())


def largest(values: np.ndarray) -> float:
    """Return the largest value of an array of any shape."""
    return float(values.max())


def worst_case(side: str) -> Measure:
    """Return the measure of the largest circularity error of Case 2 over that of Case 3."""
    second, third = (circularity(case, side, peak) for case in ("machining", "payload"))
    return lambda evidence: {key: second(evidence)[key] / third(evidence)[key] for key in TITLES}


def rule_difference(evidence: Evidence) -> dict[str, float]:
    """Return the largest difference between the tip circularity errors with 32 and 4 rules [mm].

    It is taken up to the end of the shorter of the two episodes.
    """
    result = {}
    for form in FORMS:
        for number, case in enumerate(PAPER_CASES, start=1):
            many, few = (evidence.rollouts[key_of(form, rules), case].circularity_error for rules in RULES)
            n = min(len(many), len(few))
            result[f"{form} form, Case {number}"] = 1e3 * peak(many[:n] - few[:n])
    return result


def peak_torque(joint: int) -> Measure:
    """Return the measure of the largest |Γ| of a joint in Case 1 [N m]; `joint` counts from 0."""
    return _by_controller("nominal", lambda run: peak(run.torque[:, joint]))


def shortest_episode(evidence: Evidence) -> dict[str, float]:
    """Return the duration of the shortest episode of the three cases [s].

    It is shorter than the reference if an episode left the box (25).
    """
    return {key: min(float(evidence.rollouts[key, case].time[-1]) for case in PAPER_CASES) for key in TITLES}


def feedforward_at_rest(evidence: Evidence) -> dict[str, float]:
    """Return the torque L_hv r of joint 1 at t = 0, where the arm rests on the reference [N m]."""
    return {key: _feedforward(controller, evidence) for key, controller in evidence.controllers.items()}


def _by_controller(case: str, of: Callable[[Rollout], float]) -> Measure:
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
    return tuple(key_of("printed", rules) for rules in RULES)


def _largest(gains: np.ndarray) -> float:
    return float(np.abs(gains).max())


def _instants(evidence: Evidence) -> np.ndarray:
    return np.linspace(0.0, evidence.reference.duration, _INSTANTS)
