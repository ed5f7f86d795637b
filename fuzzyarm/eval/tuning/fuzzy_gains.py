"""How large the gains of a fuzzy controller should be: a grid over γ and the bound of the fastest pole.

Rule, by the nominal case and margins only: the smallest rms error of the motors in the nominal case among the designs
of the grid whose loop on the sampled elastic arm bears four times its gain (12 dB), 1.5 times with one extra sample of
delay, and in which small deviations at least halve within the movement under every combination of: one extra sample of
delay or none; joints 20 % softer or stiffer or as they are; and nothing else, loop gain x 0.67, loop gain x 1.5 or the
arm's payload at the tip. The policy knows the nominal arm throughout. Designs whose motor error is within `WORTH` of
the smallest are equally good, and of those the one with the smallest float part of the tip's bound is taken, see
`tip_bounds`.

The decay rate is the first of `ALPHAS` for which there is such a design. γ is that of Table 1 times the ratio of the
inertias and (20 1/s)/α; the poles are those of Table 1, because they are limited by the control period. A decay rate is
given up where no design with the largest γ, the smallest gains of the grid, bears what is asked.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.eval.stability.linearisation import gain_limits, largest_radius, linearise_path
from fuzzyarm.eval.tuning.finding import PERIOD, heaviest, periods_of, radius_within, with_stiffness
from fuzzyarm.eval.tuning.search import WORTH
from fuzzyarm.eval.tuning.tip_bounds import largest_deviation
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
from fuzzyarm.proof.rigid_loop import RigidLoop
from fuzzyarm.synthesis import Design, Specification, find_design

__all__ = [
    "ALPHAS", "GAMMAS", "POLES", "assess", "bears", "choice_of", "equals_in_words", "gammas_for", "points_of",
    "specification_of",
]  # fmt: skip

ALPHAS = (20.0, 15.0, 10.0, 7.0, 5.0, 3.0, 2.0)
"""Decay rates [1/s] that are tried, one after the other."""
GAMMAS = (7e-5, 1e-4, 1.2e-4, 1.4e-4, 1.7e-4, 2e-4, 2.5e-4, 3e-4)
"""γ [rad/(N m)] for Table 1 at the first decay rate."""
POLES = (None, 300.0, 250.0, 200.0, 170.0, 150.0, 120.0, 100.0, 80.0, 60.0)
"""Bounds of the fastest pole [1/s], where z1 is kept."""
LEAST_GAIN_MARGINS = (4.0, 1.5)  # without extra delay and with one sample of it
LEFT = 0.5  # of a small deviation after the movement
STIFFNESS = (0.8, 1.0, 1.2)  # factors on both joints
LOOP_GAINS = (1.0, 0.67, 1.5)
_CASES = {"case_1": "nominal"}  # in which errors are measured, by the beginning of their keys in a row
_ERROR = "case_1_joint_error_rms_mrad"
_METRICS = ("joint_error_rms_mrad", "circularity_motor_min_mm", "circularity_motor_max_mm")


def gammas_for(arm: ArmParameters, alpha: float) -> tuple[float, ...]:
    """Return γ [rad/(N m)] of the grid for an arm and a decay rate [1/s], ascending."""
    factor = _inertia(ArmParameters()) / _inertia(arm) * ALPHAS[0] / alpha
    return tuple(float(f"{factor * gamma:.2g}") for gamma in GAMMAS)


def _inertia(arm: ArmParameters) -> float:
    """Return the mean of the joints' largest inertias, rotors included [kg m²]."""
    constants = arm_constants(arm)
    return float(np.mean(np.array(arm.motor_inertia) + np.array([constants.c1, constants.c3])))


def points_of(arm: ArmParameters, rules: int, alpha: float) -> list[Specification]:
    """Return the points of the grid for a decay rate [1/s], those with the largest γ last."""
    poles = POLES if "z1" in NAMED_RULES[rules] else (None,)
    return [
        specification_of(rules, alpha, gamma, pole) for gamma, pole in itertools.product(gammas_for(arm, alpha), poles)
    ]


def specification_of(rules: int, alpha: float, gamma: float, pole: float | None) -> Specification:
    """Return what is asked of the design of one point: α [1/s], γ [rad/(N m)], bound of the fastest pole [1/s]."""
    return Specification(NAMED_RULES[rules], alpha=alpha, gamma=gamma, fastest_pole=pole)


def assess(
    arm: ArmParameters, wanted: Specification, rules: int, cases: dict[str, str] = _CASES
) -> dict[str, Any] | None:
    """Design for one point of the grid and return the row of `judged`; None without a design."""
    made = find_design(wanted, arm)
    if not isinstance(made, Design):
        return None
    point = {"rules": rules, "alpha": wanted.alpha, "gamma": wanted.gamma, "fastest_pole": wanted.fastest_pole}
    row = {**point, "margin": made.certificate.proof_margin, **judged(arm, made.controller, cases)}
    return {**row, "bears": bears(arm, row)}


