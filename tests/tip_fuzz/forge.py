"""Tubes by plans and centres that the package's search would not choose, as far as they close.

The search gives up plans that let a velocity grow by much, makes the centre from the arm in the middle of the set, and
divides a period only where a motor begins or ceases to rest. The checker asks for nothing of this: whatever a file
claims is proven if its tube closes. So everything of it is varied here, and the package's own enclosures then find the
smallest tube that closes.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import Any
from unittest import mock

import numpy as np

from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.policies.tip_bound import PERIOD, TipClaim, problem_of
from fuzzyarm.proof.tip import tube as tube_module
from fuzzyarm.proof.tip.centre import Centre, Mode, Segment
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.friction_bounds import Plan, Speed
from fuzzyarm.proof.tip.laps import LapSet
from fuzzyarm.proof.tip.period import Closed, Period, TubeClaim
from fuzzyarm.proof.tip.tube import Problem, Tube
from fuzzyarm.proof.tip.zonotope import Zonotope

from .sets import JOINTS, Later, policy_of

PLANS = {"own": 1, "monotone": 3, "mixed": 2, "slip": 1, "any": 1, "random": 3}
CENTRES = {"own": 3, "corner": 3, "modes": 2, "shaken": 2, "aside": 2, "resting": 1, "dragged": 1}
TUBES = {"least": 3, "narrowed": 1, "swollen": 1}
DIVISIONS = {1: 4, 2: 2, 3: 1, 5: 1, 16: 1}
"""How often each is chosen for the other ones of its kind."""

MOST_PARTS = 130  # of a motion, so that a try takes seconds at most

Claims = list[list[tuple[Segment, TubeClaim]]]


@dataclasses.dataclass(frozen=True)
class Attack:
    """How a tube is made.

    A centre is "own": of the search; "corner": of another plant of the set; "modes": with modes at random; "shaken":
    with other coefficients; "aside": a little on the wrong side of zero velocity; "resting": with motors that rest;
    "dragged": with a constant friction. A tube is "least": the smallest that closes; "narrowed": cut until it is left;
    "swollen": wider in some rows.
    """

    plans: str  # of the frictions; "own": those of the search
    centre: str
    tube: str
    division: int  # how many parts at random a control step has


def drawn_attack(rng: np.random.Generator) -> Attack:
    """Return an attack."""

    def chosen(table: dict[Any, int]) -> Any:
        names = list(table)
        return names[int(rng.choice(len(names), p=np.array([*table.values()]) / sum(table.values())))]

    return Attack(chosen(PLANS), chosen(CENTRES), chosen(TUBES), chosen(DIVISIONS))


def drawn_fine_attack(rng: np.random.Generator) -> Attack:
    """Return an attack of velocities that are bounded by themselves in many short parts: little adds up beside them."""
    return Attack(
        "monotone", str(rng.choice(["own", "corner"])), "least", int(rng.choice([8, 16, 64], p=[0.4, 0.4, 0.2]))
    )


def forged(claim: TipClaim, attack: Attack, rng: np.random.Generator, later: Later | None = None) -> Claims:
    """Return the tube of the first control steps of a claim, or of a later lap, as many of them as close."""
    if claim.steps is not None and attack.division * claim.steps > MOST_PARTS:
        claim = dataclasses.replace(claim, steps=max(1, MOST_PARTS // attack.division))
    problem = later.problem if later else problem_of(claim, policy_of(claim.policy))
    found: Claims = []

    def period(*args: Any) -> Period:
        return _Period(attack, rng, *args)

    with mock.patch.object(tube_module, "Period", period):
        try:
            for step in itertools.islice(_Tube(problem, attack, rng, later and later.start), claim.steps):
                claimed = [TubeClaim(closed.tube, closed.plans) for closed in step.closed]
                found.append(list(zip(step.segments, claimed, strict=True)))
        except (ValueError, ZeroDivisionError, np.linalg.LinAlgError):
            pass
    return found


class _Tube(Tube):
    """A tube with another centre."""

    def __init__(self, problem: Problem, attack: Attack, rng: np.random.Generator, start: LapSet | None) -> None:
        super().__init__(problem, start=start)
        arm = problem.plant.middle
        if attack.centre == "corner":
            moved = {
                f"{parameter.kind}{parameter.joint + 1}": parameter.half * float(rng.uniform(-1.0, 1.0))
                for parameter in problem.plant.parameters
                if parameter.kind in ("stiffness", "damping", "motor_inertia")
            }
            arm = arm._replace(**{name: getattr(arm, name) + more for name, more in moved.items()})
        self._centre = _Centre(arm, problem.plant.physics, attack, rng)


class _Centre(Centre):
    """A centre with the modes, parts and coefficients of an attack."""

    def __init__(self, arm: Any, physics: Physics, attack: Attack, rng: np.random.Generator) -> None:
        super().__init__(arm, PERIOD, physics)
        self._attack, self._rng = attack, rng
        self._static = [own.dry_friction.static_friction for own in self._drives]

    def segments(
        self, state: np.ndarray, torque: np.ndarray, force: np.ndarray, drags: Sequence[float | None]
    ) -> Iterator[Segment]:
        attack, rng = self._attack, self._rng
        if attack.division == 1 and attack.centre in ("own", "corner", "shaken", "aside"):
            for segment in super().segments(state, torque, force, drags):
                yield self._spoiled(segment)
            return
        grains = round(PERIOD / self._grain)
        cuts = sorted({*rng.integers(1, grains, attack.division - 1).tolist(), 0, grains})
        for first, last in itertools.pairwise(cuts):
            begun, part = first * self._grain, (last - first) * self._grain
            modes, pulls = self._modes(state, torque, drags), torque + [drag or 0.0 for drag in drags]
            if attack.centre == "modes":
                modes = tuple(Mode(int(m)) for m in rng.choice([-1, 0, 1, 2], JOINTS))
            elif attack.centre == "resting":
                modes = (Mode.REST,) * JOINTS
            elif attack.centre == "dragged":
                modes, pulls = (Mode.FREE,) * JOINTS, torque + rng.normal(0.0, 0.3, JOINTS) * self._static
            at = (begun + 0.5 * part) / PERIOD - 0.5
            line = np.concatenate([force[:2] + at * force[2:], force[2:] * (part / PERIOD)])
            segment = self._spoiled(self._solved(state, pulls, line, modes, part))
            yield segment
            state = segment.end

    def _spoiled(self, segment: Segment) -> Segment:
        """Return a segment with the coefficients and the end of an attack."""
        rng, angles, end = self._rng, segment.angles.copy(), segment.end.copy()
        if self._attack.centre == "shaken":
            angles += 10.0 ** rng.uniform(-16.0, -8.0) * rng.normal(size=angles.shape) / 4.0 ** np.arange(8)
            end += 10.0 ** rng.uniform(-16.0, -7.0) * rng.normal(size=end.shape)
        if self._attack.centre == "aside":
            # Through zero velocity and on: a slope that a mode for the other side would not have.
            turned = 10.0 ** rng.uniform(-7.0, -3.0, JOINTS) * np.where(end[4:6] > 0.0, -1.0, 1.0)
            angles[:JOINTS, 1] += 0.5 * segment.duration * turned
            end[4:6] += turned
        modes = segment.modes
        if self._attack.centre == "aside" and rng.uniform() < 0.3:
            modes = tuple(Mode(int(m)) for m in rng.choice([-1, 0, 1], JOINTS))
        return Segment(angles, modes, segment.duration, end)


class _Period(Period):
    """A period whose plans and tube are those of an attack."""

    def __init__(self, attack: Attack, rng: np.random.Generator, *args: Any) -> None:
        super().__init__(*args)
        self._attack, self._rng = attack, rng

    def _check_monotone(self, *_: Any) -> None:
        """Give nothing up: how much a velocity grows is for the search to judge."""

    def _plan(self, joint: int, start: Zonotope, known: Speed, friction: str) -> Plan:
        plans = self._attack.plans
        if friction == "any" or plans == "own":
            return super()._plan(joint, start, known, friction)
        if plans == "random":
            return Plan(
                str(self._rng.choice(["any", "held", "slip", "monotone", "mixed"], p=[0.1, 0.1, 0.3, 0.3, 0.2]))
            )
        return Plan(plans)

    def close(self, start: Zonotope, known: tuple[Speed, ...], *, friction: str) -> Closed:
        found = super().close(start, known, friction=friction)
        for _ in range(0 if self._attack.tube == "least" else 4):
            factor = np.ones(len(found.tube))
            if self._attack.tube == "narrowed":
                factor -= 0.03 * self._rng.uniform(size=len(factor))
            else:
                factor += self._rng.choice([0.0, 1.0], len(factor)) * 10.0 ** self._rng.uniform(-3.0, 1.0)
            try:
                found = self.confirm(start, known, TubeClaim(found.tube * factor, found.plans), friction=friction)
            except NoBound:
                continue
        return found
