"""The tube along a motion, control step by control step, and the bound on the tip error."""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from flint import arb, arb_series, ctx

from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of
from fuzzyarm.envs.scenario.reference import PathReference
from fuzzyarm.proof.tip._between import between_samples
from fuzzyarm.proof.tip._defects import Signal, TipForces
from fuzzyarm.proof.tip.centre import Centre, Segment
from fuzzyarm.proof.tip.enclosures import BITS, ROUND_UP, SLACK, Jet, NoBound, largest, middle_of, radius_of
from fuzzyarm.proof.tip.friction_bounds import Plan, Speed, check_curve
from fuzzyarm.proof.tip.laps import LapSet, StartBox
from fuzzyarm.proof.tip.period import Closed, Period, TubeClaim
from fuzzyarm.proof.tip.plant import BallPlant, PlantSet
from fuzzyarm.proof.tip.sampled_law import Response, SampledLaw
from fuzzyarm.proof.tip.zonotope import SOURCES, Zonotope

__all__ = ["Problem", "Tube", "TubeStep", "tip_bound"]

_DIRECTIONS = 48  # of the polygon around the tip's deviations in a plane; it is at most 0.06 % larger than these
_COARSE = 6  # one direction in so many is evaluated first
_CIRCLES = 19  # circles of latitude of directions in space; the polyhedron is at most 0.4 % larger than the deviations


def tip_bound(
    state: np.ndarray, deviations: Zonotope, plant: BallPlant, wanted: list[float]
) -> tuple[float, np.ndarray]:
    """Return a bound on the tip error [m] at a sample, and its shares [m]: of each of `SOURCES`, constants, centre.

    `state` (8,) is the centre's, with the link angles q_y; `deviations` are the arm's from it; `wanted` is the tip's
    target p_r [m]. For q = q_y + δq, |p(q) - p_r| <= |p(q_y) - p_r + J δq| + |p''|/2, with p'' the second derivative
    along the straight line to q. J δq, with or without the centre's error p(q_y) - p_r, lies in a polygon or polyhedron
    whose faces have fixed directions.
    """
    physics, links = plant.physics, deviations.part(plant.layout.rows.link)
    angles, radius = [arb(x) for x in state[plant.layout.rows.link].tolist()], links.totals()
    tip = physics.tip(physics.PerJoint(*(Jet.variable(x, j) for j, x in enumerate(angles))), plant.exact)
    jacobian = np.array([[middle_of(axis.slope(j)) for j in range(len(angles))] for axis in tip])
    away = [axis.value - x for axis, x in zip(tip, wanted, strict=True)]
    offset = math.hypot(*map(largest, away)) * ROUND_UP
    units, corner = _units(physics.axes)
    middles = [middle_of(x) for x in away]
    rows, aside = units @ jacobian, np.abs(units @ middles) + math.hypot(*map(radius_of, away, middles)) * ROUND_UP
    reach, reached = _reach(links, rows, aside)
    direction = int(np.argmax(np.where(reached, reach + aside, 0.0)))
    farthest = float((reach + aside)[direction])
    widest = min(offset + float(reach.max()) * corner, (farthest + SLACK * offset + 1e-15) * corner)
    ctx.cap = 3
    boxes = (arb_series([arb(q, r), arb(0.0, r)]) for q, r in zip(angles, radius.tolist(), strict=True))
    bent = math.hypot(*(largest(axis[2]) for axis in physics.tip(physics.PerJoint(*boxes), plant.exact)))
    bent += SLACK * float(np.abs(jacobian).sum(axis=0) @ radius)  # rounding of J
    image = np.abs(rows[direction] @ links.columns)
    made = deviations.source >= 0
    shares = np.bincount(deviations.source[made], image[made], len(SOURCES))
    bound = (widest + bent) * ROUND_UP
    return bound, np.array([*shares, image[~made].sum(), aside[direction]])