def judged(arm: ArmParameters, controller: Controller, cases: dict[str, str] = _CASES) -> dict[str, Any]:
    """Return gains, poles, margins, errors and the tip's deviation under any friction, of a controller for the arm.

    The controller knows the arm, to which conditions are applied; `cases` by the beginning of their keys in the row.
    """
    policy, mass = FuzzyPolicy(controller), heaviest(arm)
    loops = {
        (stiffness, load): linearise_path(
            policy, with_stiffness(arm, stiffness), PERIOD, Payload(load) if load else None
        )
        for stiffness, load in itertools.product(STIFFNESS, (0.0, mass))
    }
    disturbed = (*((gain, 0.0) for gain in LOOP_GAINS), (1.0, mass))
    nominal = loops[1.0, 0.0]
    worst = max(
        largest_radius(loops[stiffness, load], gain, delay)
        for stiffness, delay, (gain, load) in itertools.product(STIFFNESS, (0, 1), disturbed)
    )
    slowest, fastest = _rigid_poles(controller)
    row = {
        "largest_gain": float(np.abs(controller.gains[..., :2]).max()),
        "slowest_rigid_pole": slowest,
        "fastest_rigid_pole": fastest,
        "radius": largest_radius(nominal),
        "radius_2_samples_later": largest_radius(nominal, delay=2),
        "radius_worst_condition": worst,
        "gain_margin_upper": gain_limits(nominal)[1],
        "gain_margin_upper_1_sample_later": gain_limits(nominal, 1)[1],
        "tip_deviation_mm": math.nan,
    }
    if row["radius"] < 1.0:
        row["tip_deviation_mm"] = 1e3 * largest_deviation(nominal, arm, periods_of(arm))
    for key, case in cases.items():
        env = FuzzyArmEnv(case=case, parameters=arm)
        measured = metrics_of(record_rollout(env, policy, policy_name="", case=case, seed=0))
        row |= {f"{key}_{name}": measured.get(name, math.nan) for name in _METRICS}
    return row


def _rigid_poles(controller: Controller) -> tuple[float, float]:
    """Return the largest and the smallest real part [1/s] of the frozen rigid loop's poles over a grid in the box."""
    p = controller.model.parameters
    steps = np.array(list(itertools.product(*(np.linspace(-1.0, 1.0, n) for n in (9, 17, 5, 5)))))
    F, _ = RigidLoop(controller).frozen(steps[:, :2] * p.joint_limit, steps[:, 2:] * p.velocity_limit)
    real = np.linalg.eigvals(F).real
    return float(real.max()), float(real.min())


def bears(arm: ArmParameters, row: dict[str, Any]) -> bool:
    """Return whether a design meets every requirement of the rule."""
    margins = (row["gain_margin_upper"], row["gain_margin_upper_1_sample_later"])
    # An unstable loop has margins of nan, which no comparison passes.
    enough = all(margin >= least for margin, least in zip(margins, LEAST_GAIN_MARGINS, strict=True))
    return enough and row["radius_worst_condition"] <= radius_within(LEFT, periods_of(arm))


def _equals_of(rows: list[dict[str, Any]], share: float = WORTH) -> list[dict[str, Any]]:
    """Return the rows that bear what is asked and whose motor error is within a share of the smallest."""
    fit = [row for row in rows if row["bears"]]
    least = min((row[_ERROR] for row in fit), default=math.nan)
    return [row for row in fit if row[_ERROR] <= (1.0 + share) * least]


def choice_of(rows: list[dict[str, Any]], share: float = WORTH) -> dict[str, Any] | None:
    """Return the row that the rule picks, with `share` in place of `WORTH`; None if no design bears what is asked."""
    return min(_equals_of(rows, share), key=lambda row: (row["tip_deviation_mm"], row[_ERROR]), default=None)


def equals_in_words(rows: list[dict[str, Any]], chosen: dict[str, Any]) -> str:
    """Return in a sentence what the float part of the bound decided between equally good designs."""
    equal = _equals_of(rows)
    if len(equal) == 1:
        return f"No other design has a motor error within {100 * WORTH:g} % of it, so the bound had nothing to decide."
    worst = max(row["tip_deviation_mm"] for row in equal)
    return (
        f"{len(equal)} designs have motor errors within {100 * WORTH:g} % of the smallest; with this one any friction "
        f"deflects the tip by up to {chosen['tip_deviation_mm']:.4g} mm (linear, in floats), with the others by up to "
        f"{worst:.4g} mm."
    )
