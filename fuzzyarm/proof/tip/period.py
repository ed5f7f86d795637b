"""A claimed tube for a period, and the proof that the deviation does not leave it.

For a claimed tube ρ the remainders are bounded by w̄(ρ). Under these remainders the deviation is within

    ρ'(ρ) = max(|S ξ_h(0)|, |S ξ_h(T)|) + T²/8 sup |S ξ̈_h| + push w̄(ρ),

where ξ_h is the effect of the initial state, the held torque and the uncertain constants alone, and push bounds that of
unit remainders. If ρ'(ρ) < ρ in every row, the deviation never leaves ρ during the period: up to a first exit the
bounds would hold, so the continuous deviation would be within ρ' < ρ there. The accelerations and
`LinkRemainder.products` are not part of the state. Together they obey a <= G(a), where G is a minimum of functions
r + Q a with r, Q >= 0. Then G(ρ) < ρ implies a <= ρ; otherwise λ = max a/ρ > 1 would give a <= G(λ ρ) <= λ G(ρ) < λ ρ.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from fuzzyarm.envs.physics.dynamics import motors
from fuzzyarm.proof.tip._defects import PeriodMotion, TipForces
from fuzzyarm.proof.tip._remainders import ConstantForces, LinkRemainder
from fuzzyarm.proof.tip.centre import Mode, Segment
from fuzzyarm.proof.tip.enclosures import ROUND_UP, SLACK, NoBound, low_high
from fuzzyarm.proof.tip.friction_bounds import Friction, Plan, PlanFails, Speed
from fuzzyarm.proof.tip.plant import BallPlant
from fuzzyarm.proof.tip.transition import Linear, Transition
from fuzzyarm.proof.tip.zonotope import Zonotope, product

__all__ = ["Closed", "Period", "TubeClaim"]

_MOST_ROUNDS = 60
_MOST_DRIVEN = 0.15  # largest torque on a velocity under the plan MONOTONE, relative to the static friction
_LARGEST = 0.5  # of the tube's angles [rad]; no iteration has ever closed beyond it


@dataclasses.dataclass(frozen=True)
class Closed:
    """A period with a closed tube: the deviation is proven to stay in it."""

    tube: np.ndarray  # ρ (18,) in the order of `StateLayout.rows`
    torques: np.ndarray  # w̄ (8,) in the order of `StateLayout.channels` [N m; N]
    solution: Transition  # of the linear equation
    drive: ConstantForces  # of the uncertain constants
    columns: np.ndarray  # (10, n) of the zonotope at the end, without the torques w̄; the constants' columns first
    known: tuple[Speed, ...]  # bounds on the motors' velocities at the end
    plans: tuple[Plan, ...]  # the plan that bounds each motor's friction
    # middle of the friction torques of motors with the plan MIXED [N m], None for others
    drags: tuple[float | None, ...]


class TubeClaim(NamedTuple):
    """A file's claim for one segment: the tube's radii (18,) as in `Closed`, and the plan for each motor's friction."""

    tube: np.ndarray
    plans: tuple[Plan, ...]


