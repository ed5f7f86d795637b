"""All numbers of the paper that are compared with ours.

Each claim says where the number stands in the paper, what the paper says, how ours is measured and why the two differ.

A `Claim` is one such number, with the tolerance within which ours may drift. The numbers in the texts of the reasons
are measured. A measure returns values by label: the key of a controller in `evidence.TITLES`, or a few words. `TABLE_2`
is the size of the design problem by number of rules; `STATEMENTS` are the numbers about the reference, the cases, the
inequalities and the gains; `ROLLOUTS` those about the three cases, with a value for every controller in
`evidence.TITLES`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.friction import DryFriction, stribeck_magnitude
from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES
from fuzzyarm.envs.scenario.disturbances import MachiningForce
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.paper.evidence import FORMS, HIGH_GAIN, RULES, SWAPPED, TITLES, WITNESSES, Evidence, key_of
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.states import INTEGRAL, PLANT, POSITION, VELOCITY
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.proof.vertices import tracking_vertices
from fuzzyarm.synthesis.complexity import Size, full_size, paper_formula
from fuzzyarm.synthesis.specification import PAPER_WEIGHT

__all__ = ["CLAIMS", "ROLLOUTS", "STATEMENTS", "TABLE_2", "Claim", "Measure", "Tolerance", "circularity_of"]

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


def payload_share(evidence: Evidence) -> dict[str, float]:
    """Return the carried mass of Case 3 in per cent of m_2."""
    return {"of m_2": 100.0 * CASES["payload"].disturbance.payload.mass / evidence.reference.parameters.mass[1]}


# Measures of the inequalities and of their solutions ------------------------------------------------------------------


def fewest_rules(evidence: Evidence) -> dict[str, float]:
    """Return the smallest number of rules for which a solution of Theorem 2 is proven (0: none), and how many are."""
    proven = [evidence.witnesses[name].model.rules for name in WITNESSES if name in evidence.proven]
    return {"fewest rules": min(proven, default=0), f"proven of {len(WITNESSES)} witnesses": len(proven)}


def unbounded_gain(evidence: Evidence) -> dict[str, float]:
    """Return the largest entry of K of the design without the bound (24); 0 if its file is not proven."""
    proven = HIGH_GAIN in evidence.proven
    return {"4 rules": peak(evidence.witnesses[HIGH_GAIN].gains[..., PLANT]) if proven else 0.0}


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
    return lambda evidence: {key: peak(evidence.controllers[key].gains[..., columns]) for key in _printed()}


def largest_feedforward_gain(evidence: Evidence) -> dict[str, float]:
    """Return the largest entry of L of the printed forms, and with that of the consistent form."""
    return {key: peak(evidence.controllers[key].feedforward_gains) for key in (*_printed(), SWAPPED)}


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


def circularity(case: str, side: str, of: Callable[[np.ndarray], Any]) -> Measure:
    """Return the measure of one number `of` the circularity errors (n,) over time [mm] of each controller in a case."""
    return _by_controller(case, lambda run: float(of(1e3 * circularity_of(run, side))))


def circularity_of(run: Rollout, side: str) -> np.ndarray:
    """Return the circularity error (n,) [m] on a side: "tip" (links) or "motors", as if the joints were rigid."""
    return run.circularity_error if side == "tip" else run.circularity_error_motor


def peak(values: np.ndarray) -> float:
    """Return the largest absolute value of an array of any shape."""
    return float(np.abs(values).max())


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
    motion = evidence.reference.sample(0.0)
    at_rest = np.concatenate([motion.q, motion.dq, *motion])[np.newaxis]
    torques = {}
    for key, controller in evidence.controllers.items():
        policy, torque = FuzzyPolicy(controller), np.zeros((1, 2))
        policy.act(at_rest, np.zeros((1, policy.memory_size)), torque)
        torques[key] = float(torque[0, 0])
    return torques


def _by_controller(case: str, of: Callable[[Rollout], float]) -> Measure:
    return lambda evidence: {key: of(evidence.rollouts[key, case]) for key in TITLES}


def _sizes(size: Callable[[TSModel], Size], entry: str) -> Measure:
    def measure(evidence: Evidence) -> dict[str, float]:
        parameters = evidence.reference.parameters
        return {f"{n} rules": getattr(size(TSModel(parameters, NAMED_RULES[n])), entry) for n in TABLE_2_RULES}

    return measure


def _printed() -> tuple[str, ...]:
    return tuple(key_of("printed", rules) for rules in RULES)


def _instants(evidence: Evidence) -> np.ndarray:
    return np.linspace(0.0, evidence.reference.duration, _INSTANTS)


# The claims ----------------------------------------------------------------------------------------------------------


class Tolerance(NamedTuple):
    """How far a number may differ from its stored value: relative * |stored| + absolute [the claim's unit]."""

    relative: float = 0.0
    absolute: float = 0.0

    def of(self, stored: float) -> float:
        """Return the largest allowed difference from a stored value."""
        return self.relative * abs(stored) + self.absolute


# Computed without simulation: equal on all machines up to rounding.
COMPUTED = Tolerance(relative=1e-9)
# Simulated: reproducible on one machine. If the gains change by a relative 1e-6, the most sensitive value, that of the
# episode that leaves the box, changes by a relative 1e-4; most others change by less than 1e-5.
SIMULATED = Tolerance(relative=1e-3)
BISECTED = Tolerance(relative=0.02)  # the bisection stops at 1 %
SIMULATED_MM = Tolerance(relative=1e-3, absolute=1e-3)  # of lengths in mm: a micrometre is allowed besides


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
        tolerance: how far ours may drift from the stored value, see `drift`.
    """

    key: str
    where: str
    says: str
    quantity: str
    unit: str
    paper: float | Mapping[str, float] | None
    measure: Measure
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


FORCE_PROFILE = (
    "The paper prints the range, not the course over time. Ours is our choice: half a sine over the movement, faded "
    "below 0.01 m/s."
)
FEASIBILITY = (
    "Ours are proofs, not solver results: files with strictly feasible points of Theorem 2 for 4, 2 and 1 rules, with "
    "and without integral, with one multiplier as printed and with several, at the paper's alpha and Q and within "
    "(24); gamma is 1000, the paper prints none. They are easily missed: without scaling, the solver ends in "
    "numerical errors. We do not know why the authors found none."
)
UNBOUNDED = (
    "Nothing in the inequalities limits the gains: from a solution with z1 kept, gains of any size follow in closed "
    "form. Ours is one such file, proven, and its size is our choice. The paper's value is probably where its solver "
    "stopped."
)
GAINS = (
    "The inequalities and (24) leave a set of gains; the paper says neither which objective chose its own nor gamma. "
    "Ours has the smallest bound on gains scaled to the arm's units. It is compared with the largest of the entries "
    "that the paper prints, those with i = 1."
)
INTEGRAL_GAIN = (
    f"{GAINS} Its K and H have opposite signs, ours, with x_I the integral of C_p e, the same sign, which the loop "
    "needs to be stable."
)
FREE_L = (
    "Theorems 1 and 2 treat r and x_r as independent signals, so nothing makes their L follow the movement. Left to "
    "the solver it asks for thousands of N m of an arm at rest, where gravity needs 79, and throws the arm "
    "centimetres off the circle. But at the same alpha and gamma every share from 0 to 1 of the consistent form's L "
    "is proven too, with a bound on the gains that differs by less than 0.3 %, and so is the L that the paper prints "
    "(gamma-of-L), which is next to nothing: its rows go as 3844 : 124 : 1, 0.0038 times those of B_r. The printed "
    "form here has the smallest, L = 0: the feedback alone holds the arm, gravity included."
)
CIRCLE = (
    "The paper does not say on which side of the joints. At the motors the printed form errs by 0.8 mm with 32 rules "
    "and 2.1 mm with 4, so 1.3 mm lies between them; with the consistent form's L it is 0.4 mm. At the tip the "
    "joints' bending, which a law on motor angles cannot measure, makes all of them 2.5 to 3 mm. The paper's own "
    "gains give neither here, but only those with i = 1 are printed, and are used for i = 2 as well."
)
CIRCLE_FORCE = (
    "The side is not stated, and the force's course over time is our choice. The motors stay within 3.1 mm of the "
    "circle in either form; the tip goes about as far inwards as the paper's radius and one to two and a half "
    "millimetres farther outwards."
)
NO_NUMBER = "The paper gives a figure and no number."
WORST = (
    "In the printed form Case 2 is the worst on both sides, as in the paper, in the consistent form only at the "
    "motors: at the tip its Cases 2 and 3 are alike. The payload is read as a point mass at the tip, the harder "
    "reading, and acts from t = 0."
)
SIMILAR = (
    "In the consistent form 32 and 4 rules are within half a millimetre of each other in every case, in the printed "
    "form, whose feedback alone carries the arm, within two and a half."
)
PEAKS = (
    "The consistent form needs what the movement needs, see rigid-torque. The printed form needs up to 1.5 % more, "
    "and with 4 rules 10 % more of joint 2."
)
TRUE_SIZE = (
    "The paper's formula is reproduced exactly, but it does not count the variables and rows of its theorem. This "
    "does, for Theorem 2 (32 rules: Theorem 1) without integral, one multiplier for all dropped premises of A, gamma "
    "free."
)


def _table_2(*sizes: int) -> dict[str, float]:
    return {f"{rules} rules": size for rules, size in zip(TABLE_2_RULES, sizes, strict=True)}


# Table 2 of the paper, row by row.
TABLE_2: tuple[Claim, ...] = (
    Claim("table-2-variables", "Table 2", "N_var: 5138, 1298, 338, 98", "N_var by the formula of Remark 4", "-",
          _table_2(5138, 1298, 338, 98), printed_size("variables")),
    Claim("true-variables", "Table 2", "N_var: 5138, 1298, 338, 98", "scalar variables of the theorem", "-",
          _table_2(5138, 1298, 338, 98), true_size("variables"), reason=TRUE_SIZE),
    Claim("table-2-rows", "Table 2", "N_row: 33816, 8728, 2328, 664", "N_row by the formula of Remark 4", "-",
          _table_2(33816, 8728, 2328, 664), printed_size("rows")),
    Claim("true-rows", "Table 2", "N_row: 33816, 8728, 2328, 664", "rows of the theorem's inequalities", "-",
          _table_2(33816, 8728, 2328, 664), true_size("rows"), reason=TRUE_SIZE),
)  # fmt: skip


# What the paper says of the robot, its model and its controllers.
STATEMENTS: tuple[Claim, ...] = (
    Claim("tip-speed", "6.1.3", "a maximum curvilinear velocity of 1.57 m/s", "largest speed of the reference", "m/s",
          1.57, tip_speed, decimals=2, tolerance=COMPUTED),
    Claim("rigid-torque", "6.2, Fig. 7", "the maximal required torques are 228 Nm for joint 1 and 47 Nm for joint 2",
          "largest torque the rigid arm needs along the reference", "N m", {"joint 1": 228.0, "joint 2": 47.0},
          rigid_torque,
          reason="Start angle, direction and elbow of the circle are not printed; of 32 combinations in steps of 45 "
          "degrees this is the only one with both numbers.",
          tolerance=COMPUTED),
    Claim("force", "6.2, Fig. 3", "f_e(t) between 138 and 218 N", "range of f_e", "N",
          {"smallest": 138.0, "largest": 218.0}, force_range, reason=FORCE_PROFILE, tolerance=COMPUTED),
    Claim("payload-mass", "6.2, Case 3", "must carry a mass of 5 kg", "carried mass", "kg", 5.0,
          lambda _: {"payload": CASES["payload"].disturbance.payload.mass},
          tolerance=COMPUTED),
    Claim("payload-share", "6.2, Case 3", "a variation of the effector mass m_2 of 55.6 %", "carried mass over m_2",
          "%", 55.6, payload_share, decimals=1, tolerance=COMPUTED),
    Claim("decay-rate", "6.2", "alpha = 20", "proven decay rate", "1/s", 20.0, decay_rate, tolerance=COMPUTED),
    Claim("weight", "6.2", "Q = diag(1e-5, 1e-5, 1, 1)", "Q of the printed form", "-",
          {"Q11": 1e-5, "Q22": 1e-5, "Q33": 1.0, "Q44": 1.0}, weight, decimals=6, tolerance=COMPUTED),
    Claim("feasibility", "6.2", "Theorem 2: feasible solutions only with at least 4 rules",
          "fewest rules with a solution proven", "-", {"fewest rules": 4.0}, fewest_rules,
          reason=FEASIBILITY),
    Claim("unbounded-gain", "6.2", "without (24), 4 rules: K of 3.88e9, 7.89e9", "largest entry of K", "N m/rad",
          7.89e9, unbounded_gain, comparison="order", reason=UNBOUNDED, tolerance=COMPUTED),
    Claim("gain-bound", "6.2, (24)", "epsilon = 1e4", "largest norm of M_ik", "-", 1e4, bounded_M,
          comparison="at most", tolerance=COMPUTED),
    Claim("position-gain", "6.2, K_11", "with (24), 4 rules: K of -6.31e4, -6.513e4", "largest position gain",
          "N m/rad", 6.513e4, largest_gain(POSITION), comparison="order", reason=GAINS, tolerance=COMPUTED),
    Claim("velocity-gain", "6.2, K_11", "-978, -591", "largest velocity gain", "N m s/rad", 978.0,
          largest_gain(VELOCITY), comparison="order", reason=GAINS, tolerance=COMPUTED),
    Claim("integral-gain", "6.2, H_11", "7200, 4.62e4", "largest integral gain", "N m/(rad s)", 4.62e4,
          largest_gain(INTEGRAL), comparison="order", reason=INTEGRAL_GAIN, tolerance=COMPUTED),
    Claim("feedforward-gain", "6.2, L_11", "14.7, 15.2", "largest entry of L", "N m/rad", 15.2,
          largest_feedforward_gain, comparison="order", reason=FREE_L, tolerance=COMPUTED),
    Claim("gamma-of-L", "6.2, L_11", "gamma is not printed",
          "smallest gamma at which the printed form's file, 4 rules, is proven with", "-", None,
          lambda evidence: evidence.gamma_with, reason=FREE_L, tolerance=BISECTED),
    Claim("similar", "6.2, Figs. 4-6", "32 and 4 rules behave similarly in all three cases",
          "largest difference of their circularity errors at the tip", "mm", None, rule_difference,
          reason=SIMILAR, tolerance=SIMULATED_MM),
)  # fmt: skip


_ENDS: Mapping[str, tuple[str, Callable[[np.ndarray], Any]]] = {
    "largest": ("largest size", peak),
    "inmost": ("inmost", np.min),
    "outmost": ("outmost", np.max),
}
"""What is read from a circularity error over time: name in the claim's key, name in its quantity, and the function."""


def _circularity(
    number: int, case: str, side: str, says: str, papers: Mapping[str, float | None], reason: str
) -> list[Claim]:
    """Return the claims about the circularity error of a case on one side, one for each key of `papers` in `_ENDS`."""
    claims = []
    for end, paper in papers.items():
        quantity, measure = _ENDS[end]
        claims.append(
            Claim(f"case-{number}-{end}-{side}", f"6.2, Fig. {number + 3}", says,
                  f"circularity error, Case {number}, {side}, {quantity}", "mm", paper,
                  circularity(case, side, measure), decimals=1, reason=reason, tolerance=SIMULATED_MM)
        )  # fmt: skip
    return claims


_ABOUT = "maximal deviation about 1.3 mm for the two controllers"
_BETWEEN = "the trajectory radius evolves between -2.3 and 4.4 mm"

# What the paper says of its simulations.
ROLLOUTS: tuple[Claim, ...] = (
    *_circularity(1, "nominal", "tip", _ABOUT, {"largest": 1.3}, CIRCLE),
    *_circularity(1, "nominal", "motors", _ABOUT, {"largest": 1.3}, CIRCLE),
    *_circularity(2, "machining", "tip", _BETWEEN, {"inmost": -2.3, "outmost": 4.4}, CIRCLE_FORCE),
    *_circularity(2, "machining", "motors", _BETWEEN, {"inmost": -2.3, "outmost": 4.4}, CIRCLE_FORCE),
    *_circularity(3, "payload", "tip", "a figure", {"inmost": None, "outmost": None}, NO_NUMBER),
    *_circularity(3, "payload", "motors", "a figure", {"inmost": None, "outmost": None}, NO_NUMBER),
    *(
        Claim(f"worst-case-{side}", "6.2", "the worst one being Case 2",
              f"largest circularity error, {side}, Case 2 over Case 3", "-", 1.0, worst_case(side),
              comparison="more than", reason=WORST, tolerance=SIMULATED)
        for side in ("tip", "motors")
    ),
    *(
        Claim(f"peak-torque-{joint}", "6.2, Fig. 7",
              "the maximal required torques are 228 Nm for joint 1 and 47 Nm for joint 2",
              f"largest torque of joint {joint}, Case 1", "N m", paper, peak_torque(joint - 1), reason=PEAKS,
              tolerance=SIMULATED)
        for joint, paper in ((1, 228.0), (2, 47.0))
    ),
    Claim("end", "6.1.3", "executed in a duration of 1.5 s", "end of the shortest episode of the three cases", "s", 1.5,
          shortest_episode, decimals=1, tolerance=SIMULATED),
    Claim("feedforward-at-rest", "6.2, L_11", "no number", "torque of joint 1 that L asks for at t = 0", "N m", None,
          feedforward_at_rest, reason=FREE_L, tolerance=COMPUTED),
)  # fmt: skip


CLAIMS = (*STATEMENTS, *TABLE_2, *ROLLOUTS)
"""All claims of the paper, in the order of the report."""
