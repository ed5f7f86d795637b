"""Gains that are designed on the sampled elastic arm at the vertices of its stiffness, and their proven bound.

    python benchmarks/tip_gains.py [--json FILE]

The gains of `fuzzy-4` on angle, velocity and integral of each joint get a factor each, six in all, found by
Nelder-Mead. What is made small is the float part of the bound: over four postures of the paper's circle and the
vertices of stiffness ± 10 %, the largest deviation of the tip that friction torques of any course up to the static ones
can cause in the linear sampled loop, see `eval.tuning.tip_bounds`. The loops have to bear what the rule of the
shipped gains asks, and the gains have to have a certificate of the rigid arm with a decay rate of 20 1/s and an L2 gain
of 2e-4 rad/(N m). `shipped_controllers.py` has the factors and writes `fuzzy-4-sampled` with them. The proven
bounds are then those of `fuzzyarm prove`; those of the shipped gains are the stored ones of `tip_bound.py`. And for the
soft arm of `own_arms.py`, the bounds of the design that was chosen and of one with a bound of the fastest pole, which
has nearly the same motor error. Five minutes.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
from own_arms import ARMS
from scipy.optimize import minimize
from shipped_controllers import SAMPLED_GAMMA, proven_at_its_gains, with_factors

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.linearisation import LocalLoop, largest_radius, linearise, linearise_path
from fuzzyarm.eval.tuning.finding import heaviest, periods_of, radius_within, with_stiffness
from fuzzyarm.eval.tuning.fuzzy_gains import (
    LEAST_GAIN_MARGINS,
    LEFT,
    LOOP_GAINS,
    bears,
    judged,
    specification_of,
)
from fuzzyarm.eval.tuning.fuzzy_gains import STIFFNESS as SOFTER
from fuzzyarm.eval.tuning.tip_bounds import largest_deviation
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.policies.registry import POLICIES
from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.plant import SETS, PlantSet
from fuzzyarm.synthesis import design

COMMAND = "python benchmarks/tip_gains.py"
PERIOD = 1e-3  # s
POSTURES = 4
STIFFNESS = (0.9, 1.1)  # factors, of each joint
HORIZON = 600  # control periods of the sum; after them a deviation has decayed
EVALUATIONS = 300
FIRST_STEP = 0.2  # of the logarithm of a factor
DIGITS = 2  # of a factor, after the point
WIDE = PlantSet(stiffness=(0.9, 1.1))
DESIGNS = {"soft": (15.0, 4e-4)}
"""α [1/s] and γ [rad/(N m)] that were chosen for an arm of `own_arms.py`, without a bound of the fastest pole."""
STORED = Path(__file__).parent / "results" / "tip_bound.json"


def scaled(loop: LocalLoop, factors: np.ndarray) -> LocalLoop:
    """Return a loop with factors (3, 2) on the gains of angle, velocity and integral of each joint."""
    law, n = loop.law.copy(), len(loop.plant)
    for start, factor in zip((0, n // 2, n), factors, strict=True):
        law[:JOINTS, start : start + JOINTS] *= factor
    return dataclasses.replace(loop, law=law)


class Rule:
    """The rule of the shipped gains: what the loop on the sampled elastic arm bears, see `tuning.fuzzy_gains`."""

    def __init__(self, controller: Controller, arm: ArmParameters) -> None:
        """Linearise the loops with the shipped gains."""
        policy, mass = FuzzyPolicy(controller, PERIOD), heaviest(arm)
        self._left = radius_within(LEFT, periods_of(arm))
        self._loops = {
            (factor, load): linearise_path(policy, with_stiffness(arm, factor), PERIOD, Payload(load) if load else None)
            for factor in SOFTER
            for load in (0.0, mass)
        }
        self._disturbed = [*((gain, 0.0) for gain in LOOP_GAINS), (1.0, mass)]

    def missed(self, factors: np.ndarray) -> float:
        """Return by how much spectral radii are too large, together, with factors on the gains; 0: none is."""
        loops = {key: [scaled(loop, factors) for loop in path] for key, path in self._loops.items()}
        over = sum(
            max(0.0, largest_radius(loops[1.0, 0.0], gain, delay) - 1.0)
            for delay, gain in enumerate(LEAST_GAIN_MARGINS)
        )
        for factor, delay, (gain, load) in itertools.product(SOFTER, (0, 1), self._disturbed):
            over += max(0.0, largest_radius(loops[factor, load], gain, delay) - self._left)
        return over


def vertices(controller: Controller, arm: ArmParameters) -> list[LocalLoop]:
    """Return the loops at all vertices of the stiffness, then those of the arm itself."""
    reference, policy = default_reference(arm), FuzzyPolicy(controller, PERIOD)
    postures = reference.sample(np.linspace(0.0, reference.duration, POSTURES)).q
    factors = [*itertools.product(STIFFNESS, STIFFNESS), (1.0, 1.0)]
    arms = [dataclasses.replace(arm, stiffness=tuple(np.array(pair) * arm.stiffness)) for pair in factors]
    return [linearise(policy, one, q, PERIOD) for one in arms for q in postures]


def found_factors(controller: Controller, arm: ArmParameters) -> np.ndarray:
    """Return factors (3, 2) on the gains of a controller."""
    known, rule, least = vertices(controller, arm), Rule(controller, arm), np.inf

    def cost(logarithms: np.ndarray) -> float:
        nonlocal least
        factors = rounded(logarithms)
        loops = [scaled(loop, factors) for loop in known]
        missed = max(0.0, largest_radius(loops) - 1.0) or rule.missed(factors)
        if missed:
            return 2.0 + missed
        deviation = largest_deviation(loops, arm, HORIZON)
        if deviation < least:  # others need no certificate
            if proven_at_its_gains(with_factors(controller, factors), SAMPLED_GAMMA) is None:
                return 1.0
            least = deviation
        return deviation

    simplex = np.vstack([np.zeros(6), FIRST_STEP * np.eye(6)])
    options = {"initial_simplex": simplex, "maxfev": EVALUATIONS}
    return rounded(minimize(cost, np.zeros(6), method="Nelder-Mead", options=options).x)


def rounded(logarithms: np.ndarray) -> np.ndarray:
    """Return the factors (3, 2) of their logarithms (6,), with `DIGITS` digits after the point."""
    return np.round(np.exp(logarithms).reshape(3, JOINTS), DIGITS)


def bounds_of(controller: Controller, arm: ArmParameters, sets: dict[str, PlantSet]) -> dict[str, float | str]:
    """Return the proven bound [mm] for each set, or why there is none."""
    policy, found = TipPolicy(FuzzyPolicy(controller, PERIOD)), {}
    for name, plants in sets.items():
        claim = TipClaim("it", "nominal", name.replace("±", "+-"), plants, duration=default_reference(arm).duration)
        try:
            found[name] = 1e3 * find_bound(claim, policy=policy).largest
        except NoBound as error:
            found[name] = str(error).rsplit(": ", 1)[-1]
    return found


def rows_of_vertices() -> list[dict[str, Any]]:
    """Return the rows of Table 1: the shipped gains, and those that were found."""
    arm = ArmParameters()
    shipped = Controller.load(POLICIES["fuzzy-4"].path)
    sets = {"any-friction": SETS["any-friction"], "near": SETS["near"], "stiffness ± 10 %": WIDE}
    stored = {(row["policy"], row["set"]): row for row in json.loads(STORED.read_text(encoding="utf-8"))["rows"]}
    one, rows = np.ones((3, JOINTS)), []
    for name, factors in (("as shipped", one), ("found", found_factors(shipped, arm))):
        controller = proven_at_its_gains(with_factors(shipped, factors), SAMPLED_GAMMA)
        assert controller is not None
        loops = [scaled(loop, factors) for loop in vertices(shipped, arm)]
        row = {"gains": name, "factors": factors.tolist(), "linear_mm": 1e3 * largest_deviation(loops, arm, HORIZON)}
        found = judged(arm, controller)
        names = ("case_1_joint_error_rms_mrad", "largest_gain", "slowest_rigid_pole", "radius_worst_condition")
        row |= {"bears": bears(arm, found), **{key: found[key] for key in names}}
        proven = {name: stored["fuzzy-4-tip", name]["bound_mm"] for name in sets}
        rows.append({**row, "bounds_mm": proven if factors is one else bounds_of(controller, arm, sets)})
        print(json.dumps(rows[-1]), flush=True)
    return rows


def rows_of_arms() -> list[dict[str, Any]]:
    """Return the rows of other arms: bounds without a bound of the fastest pole, and with one."""
    rows = []
    for name, (alpha, gamma) in DESIGNS.items():
        arm = ARMS[name]
        assert isinstance(arm, ArmParameters)
        for pole in (None, 200.0):
            controller = design(specification_of(4, alpha, gamma, pole), arm).controller
            bounds = bounds_of(controller, arm, {"near": SETS["near"]})
            rows.append({"arm": name, "fastest_pole": pole, "bounds_mm": bounds})
            print(json.dumps(rows[-1]), flush=True)
    return rows


def main() -> None:
    """Measure, print a line for each row and optionally write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    document = {"command": COMMAND, "rows": rows_of_vertices(), "arms": rows_of_arms(), **current_provenance()}
    if options.json:
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
