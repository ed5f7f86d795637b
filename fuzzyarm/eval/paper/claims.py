"""All numbers of the paper that are compared with ours.

Each claim says where the number stands in the paper, what the paper says, how ours is measured and why the two differ.

One number of the paper as a record: how ours is measured, when the two agree, and how far ours may drift.

Reasons why our numbers differ from the paper's, and other remarks; the numbers in these texts are measured.

Table 2 of the paper, the size of the design problem by number of rules, as data.

The paper's numbers about the reference, the cases, the inequalities and the gains, as data.

The paper's numbers about its three cases, as data: each has a value for every controller in `evidence.TITLES`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

from fuzzyarm.eval.paper import measures as m
from fuzzyarm.eval.paper.measures import Measure
from fuzzyarm.fuzzy_policy.states import INTEGRAL, POSITION, VELOCITY

__all__ = [
    "BISECTED", "CIRCLE", "CIRCLE_FORCE", "CLAIMS", "COMPUTED", "FEASIBILITY", "FORCE_PROFILE", "FREE_L", "GAINS",
    "INTEGRAL_GAIN", "NO_NUMBER", "PEAKS", "ROLLOUTS", "SIMILAR", "SIMULATED", "SIMULATED_MM", "STATEMENTS", "TABLE_2",
    "TRUE_SIZE", "UNBOUNDED", "WORST", "Claim", "Tolerance",
]  # fmt: skip


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
    return {f"{rules} rules": size for rules, size in zip(m.TABLE_2_RULES, sizes, strict=True)}


# Table 2 of the paper, row by row.
TABLE_2: tuple[Claim, ...] = (
    Claim("table-2-variables", "Table 2", "N_var: 5138, 1298, 338, 98", "N_var by the formula of Remark 4", "-",
          _table_2(5138, 1298, 338, 98), m.printed_size("variables")),
    Claim("true-variables", "Table 2", "N_var: 5138, 1298, 338, 98", "scalar variables of the theorem", "-",
          _table_2(5138, 1298, 338, 98), m.true_size("variables"), reason=TRUE_SIZE),
    Claim("table-2-rows", "Table 2", "N_row: 33816, 8728, 2328, 664", "N_row by the formula of Remark 4", "-",
          _table_2(33816, 8728, 2328, 664), m.printed_size("rows")),
    Claim("true-rows", "Table 2", "N_row: 33816, 8728, 2328, 664", "rows of the theorem's inequalities", "-",
          _table_2(33816, 8728, 2328, 664), m.true_size("rows"), reason=TRUE_SIZE),
)  # fmt: skip


# What the paper says of the robot, its model and its controllers.
STATEMENTS: tuple[Claim, ...] = (
    Claim("tip-speed", "6.1.3", "a maximum curvilinear velocity of 1.57 m/s", "largest speed of the reference", "m/s",
          1.57, m.tip_speed, decimals=2, tolerance=COMPUTED),
    Claim("rigid-torque", "6.2, Fig. 7", "the maximal required torques are 228 Nm for joint 1 and 47 Nm for joint 2",
          "largest torque the rigid arm needs along the reference", "N m", {"joint 1": 228.0, "joint 2": 47.0},
          m.rigid_torque,
          reason="Start angle, direction and elbow of the circle are not printed; of 32 combinations in steps of 45 "
          "degrees this is the only one with both numbers.",
          tolerance=COMPUTED),
    Claim("force", "6.2, Fig. 3", "f_e(t) between 138 and 218 N", "range of f_e", "N",
          {"smallest": 138.0, "largest": 218.0}, m.force_range, reason=FORCE_PROFILE, tolerance=COMPUTED),
    Claim("payload-mass", "6.2, Case 3", "must carry a mass of 5 kg", "carried mass", "kg", 5.0, m.payload_mass,
          tolerance=COMPUTED),
    Claim("payload-share", "6.2, Case 3", "a variation of the effector mass m_2 of 55.6 %", "carried mass over m_2",
          "%", 55.6, m.payload_share, decimals=1, tolerance=COMPUTED),
    Claim("decay-rate", "6.2", "alpha = 20", "proven decay rate", "1/s", 20.0, m.decay_rate, tolerance=COMPUTED),
    Claim("weight", "6.2", "Q = diag(1e-5, 1e-5, 1, 1)", "Q of the printed form", "-",
          {"Q11": 1e-5, "Q22": 1e-5, "Q33": 1.0, "Q44": 1.0}, m.weight, decimals=6, tolerance=COMPUTED),
    Claim("feasibility", "6.2", "Theorem 2: feasible solutions only with at least 4 rules",
          "fewest rules with a solution proven", "-", {"fewest rules": 4.0}, m.fewest_rules,
          reason=FEASIBILITY),
    Claim("unbounded-gain", "6.2", "without (24), 4 rules: K of 3.88e9, 7.89e9", "largest entry of K", "N m/rad",
          7.89e9, m.unbounded_gain, comparison="order", reason=UNBOUNDED, tolerance=COMPUTED),
    Claim("gain-bound", "6.2, (24)", "epsilon = 1e4", "largest norm of M_ik", "-", 1e4, m.bounded_M,
          comparison="at most", tolerance=COMPUTED),
    Claim("position-gain", "6.2, K_11", "with (24), 4 rules: K of -6.31e4, -6.513e4", "largest position gain",
          "N m/rad", 6.513e4, m.largest_gain(POSITION), comparison="order", reason=GAINS, tolerance=COMPUTED),
    Claim("velocity-gain", "6.2, K_11", "-978, -591", "largest velocity gain", "N m s/rad", 978.0,
          m.largest_gain(VELOCITY), comparison="order", reason=GAINS, tolerance=COMPUTED),
    Claim("integral-gain", "6.2, H_11", "7200, 4.62e4", "largest integral gain", "N m/(rad s)", 4.62e4,
          m.largest_gain(INTEGRAL), comparison="order", reason=INTEGRAL_GAIN, tolerance=COMPUTED),
    Claim("feedforward-gain", "6.2, L_11", "14.7, 15.2", "largest entry of L", "N m/rad", 15.2,
          m.largest_feedforward_gain, comparison="order", reason=FREE_L, tolerance=COMPUTED),
    Claim("gamma-of-L", "6.2, L_11", "gamma is not printed",
          "smallest gamma at which the printed form's file, 4 rules, is proven with", "-", None, m.gamma_with_other_L,
          reason=FREE_L, tolerance=BISECTED),
    Claim("similar", "6.2, Figs. 4-6", "32 and 4 rules behave similarly in all three cases",
          "largest difference of their circularity errors at the tip", "mm", None, m.rule_difference,
          reason=SIMILAR, tolerance=SIMULATED_MM),
)  # fmt: skip


_ENDS = {
    "largest": ("largest size", m.peak),
    "inmost": ("inmost", m.smallest),
    "outmost": ("outmost", m.largest),
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
                  m.circularity(case, side, measure), decimals=1, reason=reason, tolerance=SIMULATED_MM)
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
              f"largest circularity error, {side}, Case 2 over Case 3", "-", 1.0, m.worst_case(side),
              comparison="more than", reason=WORST, tolerance=SIMULATED)
        for side in ("tip", "motors")
    ),
    *(
        Claim(f"peak-torque-{joint}", "6.2, Fig. 7",
              "the maximal required torques are 228 Nm for joint 1 and 47 Nm for joint 2",
              f"largest torque of joint {joint}, Case 1", "N m", paper, m.peak_torque(joint - 1), reason=PEAKS,
              tolerance=SIMULATED)
        for joint, paper in ((1, 228.0), (2, 47.0))
    ),
    Claim("end", "6.1.3", "executed in a duration of 1.5 s", "end of the shortest episode of the three cases", "s", 1.5,
          m.shortest_episode, decimals=1, tolerance=SIMULATED),
    Claim("feedforward-at-rest", "6.2, L_11", "no number", "torque of joint 1 that L asks for at t = 0", "N m", None,
          m.feedforward_at_rest, reason=FREE_L, tolerance=COMPUTED),
)  # fmt: skip


CLAIMS = (*STATEMENTS, *TABLE_2, *ROLLOUTS)
"""All claims of the paper, in the order of the report."""
