"""One try: a set, a tube that the checker accepts, and plants of the set that should not be able to leave it."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.dynamics import tip_position
from fuzzyarm.policies.tip_bound import PERIOD, LapClaim, TipClaim, find_bound, problem_of
from fuzzyarm.policies.tip_files import check_bound, save_bound
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.tube import Problem, Tube, TubeStep

from .forge import Attack, Claims, drawn_attack, drawn_fine_attack, forged
from .motions import Motion, even_stops, simulated
from .sets import (
    CONSTANTS,
    Later,
    Sample,
    bred_samples,
    drawn_claim,
    drawn_later,
    drawn_light_claim,
    drawn_samples,
    drawn_start,
    policy_of,
)

SAMPLES, BRED = 8, 3  # plants of the first round, and of the second for each of the two closest
FINE = 5  # every how many tries the motors have little friction and the parts are short
BOXED = 7  # every how many the motion begins in a box of initial states, and as many in the set of a later lap
FINER = 4, 16  # times more sub-steps for a plant that seems to leave its tube
INSIDE = (0.05, 0.5, 0.95, 1.0)  # of a segment: where nodes of a motion are, beside those at equal distances
ROUNDING = np.repeat([1e-13, 1e-11, 1e-13, 1e-11, 1e-8, 1e-8], [4, 4, 2, 2, 2, 4])
"""What floats leave of angles, velocities, bends, their rates, net torques [N m] and accelerations, row by row."""
TIP_ROUNDING = 1e-13  # [m]
RELATIVE = 1e-6


@dataclasses.dataclass
class Outcome:
    """What came of a try; the ratios are the largest ones of simulated plants to what is claimed."""

    seed: int
    number: int
    claim: TipClaim  # for the steps that were accepted
    attack: Attack
    later: Later | None = None  # what is attacked in place of the first lap
    accepted: int = 0  # control steps that the checker accepts
    tip: float = 0.0  # of tip errors to their bounds
    tube: float = 0.0  # of deviations to the tube, over all rows
    column: float = 0.0  # the same for what the columns of the constants leave, at the samples
    finding: str = ""  # what is wrong

    @property
    def ratios(self) -> dict[str, float]:
        """The three ratios by name."""
        return {"tip": self.tip, "tube": self.tube, "column": self.column}


class _Accepted(NamedTuple):
    """A step of an accepted tube; at its end the columns (8, n) of the constants, and how far all else reaches (8,)."""

    step: TubeStep
    columns: np.ndarray
    others: np.ndarray


def tried(seed: int, number: int) -> Outcome:
    """Return what comes of a try."""
    rng = np.random.default_rng([seed, number])
    if number % FINE == FINE - 1:
        claim, attack = drawn_light_claim(rng), drawn_fine_attack(rng)
    else:
        claim, attack = drawn_claim(rng), drawn_attack(rng)
    if number % BOXED == 2:
        claim = dataclasses.replace(claim, start=drawn_start(np.random.default_rng([seed, number, 1])))
    outcome = Outcome(seed, number, claim, attack)
    if number % BOXED == 5:
        with contextlib.suppress(NoBound):  # laps of some laws differ
            outcome.later = drawn_later(claim, np.random.default_rng([seed, number, 1]))
    return attacked(outcome, rng)


def attacked(outcome: Outcome, rng: np.random.Generator) -> Outcome:
    """Forge the tube of an outcome's claim, and judge it."""
    with np.errstate(all="ignore"):
        claims = forged(outcome.claim, outcome.attack, rng, outcome.later)
    if not claims:
        return outcome
    claim, later = dataclasses.replace(outcome.claim, steps=len(claims)), outcome.later
    outcome.claim = claim
    problem = later.problem if later else problem_of(claim, policy_of(claim.policy))
    accepted = _accepted(problem, claims, later)
    outcome.accepted = len(accepted)
    if not accepted:
        return outcome
    plants, box = problem.plants, later is not None or claim.start is not None
    courses = (
        plants.force_swing
        or plants.force_course
        or any(plants.noise)
        or plants.friction == "any"
        or box
        or any(problem.guest)
    )
    several = problem.plant.parameters or courses  # whether the set has more than one motion
    samples = drawn_samples(claim.plants, len(accepted), SAMPLES if several else 1, rng, box)
    closest = _judge(outcome, problem, accepted, samples)
    for sample in closest if problem.plant.parameters else []:
        places = np.array([0.5 + 0.5 * sample.share(claim.plants, *constant) for constant in CONSTANTS])
        _judge(outcome, problem, accepted, bred_samples(claim.plants, places, len(accepted), BRED, rng, box))
    if outcome.finding:
        _confirm(outcome, claims[: len(accepted)])
    return outcome


