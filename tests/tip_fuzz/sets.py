"""What is attacked: sets of plants and motions drawn at random, and plants of a set."""

import dataclasses
import functools
from typing import NamedTuple

import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.policies.spec import without_guest
from fuzzyarm.policies.tip_bound import _PATHS, PERIOD, TipClaim, problem_of
from fuzzyarm.proof.tip.laps import LapSet, StartBox
from fuzzyarm.proof.tip.plant import BY_JOINT, PlantSet
from fuzzyarm.proof.tip.tube import Problem

from .arm import Body, ElasticArm

JOINTS, STARTS = 2, 40
POLICIES = {
    "computed-torque-tip": 6, "fuzzy-4-tip": 6, "computed-torque": 2, "fuzzy-1": 2, "fuzzy-8-tip": 1, "fuzzy-32": 1,
    "elastic-observer": 2, "smooth-observer": 1, "shield:fuzzy-4-tip:any:4,2": 2, "ppo-robust": 1, "ppo-nominal": 1,
    "ppo-residual": 1,
}  # fmt: skip
"""Which policies are tried, and how often one for the other."""
CONSTANTS = (*((kind, joint) for kind in BY_JOINT for joint in range(JOINTS)), ("payload", 0), ("force", 0))
"""What is constant in a plant of a set, in the order of its places."""


@functools.cache
def policy_of(name):
    """Return a policy for the period of a claim, without its guest; one is as good as many, as it keeps nothing."""
    return load_policy(without_guest(name)[0], control_period=PERIOD)


def chosen(table, rng):
    """Return a key; the values say how often one for the other."""
    names = list(table)
    return names[int(rng.choice(len(names), p=np.array([*table.values()]) / sum(table.values())))]


def drawn_claim(rng):
    """Return a claim with a set of any kind, for the first control steps of a motion of any speed."""
    policy, case = chosen(POLICIES, rng), chosen({"nominal": 7, "machining": 2, "payload": 1}, rng)
    steps = chosen({2: 20, 3: 20, 5: 20, 8: 15, 12: 15, 20: 7, 40: 3}, rng)
    duration = round(float(np.exp(rng.uniform(np.log(0.8), np.log(3.0)))), 3)
    path = str(rng.choice(_PATHS))
    return TipClaim(policy, case, "fuzzed", drawn_set(rng, case), path, duration, min(steps, int(duration / PERIOD)))


def drawn_light_claim(rng):
    """Return a claim with little dry friction and wide constants on the motors, for two or three control steps."""
    policy = str(rng.choice([name for name, often in POLICIES.items() if often > 1]))
    names = rng.choice(["motor_inertia", "motor_inertia", "stiffness", "damping", "viscous_friction"], 2)
    halves = rng.uniform(0.1, 0.6, 2)
    ranges = {str(name): (1.0 - h, 1.0 + h) for name, h in zip(names, halves, strict=True)}
    least = 0.0 if rng.uniform() < 0.6 else _size(rng, 1e-3, 0.1)
    plants = PlantSet(dry_friction=(least, least), **ranges)
    return TipClaim(policy, "nominal", "fuzzed", plants, str(rng.choice(_PATHS)), steps=int(rng.integers(2, 4)))


def drawn_set(rng, case):
    """Return a set: some factors are wide, some narrow, most certain; dry friction is often light or absent."""
    ranges = {}
    for name in BY_JOINT:
        if rng.uniform() < 0.35:
            halves = _size(rng, 1e-3, 0.6 if name == "motor_inertia" else 0.2), _size(rng, 1e-3, 0.6)
            middles = np.exp(rng.normal(0.0, 0.4, 2)) if rng.uniform() < 0.2 else (1.0, 1.0)
            parts = [(m * (1.0 - h), m * (1.0 + h)) for m, h in zip(middles, halves, strict=True)]
            ranges[name] = tuple(parts) if rng.uniform() < 0.3 else parts[0]
    if rng.uniform() < 0.6:
        least = 0.0 if rng.uniform() < 0.5 else _size(rng, 1e-3, 0.5)
        ranges["dry_friction"] = (least, least * (1.0 if rng.uniform() < 0.5 else 1.0 + _size(rng, 1e-2, 1.0)))
    if rng.uniform() < 0.15:
        ranges["payload"] = tuple(sorted((_size(rng, 1e-3, 2.0), 0.0 if rng.uniform() < 0.5 else 0.5)))
    if case == "machining" and rng.uniform() < 0.5:
        ranges["force"] = (1.0 - _size(rng, 1e-2, 0.5), 1.0)
    if case == "machining" and rng.uniform() < 0.4:
        ranges["force_swing"] = _size(rng, 1e-3, 0.3)
    if rng.uniform() < 0.1:
        ranges["force_course"] = _size(rng, 1e-2, 10.0)
    if rng.uniform() < 0.1:
        ranges["noise"] = (_size(rng, 1e-7, 1e-5), _size(rng, 1e-5, 1e-3))
    ranges["friction"] = "any" if rng.uniform() < 0.1 else "law"
    ranges["late"] = int(rng.uniform() < 0.2)
    return PlantSet(**ranges)


def drawn_start(rng):
    """Return a box of starts, some of whose widths are zero."""
    largest = (1e-4, 1e-5, 1e-2, 1e-2, 1e-5)
    return StartBox(*(0.0 if rng.uniform() < 0.3 else _size(rng, 1e-4 * most, most) for most in largest))


class Later(NamedTuple):
    """The second lap of a motion that is repeated for ever, and the set in which it begins."""

    problem: Problem
    start: LapSet