class Period:
    """A control period or a part of one, in which a tube is to be proven."""

    def __init__(self, centre: Segment, torque: np.ndarray, tip: TipForces, plant: BallPlant) -> None:
        force, period = tip.middle, centre.duration
        self.motion, self.plant = PeriodMotion(centre.angles, period, plant.physics), plant
        self._layout, self._rows, self._channels = plant.layout, plant.layout.rows, plant.layout.channels
        self._centre, self._torque, self._period, self._tip = centre, torque, period, tip
        self._links = LinkRemainder(self.motion, tip, plant)
        self._lever = self._lever_spread = np.zeros((plant.physics.joints, plant.physics.axes))
        if tip.courses.any():
            self._lever, self._lever_spread = self.motion.lever_arms(tip.directions, plant.exact)
        torques = self.motion.link_torques(force, plant.exact)
        self._defect = np.array([d.size() for d in self.motion.link_defects(torques, plant.exact)])
        self._constants = ConstantForces.of(self.motion, force, plant)
        self._frictions: dict[tuple[int, Plan, Speed], Friction] = {}
        self._drives = motors(plant.middle, centre.modes)
        halves = {kind: np.array(plant.half(kind)) for kind in _PRODUCTS}
        rows = self._rows
        self._within = [(halves["stiffness"], rows.bending), (halves["damping"], rows.bending_rate)]
        self._own = [(halves["motor_inertia"], rows.motor_acceleration), (halves["viscous_friction"], rows.d_theta)]

    def confirm(self, start: Zonotope, known: tuple[Speed, ...], claim: TubeClaim, *, friction: str) -> Closed:
        """Prove the tube of `claim` under its friction plans, without a search, else raise `NoBound`.

        The other arguments and the result are as for `close`.
        """
        if friction == "any" and set(claim.plans) != {Plan.ANY}:
            raise NoBound("the set allows any friction, but a friction plan of the file assumes a friction law")
        try:
            return self._closed(start, known, list(claim.plans), claim.tube)
        except PlanFails as failed:
            raise NoBound(str(failed)) from None

    def close(self, start: Zonotope, known: tuple[Speed, ...], *, friction: str) -> Closed:
        """Search for a tube that the deviation does not leave; return the period, else raise `NoBound`.

        At first ξ is in `start`, and `known` bounds the motors' velocities; for `friction` see `PlantSet`.
        """
        plans = [self._plan(joint, start, speed, friction) for joint, speed in enumerate(known)]
        for _ in range(3 * len(plans) + 1):
            try:
                return self._closed(start, known, plans)
            except PlanFails as failed:
                certain = plans[failed.joint] in (Plan.SLIP, Plan.HELD)
                plans[failed.joint] = Plan.MONOTONE if certain else Plan.MIXED
        raise NoBound("no tube was found for any tried combination of sticking and slipping motors")

    def _plan(self, joint: int, start: Zonotope, known: Speed, friction: str) -> Plan:
        if friction == "any":
            return Plan.ANY
        mode = self._centre.modes[joint]
        if mode == Mode.REST and known == (0.0, 0.0):
            return Plan.HELD
        low, high = low_high(self.motion.velocity[joint].range())
        spread = float(start.totals()[self._rows.d_theta][joint])
        slips = mode in (Mode.FORWARD, Mode.BACKWARD) and min(abs(low), abs(high)) > 1.05 * spread and low * high > 0.0
        return Plan.SLIP if slips else Plan.MONOTONE

    def _closed(
        self, start: Zonotope, known: tuple[Speed, ...], plans: list[Plan], claimed: np.ndarray | None = None
    ) -> Closed:
        frictions = [self._friction(j, plan, speed) for j, (plan, speed) in enumerate(zip(plans, known, strict=True))]
        system = Linear.of(
            self.plant.middle, self._links.at, self._lever, np.array([f.slope for f in frictions]),
            [p is Plan.HELD for p in plans], [p is Plan.MONOTONE for p in plans], self._links.products,
        )  # fmt: skip
        driven, before = self._constants.with_friction(self.plant, frictions), start.totals()[self._rows.d_theta]
        if claimed is None and Plan.MONOTONE in plans:  # a lower bound on any tube, because it contains the start
            motors = zip(frictions, before, start.size(system.S[self._rows.net]), driven.motor, strict=True)
            least = [f.parted(v, self._period, f.driving(net, constants, 0.0)) for f, v, net, constants in motors]
            self._check_monotone(np.array(least), before, frictions)
        solution = system.over(self._period)
        columns, free = self._free(start, system, solution, driven)
        tube = free[: self._layout.row_count] * 1.01 + 1e-15 if claimed is None else claimed
        for _ in range(_MOST_ROUNDS if claimed is None else 1):
            torques = self._torques(tube, frictions, driven, before, (free, solution.push))
            reached = ((free + solution.push @ torques) * ROUND_UP)[: self._layout.row_count]
            for j, (friction, *torque) in enumerate(zip(frictions, *self._on_motors(tube, driven), strict=True)):
                if friction.plan is Plan.MONOTONE:  # its velocity is not a state; its acceleration is bounded here
                    pull = friction.pull(float(tube[self._rows.net][j]), *torque) / self._drives[j].motor_inertia
                    reached[self._rows.motor_acceleration.start + j] = pull * ROUND_UP
            if (reached < tube).all():
                if claimed is None:
                    self._check_monotone(torques[self._channels.motor], before, frictions)
                after = self._speeds(tube, frictions, driven)
                drags = tuple(f.drag if f.plan is Plan.MIXED else None for f in frictions)
                return Closed(tube, torques, solution, driven, columns, after, tuple(plans), drags)
            if claimed is not None:
                raise NoBound(f"the motion may leave the claimed tube, in row {int(np.argmax(reached - tube)) + 1}")
            if not (reached[self._rows.theta].max() < _LARGEST and reached[self._rows.link].max() < _LARGEST):
                break
            tube = np.maximum(tube, reached * 1.02 + 1e-15)
        worst = int(np.argmax(solution.push[self._rows.link].sum(axis=0) * torques))
        raise NoBound(
            f"no tube was found: as it was widened, the bound on the torque [N m] or force [N] on {self._name(worst)} "
            f"grew with it, to {torques[worst]:.3g}"
        )

    def _on_motors(self, tube: np.ndarray, driven: ConstantForces) -> tuple[np.ndarray, np.ndarray]:
        """Return two bounds (2,) [N m] on the uncertain constants' torques on each motor, for a claimed tube.

        The first covers the torques along the centre, and those of uncertain stiffness and damping times the deviation;
        the second, those of the motor's uncertain inertia and viscous friction times the deviation.
        """
        within = sum(half * tube[rows] for half, rows in self._within)
        return driven.motor + within, np.asarray(sum(half * tube[rows] for half, rows in self._own))

    def _friction(self, joint: int, plan: Plan, known: Speed) -> Friction:
        """Return the cached `Friction` of a motor under a plan; `known` bounds its velocity at the period's start."""
        key = joint, plan, known
        if key not in self._frictions:
            mode, torque = self._centre.modes[joint], float(self._torque[joint])
            self._frictions[key] = Friction(joint, plan, mode, self.motion, torque, self.plant, known)
        return self._frictions[key]

    def _check_monotone(self, after: np.ndarray, before: np.ndarray, frictions: list[Friction]) -> None:
        """Raise `PlanFails` if a MONOTONE motor's bound on |δv| rises too far from `before` to `after` (both (2,))."""
        for j, (friction, own) in enumerate(zip(frictions, self._drives, strict=True)):
            pulled = (after[j] - before[j]) * own.motor_inertia
            if (
                friction.plan is Plan.MONOTONE
                and pulled > _MOST_DRIVEN * own.dry_friction.static_friction * self._period
            ):
                raise PlanFails(j)

    def _free(
        self, start: Zonotope, system: Linear, solution: Transition, driven: ConstantForces
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns (10, k) of ξ_h at the period's end, and bounds (18 + n,) on |S ξ_h| during the period.

        `start` is the zonotope of ξ at the period's start, with k columns; `driven` has the torques due to the
        uncertain constants; S has n rows after the 18 of `StateLayout`.
        """
        S, D, b, states = system.S, system.D, system.b, slice(0, self._layout.states)
        constants, totals = driven.level.shape[1], start.totals()
        columns = product(solution.phi, start.columns)
        columns[:, :constants] += solution.held @ driven.level + solution.ramp @ driven.slope
        whole = Zonotope(len(columns), constants)
        whole.columns, whole.box = columns, solution.growth @ (start.box + SLACK * totals)
        end = whole.part(slice(None))
        own, others = np.diag(S)[states], slice(states.stop, None)  # S is diagonal on the states, see `Linear.of`
        first = start.size(S[others], D[others] @ (driven.level - driven.slope))
        last = end.size(S[others], D[others] @ (driven.level + driven.slope))
        ends = np.maximum([*(own * totals[states]), *first], [*(own * end.totals()[states]), *last])
        # ξ̈ = e^{A t} g with g = A² ξ(0) + A b a(0) + b ȧ, because a is linear in time; S is the identity on the
        # states, and the held torque is constant.
        kick = b @ driven.slope * (2.0 / self._period)
        turn = system.A @ (b @ (driven.level - driven.slope)) + kick
        bend = start.size(solution.S_A_A, S @ turn)
        sized = np.abs(S) @ system.size
        turned = SLACK * system.size @ (system.size @ totals)
        turned[states] += bend[states]
        grown = self._period * (np.abs(solution.S_A) + SLACK * np.abs(S) @ system.size) @ solution.growth @ turned
        sizes = np.abs(S) @ (system.size @ np.abs(b) @ (np.abs(driven.level) + np.abs(driven.slope)) + np.abs(kick))
        # Rounding errors of the matrix products themselves, in which terms may cancel.
        second = bend + grown + 4.0 * SLACK * (sizes.sum(axis=1) + sized @ (system.size @ totals))
        slack_of_rows = SLACK * (system.size_of_rows @ (totals + end.totals()))
        free = ends + self._period**2 / 8.0 * second + slack_of_rows
        return columns, free * ROUND_UP

    def _torques(
        self,
        tube: np.ndarray,
        frictions: list[Friction],
        driven: ConstantForces,
        before: np.ndarray,
        observed: tuple[np.ndarray, np.ndarray],
    ) -> np.ndarray:
        """Return bounds w̄ (8,) on what the linear equation omits in each channel, if the deviation is in `tube` (18,).

        `frictions` are the motors', `driven` has the torques due to the uncertain constants, and `observed` = (free,
        push) with |S ξ| <= free + push w̄. At the period's start, |δv| <= `before` (2,) [rad/s].
        """
        torques = driven.rest.copy()
        torques[self._channels.link] += self._defect
        torques[self._channels.link] += self._lever_spread @ self._tip.courses
        torques[self._channels.joint] += sum(half * tube[rows] for half, rows in self._within)
        torques[self._channels.tip] += self._tip.courses
        for j, (friction, *torque) in enumerate(zip(frictions, *self._on_motors(tube, driven), strict=True)):
            channel, net = self._channels.motor.start + j, tube[self._rows.net][j]
            if friction.plan is Plan.MONOTONE:
                torques[channel] = friction.parted(before[j], self._period, friction.driving(net, *torque))
            else:  # products within the joint have their own channel, but also act on a motor that sticks
                torques[channel] += friction.bound(tube[self._rows.d_theta][j], net, *torque)
        torques[self._channels.link] += self._links.bound(tube, torques * ROUND_UP, *observed)
        return torques * ROUND_UP

    def _speeds(self, tube: np.ndarray, frictions: list[Friction], driven: ConstantForces) -> tuple[Speed, ...]:
        """Return bounds on the motors' velocities [rad/s] at the period's end, for a claimed tube."""
        found, ends = list[Speed](), self.motion.at(1)[self._rows.d_theta]
        for j, (friction, constants, products) in enumerate(
            zip(frictions, *self._on_motors(tube, driven), strict=True)
        ):
            radius, (low, high) = float(tube[self._rows.d_theta][j]), low_high(ends[j])
            spread = float(tube[self._rows.net][j] + constants + products)
            found.append(friction.after(radius, spread, (low - radius, high + radius)))
        return tuple(found)

    def _name(self, channel: int) -> str:
        kind = next(kind for kind, places in vars(self._channels).items() if channel < places.stop)
        return f"{'tip axis' if kind == 'tip' else kind} {channel - getattr(self._channels, kind).start + 1}"


_PRODUCTS = ("stiffness", "damping", "motor_inertia", "viscous_friction")
