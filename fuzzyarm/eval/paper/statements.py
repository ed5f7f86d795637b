"""The paper's numbers about the reference, the cases, the inequalities and the gains, as data."""

from __future__ import annotations

from fuzzyarm.eval.paper import measures as m
from fuzzyarm.eval.paper import reasons
from fuzzyarm.eval.paper.claim import BISECTED, COMPUTED, SIMULATED_MM, Claim
from fuzzyarm.fuzzy_policy.states import INTEGRAL, POSITION, VELOCITY

__all__ = ["STATEMENTS"]

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
          {"smallest": 138.0, "largest": 218.0}, m.force_range, reason=reasons.FORCE_PROFILE, tolerance=COMPUTED),
    Claim("payload-mass", "6.2, Case 3", "must carry a mass of 5 kg", "carried mass", "kg", 5.0, m.payload_mass,
          tolerance=COMPUTED),
    Claim("payload-share", "6.2, Case 3", "a variation of the effector mass m_2 of 55.6 %", "carried mass over m_2",
          "%", 55.6, m.payload_share, decimals=1, tolerance=COMPUTED),
    Claim("decay-rate", "6.2", "alpha = 20", "proven decay rate", "1/s", 20.0, m.decay_rate, tolerance=COMPUTED),
    Claim("weight", "6.2", "Q = diag(1e-5, 1e-5, 1, 1)", "Q of the printed form", "-",
          {"Q11": 1e-5, "Q22": 1e-5, "Q33": 1.0, "Q44": 1.0}, m.weight, decimals=6, tolerance=COMPUTED),
    Claim("feasibility", "6.2", "Theorem 2: feasible solutions only with at least 4 rules",
          "fewest rules with a solution proven", "-", {"fewest rules": 4.0}, m.fewest_rules,
          reason=reasons.FEASIBILITY),
    Claim("unbounded-gain", "6.2", "without (24), 4 rules: K of 3.88e9, 7.89e9", "largest entry of K", "N m/rad",
          7.89e9, m.unbounded_gain, comparison="order", reason=reasons.UNBOUNDED, tolerance=COMPUTED),
    Claim("gain-bound", "6.2, (24)", "epsilon = 1e4", "largest norm of M_ik", "-", 1e4, m.bounded_M,
          comparison="at most", tolerance=COMPUTED),
    Claim("position-gain", "6.2, K_11", "with (24), 4 rules: K of -6.31e4, -6.513e4", "largest position gain",
          "N m/rad", 6.513e4, m.largest_gain(POSITION), comparison="order", reason=reasons.GAINS, tolerance=COMPUTED),
    Claim("velocity-gain", "6.2, K_11", "-978, -591", "largest velocity gain", "N m s/rad", 978.0,
          m.largest_gain(VELOCITY), comparison="order", reason=reasons.GAINS, tolerance=COMPUTED),
    Claim("integral-gain", "6.2, H_11", "7200, 4.62e4", "largest integral gain", "N m/(rad s)", 4.62e4,
          m.largest_gain(INTEGRAL), comparison="order", reason=reasons.INTEGRAL_GAIN, tolerance=COMPUTED),
    Claim("feedforward-gain", "6.2, L_11", "14.7, 15.2", "largest entry of L", "N m/rad", 15.2,
          m.largest_feedforward_gain, comparison="order", reason=reasons.FREE_L, tolerance=COMPUTED),
    Claim("gamma-of-L", "6.2, L_11", "gamma is not printed",
          "smallest gamma at which the printed form's file, 4 rules, is proven with", "-", None, m.gamma_with_other_L,
          reason=reasons.FREE_L, tolerance=BISECTED),
    Claim("similar", "6.2, Figs. 4-6", "32 and 4 rules behave similarly in all three cases",
          "largest difference of their circularity errors at the tip", "mm", None, m.rule_difference,
          reason=reasons.SIMILAR, tolerance=SIMULATED_MM),
)  # fmt: skip