def _accepted(problem: Problem, claims: Claims, later: Later | None) -> list[_Accepted]:
    """Return the steps that the checker accepts."""
    found: list[_Accepted] = []
    tube, count = Tube(problem, claims, later and later.start), len(problem.plant.parameters)
    with contextlib.suppress(NoBound):  # what closed in the search may be left by a digit when it is confirmed
        for step in itertools.islice(tube, len(claims)):
            columns, box = tube.state.deviations.columns[:8], tube.state.deviations.box[:8]
            others = np.abs(columns[:, count:]).sum(axis=1) + box
            found.append(_Accepted(step, columns[:, :count].copy(), others))
    return found


def _judge(outcome: Outcome, problem: Problem, accepted: list[_Accepted], samples: list[Sample]) -> list[Sample]:
    """Compare plants with a tube: note the ratios and what leaves it; return the plants that come closest."""
    claim, stops = outcome.claim, _stops(accepted)
    try:
        motions = simulated(claim, samples, stops, later=outcome.later)
    except (OverflowError, RuntimeError) as error:  # a solution in a tube is bounded, and its motors do not chatter
        outcome.finding = f"the simulation fails: {error}"
        return []
    found = [_ratios(problem, accepted, sample, motion) for sample, motion in zip(samples, motions, strict=True)]
    for i, sample in enumerate(samples):
        worth = found[i]["tip"] > max(1.0, outcome.tip) if outcome.finding else max(found[i].values()) > 1.0
        if worth:
            finer, found[i] = (
                _ratios(problem, accepted, sample, simulated(claim, [sample], stops, refined, outcome.later)[0])
                for refined in FINER
            )
            # The error of RK4 falls by a factor of 4^4 from one to the next: what both differ by bounds the last one's.
            said = [name for name, ratio in found[i].items() if ratio > 1.0 + RELATIVE + abs(ratio - finer[name])]
            if said and (not outcome.finding or found[i]["tip"] > max(1.0, outcome.tip)):
                numbers = ", ".join(f"{name} {found[i][name]:.6g}" for name in said)
                factors = {name: value for name, value in sample.factors.items() if value != (1.0, 1.0)}
                plant = f"plant {factors}, payload {sample.payload:.6g} kg, force {sample.force:.6g}"
                outcome.finding = f"exceeded: {numbers}, by {plant}"
        for name, ratio in found[i].items():
            setattr(outcome, name, max(getattr(outcome, name), ratio))
    return [samples[int(np.argmax([ratios[name] for ratios in found]))] for name in ("tip", "tube")]


def _stops(accepted: list[_Accepted]) -> list[list[float]]:
    """Return the times of nodes in each control step: equally distant ones, and some of each segment."""
    found = []
    for (step, _, _), even in zip(accepted, even_stops(len(accepted)), strict=True):
        begun, times = 0.0, set(even)
        for segment in step.segments:
            times |= {begun + share * segment.duration for share in INSIDE}
            begun += segment.duration
        found.append(sorted(t for t in times if t <= PERIOD))
    return found


def _ratios(problem: Problem, accepted: list[_Accepted], sample: Sample, motion: Motion) -> dict[str, float]:
    """Return the largest ratios of a motion to the tip's bounds, to the tube, and to what the columns leave."""
    plants, parameters = problem.plants, problem.plant.parameters
    place = np.array([sample.share(plants, p.kind, p.joint) for p in parameters])
    tube = column = between = 0.0
    for k, (step, columns, others) in enumerate(accepted):
        left = np.abs(np.array(motion.nodes[k][-1].state) - step.segments[-1].end - columns @ place)
        column = max(column, float(((left - ROUNDING[:8]) / others).max(initial=0.0, where=others > 0.0)))
        tube = max(tube, _tube_ratio(problem, step, motion, k))
        between = max(between, _between_ratio(problem, step, motion, k))
    bounds = np.array([a.step.tip for a in accepted])
    tip = max(between, float(((motion.tip_errors - TIP_ROUNDING) / bounds).max()))
    return {"tip": tip, "tube": tube, "column": column}


