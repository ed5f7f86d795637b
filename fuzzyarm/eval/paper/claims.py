"""All numbers of the paper that are compared with ours.

``claims.json`` holds what the paper says, the tolerances within which ours may drift, and why both differ; the numbers
in these reasons are measured. Its groups are ``statements`` (the reference, the cases, the inequalities and the gains),
``table_2`` (the size of the design problem by number of rules) and ``rollouts`` (the three cases). The measures of the
claims are the functions of this module: they return values by label, the key of a controller in `evidence.TITLES` or a
few words; those of rollouts have a value for every controller.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from importlib import resources
from typing import Any, Literal, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.friction import DryFriction, stribeck_magnitude
from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES
from fuzzyarm.envs.scenario.disturbances import MachiningForce
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.paper.evidence import FORMS, HIGH_GAIN, RULES, SWAPPED, TITLES, WITNESSES, Evidence, key_of
from fuzzyarm.fuzzy_policy import states
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.proof.vertices import tracking_vertices
from fuzzyarm.synthesis.complexity import Size, full_size, paper_formula
from fuzzyarm.synthesis.specification import PAPER_WEIGHT

__all__ = ["CLAIMS", "ROLLOUTS", "STATEMENTS", "TABLE_2", "Claim", "Tolerance", "circularity_of"]

_INSTANTS = 3001  # evenly spaced along the reference; one of them is the middle, where the reference is fastest
_PRINTED = tuple(key_of("printed", rules) for rules in RULES)


def _peak(values: np.ndarray) -> float:
    return float(np.abs(values).max())


def _instants(evidence: Evidence) -> np.ndarray:
    return np.linspace(0.0, evidence.reference.duration, _INSTANTS)


# Measures of the reference and of the cases.


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
    """Return the smallest and the largest f_e [N] over the motion, at a tip speed of 1 m/s, where it is not faded."""
    force = CASES["machining"].disturbance.tip_force or MachiningForce()
    time = _instants(evidence)
    size = np.linalg.norm(force.at(time, np.tile([1.0, 0.0], (len(time), 1))), axis=-1)
    return {"smallest": float(size.min()), "largest": float(size.max())}


def payload(evidence: Evidence, label: str) -> dict[str, float]:
    """Return the carried mass of Case 3, in kg with the label "payload", else in per cent of m_2."""
    mass = CASES["payload"].disturbance.payload.mass
    share = 100.0 * mass / evidence.reference.parameters.mass[1]
    return {"payload": mass} if label == "payload" else {"of m_2": share}


# Measures of the inequalities and of their solutions.


def fewest_rules(evidence: Evidence) -> dict[str, float]:
    """Return the smallest number of rules for which a solution of Theorem 2 is proven (0: none), and how many are."""
    proven = [evidence.witnesses[name].model.rules for name in WITNESSES if name in evidence.proven]
    return {"fewest rules": min(proven, default=0), f"proven of {len(WITNESSES)} witnesses": len(proven)}


def unbounded_gain(evidence: Evidence) -> dict[str, float]:
    """Return the largest entry of K of the design without the bound (24); 0 if its file is not proven."""
    proven = HIGH_GAIN in evidence.proven
    return {"4 rules": _peak(evidence.witnesses[HIGH_GAIN].gains[..., states.PLANT]) if proven else 0.0}


def bounded_M(evidence: Evidence) -> dict[str, float]:
    """Return the largest |M_ik|, M_ik = [K_ik H_ik] P11, the left side of (24)."""
    result = {}
    for key in _PRINTED:
        gains, P = evidence.controllers[key].gains, evidence.controllers[key].P
        products = gains @ P[: gains.shape[-1], : gains.shape[-1]]
        result[key] = float(np.linalg.norm(products, ord=2, axis=(-2, -1)).max())
    return result


def largest_gain(evidence: Evidence, columns: str) -> dict[str, float]:
    """Return the largest entry of K̄ = [K H] of the printed forms in the columns of that name in `states`."""
    return {key: _peak(evidence.controllers[key].gains[..., getattr(states, columns)]) for key in _PRINTED}


def largest_feedforward_gain(evidence: Evidence) -> dict[str, float]:
    """Return the largest entry of L of the printed forms, and with that of the consistent form."""
    return {key: _peak(evidence.controllers[key].feedforward_gains) for key in (*_PRINTED, SWAPPED)}


def gamma_with(evidence: Evidence) -> Mapping[str, float]:
    """Return `Evidence.gamma_with` [1]."""
    return evidence.gamma_with


def decay_rate(evidence: Evidence) -> dict[str, float]:
    """Return α [1/s]; it is proven, since `load_policy` refuses controllers that are not."""
    return {(key := key_of(form, rules)): evidence.controllers[key].alpha for form in FORMS for rules in RULES}


def weight(evidence: Evidence) -> dict[str, float]:
    """Return the diagonal of Q; NaN for an entry in which the two printed forms differ."""
    first, second = (evidence.controllers[key].weight for key in _PRINTED)
    assert first is not None and second is not None  # every controller of the printed form has a Q
    return {
        f"Q{number}{number}": float(a) if a == b else float("nan")
        for number, (a, b) in enumerate(zip(first, second, strict=True), start=1)
    }


def size(evidence: Evidence, entry: str, of: str) -> dict[str, float]:
    """Return N_var or N_row, a field of `Size`, for 32, 16, 8 and 4 rules.

    It is `of` the formula of Remark 4, or of the printed theorem without integral action: 1 for 32 rules, else 2.
    """
    sizes: dict[str, Size] = {}
    for rules in (32, 16, 8, 4):
        model = TSModel(evidence.reference.parameters, NAMED_RULES[rules])
        if of == "formula":
            sizes[f"{rules} rules"] = paper_formula(len(model.A_vertices), len(model.E_vertices))
        else:
            vertices = tracking_vertices(model, False, np.array(PAPER_WEIGHT), common_multiplier=True)
            sizes[f"{rules} rules"] = full_size(vertices)
    return {label: getattr(one, entry) for label, one in sizes.items()}


# Measures of the rollouts.


def circularity(evidence: Evidence, case: str, side: str, end: str) -> dict[str, float]:
    """Return the ``inmost``, ``outmost`` or ``largest`` circularity error [mm] of each controller in a case."""
    ends: Mapping[str, Any] = {"inmost": np.min, "outmost": np.max, "largest": _peak}
    return {key: float(ends[end](1e3 * circularity_of(evidence.rollouts[key, case], side))) for key in TITLES}


def circularity_of(run: Rollout, side: str) -> np.ndarray:
    """Return the circularity error (n,) [m] on a side: "tip" (links) or "motors", as if the joints were rigid."""
    return run.circularity_error if side == "tip" else run.circularity_error_motor


def worst_case(evidence: Evidence, side: str) -> dict[str, float]:
    """Return the largest circularity error of Case 2 over that of Case 3."""
    second, third = (circularity(evidence, case, side, "largest") for case in ("machining", "payload"))
    return {key: second[key] / third[key] for key in TITLES}


def rule_difference(evidence: Evidence) -> dict[str, float]:
    """Return the largest difference of tip circularity errors with 32 and 4 rules [mm], while both episodes last."""
    result = {}
    for form in FORMS:
        for number, case in enumerate(PAPER_CASES, start=1):
            many, few = (evidence.rollouts[key_of(form, rules), case].circularity_error for rules in RULES)
            n = min(len(many), len(few))
            result[f"{form} form, Case {number}"] = 1e3 * _peak(many[:n] - few[:n])
    return result


def peak_torque(evidence: Evidence, joint: str) -> dict[str, float]:
    """Return the largest |Γ| of a joint, counted from 1, in Case 1 [N m]."""
    return {key: _peak(evidence.rollouts[key, "nominal"].torque[:, int(joint) - 1]) for key in TITLES}


def shortest_episode(evidence: Evidence) -> dict[str, float]:
    """Return the duration [s] of the shortest episode of the three cases; shorter than the reference: it left (25)."""
    return {key: min(float(evidence.rollouts[key, case].time[-1]) for case in PAPER_CASES) for key in TITLES}


def feedforward_at_rest(evidence: Evidence) -> dict[str, float]:
    """Return the torque L_hv r of joint 1 at t = 0, where the arm rests on the reference [N m]."""
    motion = evidence.reference.sample(0.0)
    at_rest = np.concatenate([motion.q, motion.dq, *motion])[np.newaxis]
    torques = {}
    for key, controller in evidence.controllers.items():
        policy, torque = FuzzyPolicy(controller), np.zeros((1, 2))
        policy.act(at_rest, np.zeros((1, policy.memory_size)), torque)
        torques[key] = float(torque[0, 0])
    return torques


class Tolerance(NamedTuple):
    """How far a number may differ from its stored value: relative * |stored| + absolute [the claim's unit].

    Numbers without simulation are equal on all machines up to rounding: 1e-9. Simulated ones are reproducible on one
    machine: if the gains change by a relative 1e-6, the most sensitive, that of the episode that leaves the box,
    changes by a relative 1e-4 and most others by less than 1e-5; so 1e-3, and of lengths a micrometre besides. The
    bisection of γ stops at 1 %: 0.02.
    """

    relative: float = 0.0
    absolute: float = 0.0

    def of(self, stored: float) -> float:
        """Return the largest allowed difference from a stored value."""
        return self.relative * abs(stored) + self.absolute


@dataclasses.dataclass(frozen=True)
class Claim:
    """A number of the paper, or several numbers of one kind.

    Attributes:
        key: name of the claim in the files.
        where: section, figure or table of the paper.
        says: what the paper says there.
        quantity: what is measured.
        unit: of the paper's and of our numbers; "-" for none.
        paper: the paper's number: one for all our values, or one for each label. None, or a label that is missing: the
            paper gives no number.
        measure: function from the evidence to our values by label.
        comparison: the relation to the paper's number in which ours agrees: "equal" in all printed digits, of the same
            "order" (within a factor of ten), "at most" or "more than".
        decimals: number of digits the paper prints after the decimal point.
        reason: why ours differs, or another remark; may be empty.
        tolerance: how far ours may drift from the stored value.
    """

    key: str
    where: str
    says: str
    quantity: str
    unit: str
    paper: float | Mapping[str, float] | None
    measure: Callable[[Evidence], Mapping[str, float]]
    comparison: Literal["equal", "order", "at most", "more than"] = "equal"
    decimals: int = 0
    reason: str = ""
    tolerance: Tolerance = Tolerance()

    def papers_number(self, label: str) -> float | None:
        """Return the paper's number for our value `label`; None if it gives none."""
        return self.paper.get(label) if isinstance(self.paper, Mapping) else self.paper

    def agrees(self, label: str, value: float) -> bool | None:
        """Return whether our value agrees with the paper's, see `comparison`; None if the paper gives no number."""
        paper = self.papers_number(label)
        if paper is None:
            return None
        if self.comparison == "order":
            return value > 0.0 and abs(math.log10(value / paper)) < 1.0
        if self.comparison == "equal":
            return abs(value - paper) <= 0.5 * 10.0**-self.decimals
        return value <= paper if self.comparison == "at most" else value > paper


_FILE: dict[str, Any] = json.loads(resources.files(__package__).joinpath("claims.json").read_text(encoding="utf-8"))


def _claim(entry: dict[str, Any]) -> Claim:
    """Return a claim of the file; its measure is the name of a function above and further arguments."""
    name, *arguments = entry["measure"].split()
    return Claim(
        **entry
        | {
            "measure": lambda evidence: globals()[name](evidence, *arguments),
            "reason": _FILE["reasons"].get(entry.get("reason"), ""),
            "tolerance": Tolerance(*entry.get("tolerance", ())),
        }
    )


# The groups of the file.
STATEMENTS, TABLE_2, ROLLOUTS = (tuple(map(_claim, _FILE[group])) for group in ("statements", "table_2", "rollouts"))
CLAIMS = (*STATEMENTS, *TABLE_2, *ROLLOUTS)
"""All claims of the paper, in the order of the report."""