def drawn_later(claim, rng):
    """Return a later lap of a claim, with a set around the end of an episode; `NoBound` where laps differ.

    The constants of the plant move the state in the set, as they do at the end of a lap.
    """
    path, policy = "circle" if claim.path == "line" else claim.path, policy_of(claim.policy)
    endless = dataclasses.replace(claim, path=path, steps=None, laps="ever", start=None)
    problem, memory = problem_of(endless, policy), None
    env, law = FuzzyArmEnv(claim.case, reference=problem.reference), problem.law
    seen, info = env.reset(seed=0)
    for _ in range(problem.schedule.steps):
        torque, memory = policy.predict(seen, memory)
        seen, *_, info = env.step(np.asarray(torque))
    start = np.concatenate([info[name] for name in ("q_motor", "q_link", "dq_motor", "dq_link")])
    held = np.asarray(torque, dtype=float) if claim.plants.late else np.zeros(0)
    numbers = len(start) + law.memory + len(held)
    box = drawn_start(rng).columns(JOINTS, numbers, law.memory)
    thin = np.diag(1e-3 * np.abs(box).sum(axis=1) + 1e-9)
    if (columns := np.hstack([box, thin])).shape[1] > STARTS:
        columns = np.diag(np.abs(columns).sum(axis=1))
    moved = rng.normal(size=(numbers, len(problem.plant.parameters))) * np.abs(columns).sum(axis=1)[:, np.newaxis]
    return Later(problem, LapSet(start, np.ravel(memory)[law.remembered], held, moved, columns))


def _size(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def schedule_of(claim):
    """Return the problem of a claim's motion with Table 1 for its set: its schedule and its start are those of all."""
    certain = TipClaim(claim.policy, claim.case, "fuzzed", PlantSet(), claim.path, claim.duration, claim.steps)
    return _problem_of(certain)


@functools.lru_cache(maxsize=64)
def _problem_of(claim):
    return problem_of(claim, policy_of(claim.policy))


@dataclasses.dataclass(frozen=True)
class Sample:
    """One plant of a set, and what varies with time beside it, as shares of what is allowed, in each control step."""

    factors: dict[str, tuple[float, float]]  # of `BY_JOINT`, one per joint
    payload: float  # beside the case's own [kg]
    force: float  # factor of the case's tip force
    friction: np.ndarray  # torque of a set with any friction, of the static one (steps, 2)
    swing: np.ndarray  # of the case's force (steps,)
    course: np.ndarray  # of the further force (steps, 2)
    noise: np.ndarray  # errors of the encoders (steps, 4)
    guest: np.ndarray  # torque of a guest in a shield (steps, 2)
    start: np.ndarray  # factors of the columns of a set of initial states, or zeros (`STARTS`,)

    def share(self, plants, kind, joint):
        """Return where a constant lies in its range, -1 to 1."""
        value = self.factors[kind][joint] if kind in BY_JOINT else float(getattr(self, kind))
        low, high = plants.of_joint(kind, joint)
        return (2.0 * value - low - high) / (high - low) if high > low else 0.0


def drawn_samples(plants, steps, count, rng, box=False):
    """Return plants of a set: the corners with all ends low and all high, other ones, and every fifth from within."""
    size = len(CONSTANTS)
    for i in range(count):
        ends = np.full(size, i) if i < 2 else rng.integers(0, 2, size)
        ends = rng.uniform(size=size) if i % 5 == 4 else ends
        yield sample_at(plants, ends, steps, rng, box)


def bred_samples(plants, best, steps, count, rng, box=False):
    """Return corners near the one whose places in the ranges are given."""
    flips = rng.uniform(size=(count, len(CONSTANTS))) < 0.25
    return [sample_at(plants, np.where(flip, 1.0 - np.round(best), np.round(best)), steps, rng, box) for flip in flips]


def sample_at(plants, places, steps, rng, box=False):
    """Return the plant whose constants lie at `places` in [0, 1] of their ranges, with random courses and corners."""
    at = iter(places.tolist())

    def value(name, joint):
        low, high = plants.of_joint(name, joint)
        return min(max(low + (high - low) * next(at), low), high)

    factors = {name: (value(name, 0), value(name, 1)) for name in BY_JOINT}
    payload, force = value("payload", 0), value("force", 0)
    courses = [rng.choice([-1.0, 1.0], (steps, 11)), np.repeat(rng.choice([-1.0, 1.0], (1, 11)), steps, axis=0)]
    friction, swing, course, noise, guest = np.split(courses[int(rng.integers(2))], [2, 3, 5, 9], axis=1)
    start = np.where(rng.uniform(size=STARTS) < 0.5, -1.0, 1.0) if box else np.zeros(STARTS)  # the first count
    return Sample(factors, payload, force, friction, swing[:, 0], course, noise, guest, start)


def arm_of(claim, sample):
    """Return the plant of a sample, with what it carries in the claim's case."""
    p = policy_of(claim.policy).parameters
    load = case_for(claim.case, p).disturbance.payload

    def scaled(name, values):
        return tuple(np.multiply(sample.factors[name], values).tolist())

    mass, inertia = scaled("mass", p.mass), scaled("mass", p.inertia)
    carried = [Body(mass[1], p.mass_center[1], inertia[1]), Body(load.mass, load.radius(p))]
    return ElasticArm(
        p.length, Body(mass[0], p.mass_center[0], inertia[0]), (*carried, Body(sample.payload, p.length[1])), p.gravity,
        scaled("motor_inertia", p.motor_inertia), scaled("viscous_friction", p.viscous_friction),
        scaled("stiffness", p.stiffness), scaled("damping", p.damping), scaled("dry_friction", p.static_friction),
        scaled("dry_friction", p.coulomb_friction), p.stribeck_velocity, claim.plants.friction == "any",
    )  # fmt: skip