def _between_ratio(problem: Problem, step: TubeStep, motion: Motion, k: int) -> float:
    """Return the largest ratio of a tip error at a node of a control step to the bound at every instant of it."""
    states = np.array([node.state for node in motion.nodes[k]])
    wanted = problem.reference.tip(k * PERIOD + np.array([node.time for node in motion.nodes[k]])).position
    tips = tip_position(states[:, 2:4], problem.parameters.length)
    return float((np.linalg.norm(tips - wanted, axis=1).max() - TIP_ROUNDING) / step.whole)


def _tube_ratio(problem: Problem, step: TubeStep, motion: Motion, k: int) -> float:
    """Return the largest ratio of a deviation to the tube in a control step, over all nodes and rows."""
    arm, nodes, largest, begun = problem.plant.middle, motion.nodes[k], 0.0, 0.0
    times = np.array([node.time for node in nodes])
    states, rates = np.array([node.state for node in nodes]), np.array([node.rates for node in nodes])
    K, B = np.array([arm.stiffness1, arm.stiffness2]), np.array([arm.damping1, arm.damping2])
    viscous = np.array([arm.viscous1, arm.viscous2])
    for segment, closed in zip(step.segments, step.closed, strict=True):
        inside = (times >= begun) & (times <= begun + segment.duration)
        if inside.any():
            s = 2.0 * (times[inside] - begun) / segment.duration - 1.0
            rate = 2.0 / segment.duration
            values, slopes, bends = (
                np.polynomial.polynomial.polyval(s, np.polynomial.polynomial.polyder(segment.angles.T, m)) * rate**m
                for m in range(3)
            )
            deviation = states[inside].T - np.vstack([values, slopes])
            bend, bend_rate = deviation[:2] - deviation[2:4], deviation[4:6] - deviation[6:8]
            held = (motion.torques[k] - step.torque)[:, np.newaxis]
            net = (
                held - K[:, np.newaxis] * bend - B[:, np.newaxis] * bend_rate - viscous[:, np.newaxis] * deviation[4:6]
            )
            rows = np.vstack([deviation, bend, bend_rate, net, rates[inside].T[4:] - bends])
            excess = (np.abs(rows).max(axis=1) - ROUNDING) / closed.tube
            largest = max(largest, float(excess.max()))
        begun += segment.duration
    return largest


def _confirm(outcome: Outcome, claims: Claims) -> None:
    """Ask the public checker for its word on a finding, by a file: only what it accepts is one; a lap is no file."""
    if outcome.later:
        outcome.finding += "; in a later lap"
        return
    try:
        bound = find_bound(outcome.claim, claims=[LapClaim(claims)], policy=policy_of(outcome.claim.policy))
    except NoBound as error:
        outcome.finding = f"harness: the tube is not accepted again: {error}"
        return
    with tempfile.TemporaryDirectory() as folder:
        save_bound(bound, Path(folder) / "bound.json")
        checked = check_bound(Path(folder) / "bound.json")
    word = "PROVEN" if checked.proven else f"not proven, {checked.reason}"
    outcome.finding += f"; the checker says {word}: {checked.sentence}"


def row(outcome: Outcome) -> dict[str, Any]:
    """Return an outcome as plain data."""
    claim = outcome.claim
    of_try = {"seed": outcome.seed, "number": outcome.number, "policy": claim.policy, "case": claim.case}
    of_set = {
        "plants": claim.plants.to_dict(),
        "attack": dataclasses.asdict(outcome.attack),
        "later": outcome.later is not None,
    }
    return {**of_try, **of_set, "accepted": outcome.accepted, **outcome.ratios, "finding": outcome.finding}