@functools.cache
def _units(axes: int) -> tuple[np.ndarray, float]:
    """Return unit vectors (rows) and 1/cos α; any direction or its opposite is within the angle α of one of them."""
    if axes == 2:
        turns = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        return np.stack([np.cos(turns), np.sin(turns)], axis=1), (1.0 + 1e-12) / math.cos(0.5 * math.pi / _DIRECTIONS)
    # Circles of latitude with the spacing `apart`, and directions on each with at most this spacing: every point of the
    # half sphere is within `apart`/2 of a circle, and every point of a circle within `apart`/2 of a direction.
    apart, units = 0.5 * math.pi / (_CIRCLES - 1), list[tuple[float, float, float]]()
    for height in apart * np.arange(_CIRCLES):
        count = max(1, math.ceil(2.0 * math.pi * math.cos(height) / apart))
        turns = 2.0 * np.pi * np.arange(count) / count
        units += [(math.cos(height) * math.cos(t), math.cos(height) * math.sin(t), math.sin(height)) for t in turns]
    return np.array(units), (1.0 + 1e-12) / math.cos(apart)


def _reach(links: Zonotope, rows: np.ndarray, aside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the reach [m] of the tip's deviations in each direction (0: not evaluated), and which were evaluated.

    `rows` are directions times J, `aside` is the reach of the centre's error. In space all are evaluated. In a plane,
    let v be the farthest point of a symmetric set with reach h. Some coarse direction c (every `_COARSE`-th) is within
    α = π _COARSE/(2 _DIRECTIONS) of v, so h(c) >= |v| cos α >= h(c') cos α for all c'. Only near such c are further
    directions evaluated. This is done for two sets: the deviations without and with the centre's error.
    """
    if len(rows) != _DIRECTIONS:
        return links.size(rows), np.ones(len(rows), dtype=bool)
    coarse = np.arange(0, _DIRECTIONS, _COARSE)
    reach, reached = np.zeros(_DIRECTIONS), np.zeros(_DIRECTIONS, dtype=bool)
    reach[coarse], reached[coarse] = links.size(rows[coarse]), True
    least = (1.0 - 1e-9) * math.cos(0.5 * math.pi * _COARSE / _DIRECTIONS)
    far = [h >= least * h.max() for h in (reach[coarse], (reach + aside)[coarse])]
    around = np.add.outer(coarse[far[0] | far[1]], np.arange(-(_COARSE // 2), _COARSE // 2 + 1)) % _DIRECTIONS
    fine = np.setdiff1d(around, coarse)
    reach[fine], reached[fine] = links.size(rows[fine]), True
    return reach, reached


_FORCE, _LAW, _ROUNDING = map(SOURCES.index, ("force", "law and noise", "rounding"))


@dataclasses.dataclass(frozen=True)
class Problem:
    """The motion, the policy and the set of plants whose tip error is to be bounded."""

    parameters: AnyArm  # the policy's arm
    start: np.ndarray  # initial state (8,) of the environment: at rest, the links on the reference
    reference: PathReference  # the motion, of one lap
    schedule: Schedule  # reference, tip force and target of every control step
    period: float  # T [s]
    law: SampledLaw  # the policy, sample by sample
    plants: PlantSet  # the set
    plant: BallPlant  # its arms
    box: StartBox | None  # initial states of the first lap, about `start`; None: `start` alone
    # largest change δ (2,) [N m] of the law's torque by a guest, at every sample; the motors' limits apply afterwards
    guest: tuple[float, ...]


@dataclasses.dataclass(frozen=True)
class TubeStep:
    """One control step of the tube."""

    torque: np.ndarray  # held torque (2,) [N m] at the centre
    segments: tuple[Segment, ...]  # of the centre
    closed: tuple[Closed, ...]  # the tube on each segment
    tip: float  # bound on the tip error at the end of the step [m]
    whole: float  # bound on the tip error at every instant of the step [m]
    # share of each of `SOURCES`, then of the uncertain constants, then of the centre, in `tip` [m]
    sources: np.ndarray


@dataclasses.dataclass
class _State:
    """The state of the tube between two segments: everything on which the rest of the motion depends.

    The rows of the zonotope are the deviations, from the centre, of θ, q, θ̇, q̇, the policy's memory and, if torques act
    late, the torque that acts next. Within a control step, rows of the held torque follow those of q̇.
    """

    centre: np.ndarray  # θ, q, θ̇, q̇ of the centre (8,)
    memory: np.ndarray  # memory of the policy at the centre
    deviations: Zonotope  # all deviations from the centre
    speeds: tuple[Speed, ...]  # bounds on the motors' velocities, in addition to the zonotope
    drags: tuple[float | None, ...]  # `Closed.drags` of the previous segment [N m]
    waiting: np.ndarray | None  # torque that acts in the next control step (2,) [N m], if torques act late

    @classmethod
    def at_rest(cls, problem: Problem) -> _State:
        """Return the initial state of the tube: at rest on the reference, or the problem's box about that state."""
        joints, states = problem.plant.physics.joints, problem.plant.layout.states
        numbers = states + problem.law.memory + joints * problem.plants.late
        start = Zonotope(numbers, len(problem.plant.parameters))
        still = (Speed(0.0, 0.0),) * joints
        if problem.box is not None:
            start.add(problem.box.columns(joints, numbers, problem.law.memory), SOURCES.index("start of the lap"))
            still = (Speed(-math.inf, math.inf),) * joints
        return cls(problem.start, np.zeros(problem.law.memory), start, still, (None,) * joints, None)

    @classmethod
    def within(cls, start: LapSet) -> _State:
        """Return the initial state in a later lap, which may begin anywhere in the set `start`."""
        joints, waiting = len(start.centre) // 4, start.waiting if len(start.waiting) else None
        speeds = (Speed(-math.inf, math.inf),) * joints
        return cls(start.centre, start.memory, start.deviations(), speeds, (None,) * joints, waiting)

    @property
    def point(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The first three fields of a `LapSet`: θ, q, θ̇, q̇ (8,), memory (m,), delayed torque (2,) [N m] or (0,)."""
        return self.centre, self.memory, np.zeros(0) if self.waiting is None else self.waiting

    def around(self) -> LapSet:
        """Return a set that contains the centre plus all deviations, as the initial states of the next lap."""
        return LapSet.around(self.point, self.deviations)

    def filled(self, start: LapSet) -> float:
        """Return `LapSet.filled` for this state; at most 1 means that the state lies in the set."""
        return start.filled(self.point, self.deviations)


class Tube:
    """The tube of deviations along a motion; iterating over it yields every `TubeStep`."""

    def __init__(
        self,
        problem: Problem,
        claims: Sequence[Sequence[tuple[Segment, TubeClaim]]] | None = None,
        start: LapSet | None = None,
    ) -> None:
        """Prepare a later lap that begins in the set `start`, or (None) the problem's first lap.

        `claims` are the centre's segments in each control step, with their tubes and plans from a file, which are
        confirmed without a search. If None, tubes are searched for.
        """
        self.problem, self._claims, self._layout = problem, claims, problem.plant.layout
        self._rows, self._limits = self._layout.rows, bounds_of(problem.parameters).torque.tolist()
        self.state = _State.at_rest(problem) if start is None else _State.within(start)
        self.begin = start
        self._first = 0 if start is None else problem.schedule.steps  # sample of the law at which the lap begins
        self._tip = 0.0  # bound on the tip error at the last sample [m]
        states = range(self._layout.states)
        memory = range(states.stop, states.stop + problem.law.memory)
        self._seen = [*states[self._rows.theta], *states[self._rows.d_theta], *memory]
        self._centre = Centre(problem.plant.middle, problem.period, problem.plant.physics)

    def __iter__(self) -> Iterator[TubeStep]:
        """Yield the control steps up to the end of the motion; `NoBound` if no tube is found."""
        with ctx.workprec(BITS):
            check_curve(self.problem.plant.exact, self._layout.joints)
            self._tip, _ = self._bound(0)
        for k in range(self.problem.schedule.steps):
            with ctx.workprec(BITS):
                yield self._step(k)

    def _step(self, k: int) -> TubeStep:
        problem = self.problem
        torque = self._sample(k)
        parts: Iterable[tuple[Segment, TubeClaim | None]]
        if self._claims is None:
            force = 0.5 * sum(problem.plants.force) * problem.schedule.forces[k]
            made = self._centre.segments(self.state.centre, torque, force, self._next_drags())
            parts = ((segment, None) for segment in made)
        else:
            parts = self._claims[k]
        segments, closed, begun = list[Segment](), list[Closed](), 0.0
        for segment, claim in parts:
            segments.append(segment)
            closed.append(self._cross(segment, torque, self._force(k, begun, segment.duration), claim))
            begun += segment.duration
        if begun != problem.period:  # durations are multiples of the last bit of T, so their sum is exact
            raise NoBound(f"the segments of control step {k + 1} last {begun} s instead of {problem.period} s")
        # The rows of the held torque are removed.
        z = self.state.deviations
        states = self._layout.states
        keep = np.r_[0:states, states + self._layout.joints : len(z.box)]
        z.columns, z.box = z.columns[keep], z.box[keep]
        z.tidy(_ROUNDING)
        before, (self._tip, sources) = self._tip, self._bound(k + 1)
        begin = k * problem.period
        arc = between_samples(problem.reference, begin, problem.period, segments, closed, problem.plant)
        whole = (max(before, self._tip) + arc) * ROUND_UP
        return TubeStep(torque, tuple(segments), tuple(closed), self._tip, whole, sources)

    def _bound(self, k: int) -> tuple[float, np.ndarray]:
        wanted = self.problem.schedule.targets[k, : self._layout.axes].tolist()
        return tip_bound(self.state.centre, self.state.deviations, self.problem.plant, wanted)

    def _next_drags(self) -> list[float | None]:
        """Return for each motor the centre's constant friction torque [N m], or None if it follows the friction law."""
        if self.problem.plants.friction == "any":
            return [0.0] * self._layout.joints
        slow = (
            np.abs(self.state.centre[self._rows.d_theta]) <= 1.05 * self.state.deviations.totals()[self._rows.d_theta]
        )
        return [drag if slow[j] else None for j, drag in enumerate(self.state.drags)]

    def _force(self, k: int, begun: float, duration: float) -> TipForces:
        """Return the tip forces of a segment that begins `begun` [s] after sample k and lasts `duration` [s]."""
        plants, (mean, change) = self.problem.plants, np.split(self.problem.schedule.forces[k], 2)
        axes, (low, high) = self._layout.axes, plants.force
        still = np.zeros((axes, axes)), np.zeros(axes)
        if not (mean.any() or change.any() or plants.force_course):
            return TipForces((), (), *still)
        period = arb(self.problem.period)
        at, half = (arb(begun) + arb(duration) / 2) / period - arb(0.5), arb(duration) / period / 2
        case = [Signal([x + at * dx, half * dx]) for x, dx in zip(mean.tolist(), change.tolist(), strict=True)]
        factor = (arb(low) + arb(high)) / 2
        middle = [factor * signal for signal in case]
        varies = largest(arb(high) - factor) + plants.force_swing
        radii = [varies * signal.size() + plants.force_course for signal in case]
        if not (plants.force_swing or plants.force_course):
            return TipForces(middle, radii, *still)
        directions, wider = np.eye(axes), 1.0
        if plants.force_swing:  # the first direction is along the force; the turned box of `force_course` is wider
            along = [middle_of(signal[0]) for signal in case]
            directions, wider = np.linalg.qr(np.column_stack([along, directions]))[0].T, 1.001 * math.sqrt(axes)
        parts = (sum(map(operator.mul, unit, case), Signal([])) for unit in directions.tolist())
        courses = [plants.force_swing * part.size() + wider * plants.force_course for part in parts]
        return TipForces(middle, radii, directions, np.array(courses) * (1 + SLACK))

    def _cross(self, segment: Segment, torque: np.ndarray, force: TipForces, claim: TubeClaim | None) -> Closed:
        """Prove and return a tube on a segment, and advance the state to its end.

        The tube is that of `claim` or, if it is None, searched for. `torque` (2,) [N m] is held at the centre.
        """
        period, friction = Period(segment, torque, force, self.problem.plant), self.problem.plants.friction
        state = self.state
        self._shift(state.deviations, period.motion.at(-1), state.centre)
        start = state.deviations.part(slice(0, self._layout.states + self._layout.joints))
        if claim is None:
            closed = period.close(start, state.speeds, friction=friction)
        else:
            closed = period.confirm(start, state.speeds, claim, friction=friction)
        self._advance(start, closed)
        state.centre, state.speeds, state.drags = segment.end, closed.known, closed.drags
        self._shift(state.deviations, period.motion.at(1), state.centre)
        return closed

    def _shift(self, deviations: Zonotope, before: list[arb], after: np.ndarray) -> None:
        deviations.box[: self._layout.states] += list(map(radius_of, before, after.tolist()))

    def _sample(self, k: int) -> np.ndarray:
        """Apply the policy at t_k: add the held torque to the zonotope, update the memory, and return the torque."""
        problem, state, z = self.problem, self.state, self.state.deviations
        errors = np.repeat(problem.plants.noise, self._layout.joints)
        noise = np.zeros((len(self._seen), len(errors)))
        noise[: len(errors)] = np.diag(errors)
        noise = noise[:, errors > 0.0]
        seen = Zonotope(len(self._seen), len(problem.plant.parameters))
        seen.columns, seen.box = np.hstack([z.columns[self._seen], noise]), z.box[self._seen]
        point = np.concatenate([state.centre[self._rows.theta], state.centre[self._rows.d_theta], state.memory])
        answer = problem.law.respond(self._first + k, point, seen)
        if any(problem.guest):  # any w of this sample with |w_j| <= δ_j, and the rounding of u_f ± δ
            u, own = slice(0, self._layout.joints), np.zeros((len(answer.box), self._layout.joints))
            own[u] = np.diag(problem.guest)
            box = answer.box.copy()
            size = np.abs(answer.middle[u]) + np.abs(answer.columns[u]).sum(axis=1) + box[u] + problem.guest
            box[u] += SLACK * size
            answer = Response(answer.middle, np.hstack([answer.columns, own]), box)
        return self._held(answer)

    def _held(self, answer: Response) -> np.ndarray:
        """Add the policy's answer to the zonotope; return the held torque at the centre (2,) [N m]."""
        n, states = self._layout.joints, self._layout.states
        state, z, u = self.state, self.state.deviations, slice(0, n)
        more = answer.columns.shape[1] - z.columns.shape[1]
        columns = np.hstack([z.columns, np.zeros((len(z.box), more))])
        acting, acting_box, torque = answer.columns[u], answer.box[u], answer.middle[u]
        below, box_below = [answer.columns[n:]], [answer.box[n:]]
        if self.problem.plants.late:
            if state.waiting is not None:
                waits = slice(len(z.box) - n, len(z.box))
                acting, acting_box = columns[waits], z.box[waits]
            below.append(answer.columns[u])
            box_below.append(answer.box[u])
            torque, state.waiting = (torque if state.waiting is None else state.waiting), torque
        z.columns = np.vstack([columns[:states], acting, *below])
        z.box = np.concatenate([z.box[:states], acting_box, *box_below])
        z.source = np.concatenate([z.source, np.full(more, _LAW)])
        state.memory = answer.middle[n:]
        radius = z.totals()[states : states + n]
        # With |u_f| below a limit, the limited u_f + w is u_f + w' with |w'| <= |w|: the guest may reach the limit.
        radius -= (1.0 - SLACK) * np.array(self.problem.guest)
        for joint, limit in enumerate(self._limits):
            if not abs(torque[joint]) + radius[joint] < limit:
                raise NoBound(
                    f"motor {joint + 1} may reach its torque limit of {limit:g} N m: its torque is {torque[joint]:.4g} "
                    f"± {radius[joint]:.3g} N m"
                )
        return torque

    def _advance(self, start: Zonotope, closed: Closed) -> None:
        """Advance the deviations over a segment that begins with the zonotope `start` of ξ (state and held torque)."""
        z, solution, channels = self.state.deviations, closed.solution, self._layout.channels
        states, xi = self._layout.states, self._layout.states + self._layout.joints
        box = solution.growth @ (start.box + SLACK * start.totals())
        drive = np.abs(closed.drive.level) + np.abs(closed.drive.slope)
        box += 4.0 * SLACK * solution.push_state @ drive.sum(axis=1)
        z.columns[:states], z.box[:states] = closed.columns[:states], box[:states]
        fresh, sources = [], []
        for j, plan in enumerate(closed.plans):
            if plan is Plan.MONOTONE:  # the velocity is known only by its separate bound
                velocity = np.zeros(states)
                velocity[states // 2 + j] = closed.torques[channels.motor][j]
                z.columns[states // 2 + j], z.box[states // 2 + j] = 0.0, 0.0
                fresh.append(velocity)
                sources.append(SOURCES.index("friction"))
        sizes = z.totals()[:states] + sum(fresh, np.zeros(states))
        z.box[:states] += solution.beyond[:states] @ closed.torques
        for channel, torque in enumerate(closed.torques):
            made = solution.moments[..., channel].reshape(-1, xi)[:, :states] * torque
            total = np.abs(made).sum(axis=0)
            if (total <= 1e-4 * sizes).all():  # small contributions are added to the box
                z.box[:states] += total * ROUND_UP
            else:
                fresh += [*made]
                # The first sources are those of the channels, in order.
                sources += [min(channel // self._layout.joints, _FORCE)] * len(made)
        if fresh:
            columns = np.zeros((len(z.box), len(fresh)))
            columns[:states] = np.array(fresh).T
            z.add(columns, np.array(sources))
