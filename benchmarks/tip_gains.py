"""Gains that are designed on the sampled elastic arm at the vertices of its stiffness, and their proven bound.

    python benchmarks/tip_gains.py [--json FILE]

The gains of `fuzzy-4` on angle, velocity and integral of each joint get a factor each, six in all, found by
Nelder-Mead. What is made small is the float part of the bound: over four postures of the paper's circle and the
vertices of stiffness ± 10 %, the largest deviation of the tip that friction torques of any course up to the static ones
can cause in the linear sampled loop, the sum over k of |J Φ^k B| F_s. The loops have to bear what the rule of the
shipped gains asks, at every fourth posture, and the frozen rigid loop has to decay with 20 1/s in the whole box. The
proven bound is then that of `fuzzyarm prove`; those of the shipped gains are the stored ones of `tip_bound.py`. And for
the soft arm of `own_arms.py`, the bounds of the design that was chosen and of one with a bound of the fastest pole,
which has nearly the same motor error. A minute.
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

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.eval.certified.tip.bound import TipClaim, find_bound
from fuzzyarm.eval.certified.tip.enclosures import NoBound
from fuzzyarm.eval.certified.tip.plant_set import SETS, PlantSet
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.linearisation import linearise, linearise_path
from fuzzyarm.eval.stability.local_loop import LocalLoop, largest_radius
from fuzzyarm.eval.tuning.conditions import heaviest, periods_of, radius_within, with_stiffness
from fuzzyarm.eval.tuning.fuzzy_gains import LEAST_GAIN_MARGINS, LEFT, LOOP_GAINS, _rigid_poles, specification_of
from fuzzyarm.eval.tuning.fuzzy_gains import STIFFNESS as SOFTER
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.policies.registry import POLICIES
from fuzzyarm.synthesis import design

COMMAND = "python benchmarks/tip_gains.py"
PERIOD = 1e-3  # s
POSTURES = 4
STIFFNESS = (0.9, 1.1)  # factors, of each joint
HORIZON = 600  # control periods of the sum; after them a deviation has decayed
EVALUATIONS = 400
DECAY = 20.0  # 1/s
WIDE = PlantSet(stiffness=(0.9, 1.1))
DESIGNS = {"soft": (15.0, 4e-4)}
"""α [1/s] and γ [rad/(N m)] that were chosen for an arm of `own_arms.py`, without a bound of the fastest pole."""
STORED = Path(__file__).parent / "results" / "tip_bound.json"


@dataclasses.dataclass(frozen=True)
class Vertex:
    """A loop at one posture and one vertex of the stiffness: with the gains as shipped, and J of the tip [m] (2, 2)."""

    loop: LocalLoop
    jacobian: np.ndarray


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
        self._controller = controller
        policy, mass = FuzzyPolicy(controller, PERIOD), heaviest(arm)
        self._left = radius_within(LEFT, periods_of(arm))
        self._loops = {
            (factor, load): linearise_path(
                policy, with_stiffness(arm, factor), PERIOD, Payload(load) if load else None
            )[::POSTURES]
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
        return over or max(0.0, PERIOD * (DECAY + self.slowest_pole(factors)))

    def slowest_pole(self, factors: np.ndarray) -> float:
        """Return the largest real part [1/s] of the frozen rigid loop's poles in the box."""
        return _rigid_poles(multiplied(self._controller, factors))[0]


def multiplied(controller: Controller, factors: np.ndarray) -> Controller:
    """Return a controller with factors (3, 2) on its gains; it has no certificate."""
    return dataclasses.replace(controller, gains=controller.gains * np.concatenate([*factors]))


def vertices(controller: Controller, arm: ArmParameters) -> list[Vertex]:
    """Return the loops at all vertices, then those of the arm itself."""
    reference, policy = default_reference(arm), FuzzyPolicy(controller, PERIOD)
    postures = reference.sample(np.linspace(0.0, reference.duration, POSTURES)).q
    factors = [*((a, b) for a in STIFFNESS for b in STIFFNESS), (1.0, 1.0)]
    found = []
    for pair in factors:
        softer = dataclasses.replace(arm, stiffness=tuple(np.array(pair) * arm.stiffness))
        for q in postures:
            (a, b), (first, second) = arm.length, (q[0], q[0] + q[1])
            far = [-b * np.sin(second), b * np.cos(second)]
            near = [-a * np.sin(first) + far[0], a * np.cos(first) + far[1]]
            found.append(Vertex(linearise(policy, softer, q, PERIOD), np.array([near, far]).T))
    return found


