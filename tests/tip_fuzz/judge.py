"""One try: a set, a tube that the checker accepts, and plants of the set that should not be able to leave it."""

import contextlib
import dataclasses
import itertools
import tempfile
from pathlib import Path

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from fuzzyarm.envs.physics.dynamics import tip_position
from fuzzyarm.policies.tip_bound import PERIOD, LapClaim, TipClaim, find_bound, problem_of
from fuzzyarm.policies.tip_files import check_bound, save_bound
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.tube import Tube

from . import sets
from .forge import Attack, drawn_attack, drawn_fine_attack, forged
from .motions import even_stops, simulated
from .sets import CONSTANTS, Later, policy_of

SAMPLES, BRED = 8, 3  # plants of the first round, and of the second for each of the two closest
FINE = 5  # every how many tries the motors have little friction and the parts are short
BOXED = 7  # every how many the motion begins in a box of initial states, and as many in the set of a later lap
FINER = 4, 16  # times more sub-steps for a plant that seems to leave its tube
INSIDE = (0.05, 0.5, 0.95, 1.0)  # of a segment: where nodes of a motion are, beside those at equal distances
ROUNDING = np.repeat([1e-13, 1e-11, 1e-13, 1e-11, 1e-8, 1e-8], [4, 4, 2, 2, 2, 4])
"""What floats leave of angles, velocities, bends, their rates, net torques [N m] and accelerations, row by row."""
TIP_ROUNDING = 1e-13  # [m]
RELATIVE = 1e-6
RATIOS = ("tip", "tube", "column")
"""Of tip errors to their bounds, of deviations to the tube over all rows, and of what columns leave, at the samples."""


@dataclasses.dataclass
class Outcome:
    """What came of a try; the ratios are the largest ones of simulated plants to what is claimed."""

    seed: int
    number: int
    claim: TipClaim  # for the steps that were accepted
    attack: Attack
    later: Later | None = None  # what is attacked in place of the first lap
    accepted: int = 0  # control steps that the checker accepts
    ratios: dict[str, float] = dataclasses.field(default_factory=lambda: dict.fromkeys(RATIOS, 0.0))
    finding: str = ""  # what is wrong


def tried(seed, number):
    rng = np.random.default_rng([seed, number])
    if number % FINE == FINE - 1:
        claim, attack = sets.drawn_light_claim(rng), drawn_fine_attack(rng)
    else:
        claim, attack = sets.drawn_claim(rng), drawn_attack(rng)
    if number % BOXED == 2:
        claim = dataclasses.replace(claim, start=sets.drawn_start(np.random.default_rng([seed, number, 1])))
    outcome = Outcome(seed, number, claim, attack)
    if number % BOXED == 5:
        with contextlib.suppress(NoBound):  # laps of some laws differ
            outcome.later = sets.drawn_later(claim, np.random.default_rng([seed, number, 1]))
    return attacked(outcome, rng)


def attacked(outcome, rng):
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
    courses = any([plants.force_swing, plants.force_course, *plants.noise, *problem.guest])
    # Whether the set has more than one motion.
    several = problem.plant.parameters or courses or plants.friction == "any" or box
    samples = [*sets.drawn_samples(claim.plants, len(accepted), SAMPLES if several else 1, rng, box)]
    closest = _judge(outcome, problem, accepted, samples)
    for sample in closest if problem.plant.parameters else []:
        places = np.array([0.5 + 0.5 * sample.share(claim.plants, *constant) for constant in CONSTANTS])
        bred = sets.bred_samples(claim.plants, places, len(accepted), BRED, rng, box)
        _judge(outcome, problem, accepted, bred)
    if outcome.finding:
        _confirm(outcome, claims[: len(accepted)])
    return outcome


def _accepted(problem, claims, later):
    """Return accepted steps, columns (8, n) of the constants at their ends, and how far all else reaches there."""
    found = []
    tube, count = Tube(problem, claims, later and later.start), len(problem.plant.parameters)
    with contextlib.suppress(NoBound):  # what closed in the search may be left by a digit when it is confirmed
        for step in itertools.islice(tube, len(claims)):
            columns, box = tube.state.deviations.columns[:8], tube.state.deviations.box[:8]
            others = np.abs(columns[:, count:]).sum(axis=1) + box
            found.append((step, columns[:, :count].copy(), others))
    return found


def _judge(outcome, problem, accepted, samples):
    """Compare plants with a tube: note the ratios and what leaves it; return the plants that come closest."""
    claim, stops = outcome.claim, _stops(accepted)
    try:
        motions = simulated(claim, samples, stops, later=outcome.later)
    except (OverflowError, RuntimeError) as error:  # a solution in a tube is bounded, and its motors do not chatter
        outcome.finding = f"the simulation fails: {error}"
        return []
    found = [_ratios(problem, accepted, *pair) for pair in zip(samples, motions, strict=True)]
    for i, sample in enumerate(samples):
        worth = found[i]["tip"] > max(1.0, outcome.ratios["tip"]) if outcome.finding else max(found[i].values()) > 1.0
        if worth:
            finer, found[i] = (
                _ratios(problem, accepted, sample, simulated(claim, [sample], stops, refined, outcome.later)[0])
                for refined in FINER
            )
            # The error of RK4 falls by a factor of 4^4 from one to the next: what both differ by bounds the last one's.
            said = [name for name, ratio in found[i].items() if ratio > 1.0 + RELATIVE + abs(ratio - finer[name])]
            if said and (not outcome.finding or found[i]["tip"] > max(1.0, outcome.ratios["tip"])):
                numbers = ", ".join(f"{name} {found[i][name]:.6g}" for name in said)
                factors = {name: value for name, value in sample.factors.items() if value != (1.0, 1.0)}
                outcome.finding = f"exceeded: {numbers}, by plant {factors}, "
                outcome.finding += f"payload {sample.payload:.6g} kg, force {sample.force:.6g}"
        outcome.ratios = {name: max(ratio, found[i][name]) for name, ratio in outcome.ratios.items()}
    return [samples[int(np.argmax([ratios[name] for ratios in found]))] for name in ("tip", "tube")]


