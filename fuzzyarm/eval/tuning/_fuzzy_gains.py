"""The choice of the gains of a fuzzy controller: a grid over γ and the bound on the fastest pole.

The rule uses only the nominal case and margins: it minimises the rms error of the motors in the nominal case over
the designs of the grid that meet two requirements. The loop on the sampled elastic arm must tolerate four times
its gain (12 dB), and 1.5 times with one extra sample of delay. Small deviations must at least halve within the movement
under every combination of: one extra sample of delay or none; joints 20 % softer or stiffer or as they are; and no
further change, loop gain x 0.67, loop gain x 1.5 or the arm's payload at the tip. The policy knows the nominal arm
throughout. Designs whose motor error is within `WORTH` of the smallest are equally good; of these the rule selects the
one with which friction moves the tip least, see `largest_deviation`.

The decay rate α is the first of `ALPHAS` for which there is such a design. The values of γ are those for
Table 1, scaled to the arm and α by `gamma_for`; the bounds on the pole are the same for all arms, because the control
period limits the poles. A decay rate is rejected if no design with the largest γ, which has the smallest gains of the
grid, meets the requirements.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fuzzyarm.envs.physics.dynamics import Payload, tip_jacobian
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import State, columns
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.eval.stability._linearisation import LocalLoop, gain_limits, largest_radius, linearise_path
from fuzzyarm.eval.tuning._finding import PERIOD, halving_radius, heaviest, periods_of, with_stiffness
from fuzzyarm.eval.tuning._search import WORTH, Context, Found, measured_radii, motor_error, nothing
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.plant import SETS
from fuzzyarm.synthesis import DesignFailed, Specification, design
from fuzzyarm.synthesis.specification import ALPHAS, gamma_for

__all__ = ["FUZZY", "GRID", "PROVEN_SETS", "RULES", "find_gains", "largest_deviation"]

RULES = 4
"""Rules of the fuzzy controller."""
FUZZY = f"fuzzy-{RULES}"
"""The name of the fuzzy controller; those that keep more premises are similar and use its γ and fastest pole."""

_GAMMAS = (7e-5, 1e-4, 1.2e-4, 1.4e-4, 1.7e-4, 2e-4, 2.5e-4, 3e-4)  # γ [rad/(N m)] for Table 1 at the first α
_POLES = (None, 300.0, 250.0, 200.0, 170.0, 150.0, 120.0, 100.0, 80.0, 60.0)  # bounds on the fastest pole [1/s]
GRID = len(_GAMMAS) * len(_POLES)
"""Number of designs that are tried for one decay rate."""
_STIFFNESS = (0.8, 1.0, 1.2)  # factors on both joints
_LOOP_GAINS = (1.0, 0.67, 1.5)
# Names in a finding: the motor error [mrad], and the loop gains tolerated without and with one sample of delay.
_ERROR, _UPPER, _LATER = "case_1_joint_error_rms_mrad", "gain_margin_upper", "gain_margin_upper_1_sample_later"
_LEAST = {_UPPER: 4.0, _LATER: 1.5}


class _Made(NamedTuple):
    """A design of the grid: its specification, its measurements, and whether it meets every requirement of the rule."""

    wanted: Specification
    measured: dict[str, float]
    bears: bool


def find_gains(context: Context) -> Found:
    """Return α, γ and the fastest-pole bound selected by the rule; write the controller file."""
    arm: ArmParameters = context.arm
    tried, notes = 0, list[str]()
    for alpha in ALPHAS:
        points = _points_of(arm, alpha)
        others, gentle = points[: -len(_POLES)], points[-len(_POLES) :]
        made = context.run(functools.partial(_assessed, arm), gentle)
        if any(one is not None and one.bears for one in made):
            made = [*context.run(functools.partial(_assessed, arm), others), *made]
        tried += len(made)
        equals = _equals_of([one for one in made if one is not None])
        if equals:
            break
        notes.append(f"No design with alpha = {alpha:g} 1/s meets the requirements on the sampled elastic arm.")
    else:
        way = "fuzzyarm design requires less, and names the limiting parameter of the arm"
        return nothing(f"No design meets the requirements, even with alpha = {alpha:g} 1/s: {way}.", tried)
    best = equals[0]
    controller = design(best.wanted, arm).controller
    controller.save(context.folder / f"{FUZZY}.json")
    policy = FuzzyPolicy(controller, PERIOD)
    bounds, without = measured_bounds(TipPolicy(policy), arm)
    notes += [_equals_in_words(equals), *without]
    chosen = {name: getattr(best.wanted, name) for name in ("alpha", "gamma", "fastest_pole")}
    return Found(chosen, best.measured | bounds, measured_radii(policy, arm), tried, notes)


def _points_of(arm: ArmParameters, alpha: float) -> list[Specification]:
    """Return the specifications of all designs of the grid for an arm and a decay rate [1/s], by ascending γ."""
    return [
        Specification(NAMED_RULES[RULES], alpha=alpha, gamma=gamma_for(arm, alpha, gamma), fastest_pole=pole)
        for gamma, pole in itertools.product(_GAMMAS, _POLES)
    ]


def _assessed(arm: ArmParameters, wanted: Specification) -> _Made | None:
    """Return the measurements of the design for the specification `wanted`; None if there is no such design."""
    try:
        controller = design(wanted, arm, explain=False).controller
    except DesignFailed:
        return None
    policy, mass = FuzzyPolicy(controller), heaviest(arm)
    loops = {
        (stiffness, load): linearise_path(
            policy, with_stiffness(arm, stiffness), PERIOD, Payload(load) if load else None
        )
        for stiffness, load in itertools.product(_STIFFNESS, (0.0, mass))
    }
    disturbed = (*((gain, 0.0) for gain in _LOOP_GAINS), (1.0, mass))
    nominal = loops[1.0, 0.0]
    stable = largest_radius(nominal) < 1.0
    measured = {
        _ERROR: motor_error(policy, arm),
        "tip_deviation_mm": 1e3 * largest_deviation(nominal, arm, periods_of(arm)) if stable else math.nan,
        "radius_worst_condition": max(
            largest_radius(loops[stiffness, load], gain, delay)
            for stiffness, delay, (gain, load) in itertools.product(_STIFFNESS, (0, 1), disturbed)
        ),
        _UPPER: gain_limits(nominal).upper,
        _LATER: gain_limits(nominal, 1).upper,
    }
    return _Made(wanted, measured, _bears(measured, halving_radius(arm)))


def _bears(measured: dict[str, float], allowed: float) -> bool:
    """Return whether a design with these measurements meets the rule; `allowed` is the largest spectral radius."""
    # An unstable loop has margins of nan, which no comparison passes.
    enough = all(measured[name] >= least for name, least in _LEAST.items())
    return enough and measured["radius_worst_condition"] <= allowed


def _equals_of(made: Sequence[_Made]) -> list[_Made]:
    """Return the designs that meet the requirements with a motor error within `WORTH` of the least, the best first."""
    fit = [one for one in made if one.bears]
    least = min((one.measured[_ERROR] for one in fit), default=math.nan)
    equals = [one for one in fit if one.measured[_ERROR] <= (1.0 + WORTH) * least]
    return sorted(equals, key=lambda one: (one.measured["tip_deviation_mm"], one.measured[_ERROR]))


def _equals_in_words(equals: Sequence[_Made]) -> str:
    """Return a sentence on how far friction moves the tip with the equally good designs `equals`, the best first."""
    if len(equals) == 1:
        return f"No other motor error is within {100 * WORTH:g} % of the smallest, so the bound was not needed."
    best, worst = (one.measured["tip_deviation_mm"] for one in (equals[0], equals[-1]))
    return (
        f"{len(equals)} designs have motor errors within {100 * WORTH:g} % of the smallest; with the chosen one, any "
        f"friction deflects the tip by up to {best:.4g} mm (linear, in floats), and with the others by up to "
        f"{worst:.4g} mm."
    )


# The bound on the tip error -------------------------------------------------------------------------------------------

_DIRECTIONS = 16  # of the tip; along them the largest deviation is at most 0.5 % below that over all


def largest_deviation(loops: Sequence[LocalLoop], arm: ArmParameters, periods: int) -> float:
    """Return the largest deviation of the tip [m] that any friction up to the static friction can cause.

    With the closed loop x⁺ = Φ x + B w at a posture, where w is the friction of the motors held over a control period,
    |w| <= F_s, and J is the Jacobian of the tip, it is

        max over unit vectors d of Σ_k |dᵀ J Φ^k B| F_s,  0 <= k < periods.

    It is the largest part of the proven bound of the set ``any-friction``, here at frozen postures and in floats. The
    loops must be stable, and the torque must depend on all of the policy's memory in each.
    """
    at = columns(State)
    turns = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    postures = np.array([loop.equilibrium[at.link] for loop in loops])
    rows = np.stack([np.cos(turns), np.sin(turns)], axis=1) @ tip_jacobian(postures, arm.length)
    matrices = np.array([loop.matrix() for loop in loops])
    states = len(loops[0].plant)
    moved = np.zeros((*matrices.shape[:2], len(arm.static_friction)))
    moved[:, :states] = [loop.plant[:, states:] for loop in loops]
    total = np.zeros((len(loops), _DIRECTIONS))
    for _ in range(periods):
        total += np.abs(rows @ moved[:, at.link]) @ np.array(arm.static_friction)
        moved = matrices @ moved
    return float(total.max())


PROVEN_SETS = {
    "table-1": ("tip_bound_mm", "the arm itself"),
    "near": ("tip_bound_near_mm", "plants near it (set near)"),
}
"""Sets of plants around the arm: the name of the bound in a finding [mm], and the set in words."""


def measured_bounds(policy: Policy, arm: ArmParameters) -> tuple[dict[str, float | None], tuple[str, ...]]:
    """Return a policy's tip bounds [mm] by the names in `PROVEN_SETS`, and notes; None and a note where unproven."""
    found: dict[str, float | None] = {}
    notes = []
    for name, (key, words) in PROVEN_SETS.items():
        claim = TipClaim("the policy", "nominal", name, SETS[name], duration=default_reference(arm).duration)
        try:
            found[key] = 1e3 * find_bound(claim, policy=policy).largest
        except NoBound as error:
            found[key] = None
            notes.append(f"No bound on the tip error is proven for {words}: {str(error).split(': ', 1)[1]}.")
    return found, tuple(notes)
