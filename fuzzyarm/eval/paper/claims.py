"""The paper's numbers as data: where each stands, what it says, how ours is measured, why they differ.

`STATEMENTS` are about the reference, the cases and the inequalities, `TABLE_2` are its rows; `ROLLOUTS` have one number
of each controller of `controllers.TITLES`.
"""

from __future__ import annotations

from collections.abc import Mapping

from fuzzyarm.eval.paper import measures as m
from fuzzyarm.eval.paper import reasons
from fuzzyarm.eval.paper.claim import Claim, Tolerance

# Computed, not simulated: the same on every machine but for rounding.
COMPUTED = Tolerance(relative=1e-9)
# Simulated: the same on one machine. Gains changed by 1e-6 of themselves move the most sensitive value, of the episode
# that leaves the box, by 1e-4 of itself, most others by less than 1e-5.
SIMULATED = Tolerance(relative=1e-3)
BISECTED = Tolerance(relative=0.02)  # to 1 %
SIMULATED_MM = Tolerance(relative=1e-3, absolute=1e-3)  # and a micrometre


def _table_2(*sizes: int) -> dict[str, float]:
    return {f"{rules} rules": size for rules, size in zip(m.TABLE_2_RULES, sizes, strict=True)}


STATEMENTS: tuple[Claim, ...] = (
    Claim(
        key="tip-speed",
        where="6.1.3",
        says="a maximum curvilinear velocity of 1.57 m/s",
        quantity="largest speed of the reference",
        unit="m/s",
        paper=1.57,
        decimals=2,
        measure=m.tip_speed,
        tolerance=COMPUTED,
    ),
    Claim(
        key="rigid-torque",
        where="6.2, Fig. 7",
        says="the maximal required torques are 228 Nm for joint 1 and 47 Nm for joint 2",
        quantity="largest torque the rigid arm needs along the reference",
        unit="N m",
        paper={"joint 1": 228.0, "joint 2": 47.0},
        measure=m.rigid_torque,
        reason="Start angle, direction and elbow of the circle are not printed; of 32 combinations in steps of 45 "
        "degrees this is the only one with both numbers.",
        tolerance=COMPUTED,
    ),
    Claim(
        key="force",
        where="6.2, Fig. 3",
        says="f_e(t) between 138 and 218 N",
        quantity="range of f_e",
        unit="N",
        paper={"smallest": 138.0, "largest": 218.0},
        measure=m.force_range,
        reason=reasons.FORCE_PROFILE,
        tolerance=COMPUTED,
    ),
    Claim(
        key="payload-mass",
        where="6.2, Case 3",
        says="must carry a mass of 5 kg",
        quantity="carried mass",
        unit="kg",
        paper=5.0,
        measure=m.payload_mass,
        tolerance=COMPUTED,
    ),
    Claim(
        key="payload-share",
        where="6.2, Case 3",
        says="a variation of the effector mass m_2 of 55.6 %",
        quantity="carried mass over m_2",
        unit="%",
        paper=55.6,
        decimals=1,
        measure=m.payload_share,
        tolerance=COMPUTED,
    ),
    Claim(
        key="decay-rate",
        where="6.2",
        says="alpha = 20",
        quantity="proven decay rate",
        unit="1/s",
        paper=20.0,
        measure=m.decay_rate,
        tolerance=COMPUTED,
    ),
    Claim(
        key="weight",
        where="6.2",
        says="Q = diag(1e-5, 1e-5, 1, 1)",
        quantity="Q of the printed form",
        unit="-",
        paper={"Q11": 1e-5, "Q22": 1e-5, "Q33": 1.0, "Q44": 1.0},
        decimals=6,
        measure=m.weight,
        tolerance=COMPUTED,
    ),
    Claim(
        key="feasibility",
        where="6.2",
        says="Theorem 2: feasible solutions only with at least 4 rules",
        quantity="fewest rules with a solution proven",
        unit="-",
        paper={"fewest rules": 4.0},
        measure=m.fewest_rules,
        reason=reasons.FEASIBILITY,
    ),
    Claim(
        key="unbounded-gain",
        where="6.2",
        says="without (24), 4 rules: K of 3.88e9, 7.89e9",
        quantity="largest entry of K",
        unit="N m/rad",
        paper=7.89e9,
        comparison="order",
        measure=m.unbounded_gain,
        reason=reasons.UNBOUNDED,
        tolerance=COMPUTED,
    ),
    Claim(
        key="gain-bound",
        where="6.2, (24)",
        says="epsilon = 1e4",
        quantity="largest norm of M_ik",
        unit="-",
        paper=1e4,
        comparison="at most",
        measure=m.bounded_M,
        tolerance=COMPUTED,
    ),
    Claim(
        key="position-gain",
        where="6.2, K_11",
        says="with (24), 4 rules: K of -6.31e4, -6.513e4",
        quantity="largest position gain",
        unit="N m/rad",
        paper=6.513e4,
        comparison="order",
        measure=m.largest_gain("gains", slice(0, 2)),
        reason=reasons.GAINS,
        tolerance=COMPUTED,
    ),
    Claim(
        key="velocity-gain",
        where="6.2, K_11",
        says="-978, -591",
        quantity="largest velocity gain",
        unit="N m s/rad",
        paper=978.0,
        comparison="order",
        measure=m.largest_gain("gains", slice(2, 4)),
        reason=reasons.GAINS,
        tolerance=COMPUTED,
    ),
    Claim(
        key="integral-gain",
        where="6.2, H_11",
        says="7200, 4.62e4",
        quantity="largest integral gain",
        unit="N m/(rad s)",
        paper=4.62e4,
        comparison="order",
        measure=m.largest_gain("gains", slice(4, 6)),
        reason=reasons.INTEGRAL_GAIN,
        tolerance=COMPUTED,
    ),
    Claim(
        key="feedforward-gain",
        where="6.2, L_11",
        says="14.7, 15.2",
        quantity="largest entry of L",
        unit="N m/rad",
        paper=15.2,
        comparison="order",
        measure=m.largest_gain("feedforward", slice(None)),
        reason=reasons.FREE_L,
        tolerance=COMPUTED,
    ),
    Claim(
        key="gamma-of-L",
        where="6.2, L_11",
        says="gamma is not printed",
        quantity="smallest gamma at which the printed form's file, 4 rules, is proven with",
        unit="-",
        paper=None,
        measure=m.gamma_with_other_L,
        reason=reasons.FREE_L,
        tolerance=BISECTED,
    ),
    Claim(
        key="similar",
        where="6.2, Figs. 4-6",
        says="32 and 4 rules behave similarly in all three cases",
        quantity="largest difference of their circularity errors at the tip",
        unit="mm",
        paper=None,
        measure=m.rule_difference,
        reason=reasons.SIMILAR,
        tolerance=SIMULATED_MM,
    ),
)