def _stops(accepted):
    """Return the times of nodes in each control step: equally distant ones, and some of each segment."""
    found = []
    for (step, _, _), even in zip(accepted, even_stops(len(accepted)), strict=True):
        begun, times = 0.0, set(even)
        for segment in step.segments:
            times |= {begun + share * segment.duration for share in INSIDE}
            begun += segment.duration
        found.append(sorted(t for t in times if t <= PERIOD))
    return found


def _ratios(problem, accepted, sample, motion):
    """Return the largest ratios of a motion to the tip's bounds, to the tube, and to what the columns leave."""
    plants, parameters = problem.plants, problem.plant.parameters
    place = np.array([sample.share(plants, p.kind, p.joint) for p in parameters])
    tube = column = between = 0.0
    for k, (step, columns, others) in enumerate(accepted):
        left = np.abs(np.array(motion.nodes[k][-1].state) - step.segments[-1].end - columns @ place)
        column = max(column, ((left - ROUNDING[:8]) / others).max(initial=0.0, where=others > 0.0))
        tube = max(tube, _tube_ratio(problem, step, motion, k))
        between = max(between, _between_ratio(problem, step, motion, k))
    bounds = np.array([step.tip for step, *_ in accepted])
    tip = max(between, float(((motion.tip_errors - TIP_ROUNDING) / bounds).max()))
    return {"tip": tip, "tube": tube, "column": column}


def _between_ratio(problem, step, motion, k):
    """Return the largest ratio of a tip error at a node of a control step to the bound at every instant of it."""
    states = np.array([node.state for node in motion.nodes[k]])
    wanted = problem.reference.tip(k * PERIOD + np.array([node.time for node in motion.nodes[k]])).position
    tips = tip_position(states[:, 2:4], problem.parameters.length)
    return float((np.linalg.norm(tips - wanted, axis=1).max() - TIP_ROUNDING) / step.whole)


def _tube_ratio(problem, step, motion, k):
    """Return the largest ratio of a deviation to the tube in a control step, over all nodes and rows."""
    arm, nodes, largest, begun = problem.plant.middle, motion.nodes[k], 0.0, 0.0
    times = np.array([node.time for node in nodes])
    states, rates = np.array([node.state for node in nodes]), np.array([node.rates for node in nodes])
    K, B, viscous = (
        np.array([[getattr(arm, f"{name}1")], [getattr(arm, f"{name}2")]])
        for name in ("stiffness", "damping", "viscous")
    )
    held = (motion.torques[k] - step.torque)[:, np.newaxis]
    for segment, closed in zip(step.segments, step.closed, strict=True):
        inside = (times >= begun) & (times <= begun + segment.duration)
        s, rate = 2.0 * (times[inside] - begun) / segment.duration - 1.0, 2.0 / segment.duration
        values, slopes, bends = (polyval(s, polyder(segment.angles.T, m)) * rate**m for m in range(3))
        deviation = states[inside].T - np.vstack([values, slopes])
        bend, bend_rate = deviation[:2] - deviation[2:4], deviation[4:6] - deviation[6:8]
        net = held - K * bend - B * bend_rate - viscous * deviation[4:6]
        rows = np.abs(np.vstack([deviation, bend, bend_rate, net, rates[inside].T[4:] - bends]))
        excess = (rows.max(axis=1, initial=0.0) - ROUNDING) / closed.tube
        largest, begun = max(largest, float(excess.max())), begun + segment.duration
    return largest


def _confirm(outcome, claims):
    """Ask the public checker for its word on a finding, by a file: only what it accepts is one; a lap is no file."""
    if outcome.later:
        outcome.finding += "; in a later lap"
        return
    try:
        bound = find_bound(outcome.claim, claims=[LapClaim(claims)], policy=policy_of(outcome.claim.policy))
    except NoBound as error:
        outcome.finding = f"harness: the tube is not accepted again: {error}"
        return
    with tempfile.NamedTemporaryFile(suffix=".json") as file:
        save_bound(bound, Path(file.name))
        checked = check_bound(Path(file.name))
    word = "PROVEN" if checked.proven else f"not proven, {checked.reason}"
    outcome.finding += f"; the checker says {word}: {checked.sentence}"


def row(outcome):
    claim = outcome.claim
    found = {name: getattr(outcome, name) for name in ("seed", "number", "accepted", "finding")} | outcome.ratios
    found |= {"policy": claim.policy, "case": claim.case, "plants": claim.plants.to_dict()}
    return found | {"attack": dataclasses.asdict(outcome.attack), "later": outcome.later is not None}
