"""Tubes by plans and centres that the package's search would not choose, as far as they close.

The search gives up plans that let a velocity grow by much, makes the centre from the arm in the middle of the set, and
divides a period only where a motor begins or ceases to rest. The checker asks for nothing of this: whatever a file
claims is proven if its tube closes. So everything of it is varied here, and the package's own enclosures then find the
smallest tube that closes.
"""

import contextlib
import dataclasses
import functools
import itertools
from unittest import mock

import numpy as np

from fuzzyarm.policies.tip_bound import PERIOD, problem_of
from fuzzyarm.proof.tip import tube as tube_module
from fuzzyarm.proof.tip.centre import Centre, Mode, Segment
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.friction_bounds import Plan
from fuzzyarm.proof.tip.period import Period, TubeClaim
from fuzzyarm.proof.tip.tube import Tube

from .sets import JOINTS, chosen, policy_of

PLANS = {"own": 1, "monotone": 3, "mixed": 2, "slip": 1, "any": 1, "random": 3}
CENTRES = {"own": 3, "corner": 3, "modes": 2, "shaken": 2, "aside": 2, "resting": 1, "dragged": 1}
TUBES = {"least": 3, "narrowed": 1, "swollen": 1}
DIVISIONS = {1: 4, 2: 2, 3: 1, 5: 1, 16: 1}
"""How often each is chosen for the other ones of its kind."""

MOST_PARTS = 130  # of a motion, so that a try takes seconds at most


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


def drawn_attack(rng):
    return Attack(*(chosen(table, rng) for table in (PLANS, CENTRES, TUBES, DIVISIONS)))


def drawn_fine_attack(rng):
    """Return an attack of velocities that are bounded by themselves in many short parts: little adds up beside them."""
    return Attack("monotone", str(rng.choice(["own", "corner"])), "least", chosen({8: 4, 16: 4, 64: 2}, rng))


def forged(claim, attack, rng, later=None):
    """Return the tube of the first control steps of a claim, or of a later lap, as many of them as close."""
    if claim.steps is not None and attack.division * claim.steps > MOST_PARTS:
        claim = dataclasses.replace(claim, steps=max(1, MOST_PARTS // attack.division))
    problem = later.problem if later else problem_of(claim, policy_of(claim.policy))
    found, period = [], functools.partial(_Period, attack, rng)
    unclosed = contextlib.suppress(ValueError, ZeroDivisionError, np.linalg.LinAlgError)
    with mock.patch.object(tube_module, "Period", period), unclosed:
        for step in itertools.islice(_tube(problem, attack, rng, later and later.start), claim.steps):
            claimed = [TubeClaim(closed.tube, closed.plans) for closed in step.closed]
            found.append(list(zip(step.segments, claimed, strict=True)))
    return found


def _tube(problem, attack, rng, start):
    """Return a tube with another centre."""
    tube, arm = Tube(problem, start=start), problem.plant.middle
    for constant in problem.plant.parameters if attack.centre == "corner" else ():
        if constant.kind in ("stiffness", "damping", "motor_inertia"):
            name, more = f"{constant.kind}{constant.joint + 1}", constant.half * float(rng.uniform(-1.0, 1.0))
            arm = arm._replace(**{name: getattr(arm, name) + more})
    tube._centre = _Centre(arm, problem.plant.physics, attack, rng)
    return tube


class _Centre(Centre):
    """A centre with the modes, parts and coefficients of an attack."""

    def __init__(self, arm, physics, attack, rng):
        super().__init__(arm, PERIOD, physics)
        self._attack, self._rng = attack, rng
        self._static = [own.dry_friction.static_friction for own in self._drives]

    def segments(self, state, torque, force, drags):
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

    def _spoiled(self, segment):
        """Return a segment with the coefficients and the end of an attack."""
        rng, angles, end, modes = self._rng, segment.angles.copy(), segment.end.copy(), segment.modes
        if self._attack.centre == "shaken":
            angles += 10.0 ** rng.uniform(-16.0, -8.0) * rng.normal(size=angles.shape) / 4.0 ** np.arange(8)
            end += 10.0 ** rng.uniform(-16.0, -7.0) * rng.normal(size=end.shape)
        if self._attack.centre == "aside":
            # Through zero velocity and on: a slope that a mode for the other side would not have.
            turned = 10.0 ** rng.uniform(-7.0, -3.0, JOINTS) * np.where(end[4:6] > 0.0, -1.0, 1.0)
            angles[:JOINTS, 1] += 0.5 * segment.duration * turned
            end[4:6] += turned
            if rng.uniform() < 0.3:
                modes = tuple(Mode(int(m)) for m in rng.choice([-1, 0, 1], JOINTS))
        return Segment(angles, modes, segment.duration, end)


class _Period(Period):
    """A period whose plans and tube are those of an attack."""

    def __init__(self, attack, rng, *args):
        super().__init__(*args)
        self._attack, self._rng = attack, rng

    def _check_monotone(self, *_):
        """Give nothing up: how much a velocity grows is for the search to judge."""

    def _plan(self, joint, start, known, friction):
        plans = self._attack.plans
        if friction == "any" or plans == "own":
            return super()._plan(joint, start, known, friction)
        if plans == "random":
            plans = chosen({"any": 1, "held": 1, "slip": 3, "monotone": 3, "mixed": 2}, self._rng)
        return Plan(plans)

    def close(self, start, known, *, friction):
        found = super().close(start, known, friction=friction)
        for _ in range(0 if self._attack.tube == "least" else 4):
            rows = len(found.tube)
            if self._attack.tube == "narrowed":
                factor = 1.0 - 0.03 * self._rng.uniform(size=rows)
            else:
                factor = 1.0 + self._rng.choice([0.0, 1.0], rows) * 10.0 ** self._rng.uniform(-3.0, 1.0)
            with contextlib.suppress(NoBound):
                found = self.confirm(start, known, TubeClaim(found.tube * factor, found.plans), friction=friction)
        return found