TABLE_2: tuple[Claim, ...] = (
    Claim(
        key="table-2-variables",
        where="Table 2",
        says="N_var: 5138, 1298, 338, 98",
        quantity="N_var by the formula of Remark 4",
        unit="-",
        paper=_table_2(5138, 1298, 338, 98),
        measure=m.printed_size("variables"),
    ),
    Claim(
        key="true-variables",
        where="Table 2",
        says="N_var: 5138, 1298, 338, 98",
        quantity="scalar variables of the theorem",
        unit="-",
        paper=_table_2(5138, 1298, 338, 98),
        measure=m.true_size("variables"),
        reason=reasons.TRUE_SIZE,
    ),
    Claim(
        key="table-2-rows",
        where="Table 2",
        says="N_row: 33816, 8728, 2328, 664",
        quantity="N_row by the formula of Remark 4",
        unit="-",
        paper=_table_2(33816, 8728, 2328, 664),
        measure=m.printed_size("rows"),
    ),
    Claim(
        key="true-rows",
        where="Table 2",
        says="N_row: 33816, 8728, 2328, 664",
        quantity="rows of the theorem's inequalities",
        unit="-",
        paper=_table_2(33816, 8728, 2328, 664),
        measure=m.true_size("rows"),
        reason=reasons.TRUE_SIZE,
    ),
)