def largest_deviation(loops: list[tuple[LocalLoop, np.ndarray]], static: np.ndarray) -> float:
    """Return the largest sum over k of |J Φ^k B| F_s [m], over loops with their J and along x and y."""
    matrices = np.array([loop.matrix() for loop, _ in loops])
    state = np.zeros((len(loops), matrices.shape[1], JOINTS))
    for at, (loop, _) in zip(state, loops, strict=True):
        at[: len(loop.plant)] = loop.plant[:, len(loop.plant) :]
    jacobians, total = np.array([jacobian for _, jacobian in loops]), np.zeros((len(loops), 2))
    for _ in range(HORIZON):
        total += np.abs(jacobians @ state[:, JOINTS : 2 * JOINTS]) @ static
        state = matrices @ state
    return float(total.max())


def found_factors(known: list[Vertex], static: np.ndarray, rule: Rule) -> tuple[np.ndarray, float]:
    """Return factors (3, 2) on the gains, and the largest deviation [m] with them."""

    def cost(logarithms: np.ndarray) -> float:
        factors = np.exp(logarithms).reshape(3, JOINTS)
        loops = [scaled(vertex.loop, factors) for vertex in known]
        missed = max(0.0, largest_radius(loops) - 1.0)
        missed = missed or rule.missed(factors)
        if missed:
            return 1.0 + missed
        return largest_deviation([(a, b.jacobian) for a, b in zip(loops, known, strict=True)], static)

    simplex = np.vstack([np.zeros(6), 0.3 * np.eye(6)])
    options = {"initial_simplex": simplex, "maxfev": EVALUATIONS}
    best = minimize(cost, np.zeros(6), method="Nelder-Mead", options=options)
    return np.exp(best.x).reshape(3, JOINTS), float(best.fun)


def bounds_of(controller: Controller, arm: ArmParameters, sets: dict[str, PlantSet]) -> dict[str, float | str]:
    """Return the proven bound [mm] for each set, or why there is none."""
    policy, found = TipPolicy(FuzzyPolicy(controller, PERIOD)), {}
    for name, plants in sets.items():
        claim = TipClaim("it", "nominal", name, plants, duration=default_reference(arm).duration)
        try:
            found[name] = 1e3 * find_bound(claim, policy=policy).largest
        except NoBound as error:
            found[name] = str(error).rsplit(": ", 1)[-1]
    return found


def rows_of_vertices() -> list[dict[str, Any]]:
    """Return the rows of Table 1: the shipped gains, and those that were found."""
    arm = ArmParameters()
    shipped = Controller.load(POLICIES["fuzzy-4"].path)
    known, static = vertices(shipped, arm), np.array(arm.static_friction)
    sets = {"any-friction": SETS["any-friction"], "near": SETS["near"], "stiffness ± 10 %": WIDE}
    rule, one, rows = Rule(shipped, arm), np.ones((3, JOINTS)), []
    linear = largest_deviation([(vertex.loop, vertex.jacobian) for vertex in known], static)
    stored = {(row["policy"], row["set"]): row for row in json.loads(STORED.read_text(encoding="utf-8"))["rows"]}
    shipped_bounds = {name: stored["fuzzy-4-tip", name]["bound_mm"] for name in sets}
    for name, factors, deviation in (("as shipped", one, linear), ("found", *found_factors(known, static, rule))):
        row = {"gains": name, "factors": factors.tolist(), "linear_mm": 1e3 * deviation}
        row |= {"bears": rule.missed(factors) == 0.0, "slowest_rigid_pole": rule.slowest_pole(factors)}
        proven = shipped_bounds if factors is one else bounds_of(multiplied(shipped, factors), arm, sets)
        rows.append({**row, "bounds_mm": proven})
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