def _circularity(
    number: int, case: str, side: str, says: str, ends: Mapping[str, float | None], reason: str
) -> list[Claim]:
    """Return the claims of one circularity figure on one side, one for each end of the range in `ends`."""
    of = {"largest size": m.peak, "inmost": m.smallest, "outmost": m.largest}
    return [
        Claim(
            key=f"case-{number}-{end.split()[0]}-{side}",
            where=f"6.2, Fig. {number + 3}",
            says=says,
            quantity=f"circularity error, Case {number}, {side}, {end}",
            unit="mm",
            paper=paper,
            decimals=1,
            measure=m.circularity(case, side, of[end]),
            reason=reason,
            tolerance=SIMULATED_MM,
        )
        for end, paper in ends.items()
    ]


_ABOUT = "maximal deviation about 1.3 mm for the two controllers"
_BETWEEN = "the trajectory radius evolves between -2.3 and 4.4 mm"

ROLLOUTS: tuple[Claim, ...] = (
    *_circularity(1, "nominal", "tip", _ABOUT, {"largest size": 1.3}, reasons.CIRCLE),
    *_circularity(1, "nominal", "motors", _ABOUT, {"largest size": 1.3}, reasons.CIRCLE),
    *_circularity(2, "machining", "tip", _BETWEEN, {"inmost": -2.3, "outmost": 4.4}, reasons.CIRCLE_FORCE),
    *_circularity(2, "machining", "motors", _BETWEEN, {"inmost": -2.3, "outmost": 4.4}, reasons.CIRCLE_FORCE),
    *_circularity(3, "payload", "tip", "a figure", {"inmost": None, "outmost": None}, reasons.NO_NUMBER),
    *_circularity(3, "payload", "motors", "a figure", {"inmost": None, "outmost": None}, reasons.NO_NUMBER),
    *(
        Claim(
            key=f"worst-case-{side}",
            where="6.2",
            says="the worst one being Case 2",
            quantity=f"largest circularity error, {side}, Case 2 over Case 3",
            unit="-",
            paper=1.0,
            comparison="more than",
            measure=m.worst_case(side),
            reason=reasons.WORST,
            tolerance=SIMULATED,
        )
        for side in ("tip", "motors")
    ),
    *(
        Claim(
            key=f"peak-torque-{joint}",
            where="6.2, Fig. 7",
            says="the maximal required torques are 228 Nm for joint 1 and 47 Nm for joint 2",
            quantity=f"largest torque of joint {joint}, Case 1",
            unit="N m",
            paper=paper,
            measure=m.peak_torque(joint - 1),
            reason=reasons.SATURATED,
            tolerance=SIMULATED,
        )
        for joint, paper in ((1, 228.0), (2, 47.0))
    ),
    Claim(
        key="end",
        where="6.1.3",
        says="executed in a duration of 1.5 s",
        quantity="end of the shortest episode of the three cases",
        unit="s",
        paper=1.5,
        decimals=1,
        measure=m.shortest_episode,
        reason=reasons.LEFT_BOX,
        tolerance=SIMULATED,
    ),
    Claim(
        key="feedforward-at-rest",
        where="6.2, L_11",
        says="no number",
        quantity="torque of joint 1 that L asks for at t = 0",
        unit="N m",
        paper=None,
        measure=m.feedforward_at_rest,
        reason=reasons.FREE_L,
        tolerance=COMPUTED,
    ),
)

CLAIMS = (*STATEMENTS, *TABLE_2, *ROLLOUTS)
