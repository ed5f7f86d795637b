"""Output feedback on the elastic arm: an observer of the unmeasured links, and state feedback to the elastic target.

Every policy measures only the motors, y = (θ, θ̇) with noise. The observer estimates x = (θ, q, θ̇, q̇), motors
and links, and an unknown torque d on the links (a tip force, a payload), modelled as a random walk:

    correct   (x̂, d̂) = (x̂, d̂)⁻ + L (y - (θ̂, θ̂̇)⁻),
    act       u = u_ff - d̂ - K (x̂ - x_d),      x_d = (θ_d - K_t⁻¹ d̂, q_d, θ̇_d, q̇_d),
    predict   (x̂, d̂)⁻ = the step of the nominal elastic arm, with friction and sticking, from (x̂, d̂) under u.

θ_d and u_ff are those of `elastic_target`; K_t⁻¹ d̂ is the bending that the joints need not provide because d̂ supports
the links. The prediction uses the clipped torque, which the motors apply, so there is no windup at a limit.

`SmoothObserverPolicy` predicts with the dry friction at θ̇_d instead of the estimated velocity:

    predict   (x̂, d̂)⁻ = the step of the nominal elastic arm without dry friction under u - μ(|θ̇_d|) sign θ̇_d.

It has no sticking, hence no branches, so its motions over a set of arms can be enclosed.

K and L are tabulated by `observer_gains` over the angles of `gain_schedule` and interpolated. d̂ provides the integral
action: a constant torque on the links leaves no error at the tip.
"""

from __future__ import annotations

import copy
import functools
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.friction import dry_friction_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.fuzzy_policy.known_arm import numbers_of, without_dry_friction
from fuzzyarm.fuzzy_policy.law import Law, LawPolicy, within
from fuzzyarm.fuzzy_policy.laws import observer_gains
from fuzzyarm.fuzzy_policy.laws._elastic_target import (
    ElasticTarget,
    Past,
    TargetConstants,
    dry_friction_ahead,
    past_of,
    target_of,
)  # fmt: skip
from fuzzyarm.fuzzy_policy.laws._gain_schedule import corners_of, on_table
from fuzzyarm.fuzzy_policy.laws.observer_gains import Estimate, ObserverWeights, estimate_parts
from fuzzyarm.numbers.functions import flat, like, repeat, when

__all__ = ["Constants", "ElasticObserverPolicy", "Observed", "SmoothObserverPolicy", "steps_of"]

_STATICS_STEPS = 20  # fixed-point iterations for the first estimate; for Table 1 each iteration adds three digits


class ElasticObserverPolicy(LawPolicy):
    """Observer, state feedback and elastic target; the law is in the module's docstring.

    The memory is an `Observed`. `feedback` and `observer` are K (points, n, 4 n) and L (points, 5 n, 2 n) at the
    points of the schedule.
    """

    _smooth = False  # whether the prediction is without dry friction

    def __init__(
        self, parameters: AnyArm | None = None, control_period: float = 1e-3, weights: ObserverWeights | None = None
    ) -> None:
        """Design the gains for the arm as the controller knows it (default Table 1) and T [s], at most 0.1 s.

        By default the weights of the Riccati equations are those of `observer_gains.weights_for`. ValueError if the
        control period is out of range, or there are no gains for these arguments.
        """
        super().__init__(ArmParameters() if parameters is None else parameters, control_period)
        self.weights = weights or observer_gains.weights_for(self.parameters, self.control_period)
        self._substeps = default_substeps(self.control_period, fastest_rate([self.parameters]))
        tables = observer_gains.gain_tables(self.parameters, self.control_period, self.weights)
        self._schedule, self.feedback, self.observer = tables
        before = len(flat(past_of(self.joints))) + 1  # the target's memory, and the flag of the first sample
        self._predicted = slice(before, before + estimate_parts(self.joints).load.stop)
        self.memory_size = self._predicted.stop
        self._know(self.parameters)

    def without_dry_friction(self) -> ElasticObserverPolicy:
        """Return this policy, with the same gains, for the same arm without dry friction."""
        smooth = copy.copy(self)
        smooth._know(without_dry_friction(self.parameters))
        return smooth

    def estimate(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x̂ (..., 4 n) [rad, rad/s] and d̂ (..., n) [N m] for the next sample, from a state of `predict`."""
        predicted, part = np.asarray(state)[..., self._predicted], estimate_parts(self.joints)
        return predicted[..., part.state], predicted[..., part.load]

    @functools.cached_property
    def control_law(self) -> Law:
        """The observer's law; its memory is an `Observed`."""
        memory = Observed(past_of(self.joints), 0.0, Estimate(*[(0.0,) * self.joints] * len(Estimate._fields)))
        tables = tuple(gains.reshape(len(gains), -1) for gains in (self.feedback, self.observer))
        smooth_arm = numbers_of(without_dry_friction(self.parameters))[0]
        given = (self._numbers, smooth_arm) if self._smooth else self._numbers
        return Law(_law_of(self._smooth, *self.where), memory, given, tables, told=True)

    @property
    def where(self) -> tuple[Physics, tuple[int, ...], bool, int]:
        """The arguments of `steps_of`: the arm's equations, and `kept`, `cosine` and `points` of its `GainSchedule`."""
        return equations_of(self.parameters), *self._schedule[:3]

    def _know(self, parameters: AnyArm) -> None:
        """Use the arm `parameters` for the prediction, with the same gains."""
        self.parameters = parameters
        self._target = ElasticTarget(parameters, self.control_period)
        limit, substep = tuple(map(float, self.torque_limit)), self.control_period / self._substeps
        self._numbers = Constants(self._target.constants, limit, substep, float(self._substeps))


class SmoothObserverPolicy(ElasticObserverPolicy):
    """The elastic observer whose prediction has no sticking, see the module's docstring; same arguments and memory."""

    _smooth = True


class Observed(NamedTuple):
    """The memory: the target's memory, a flag that is 1 after the first sample, and the prediction (x̂, d̂)⁻."""

    past: Past
    started: Any
    predicted: Estimate


class Constants(NamedTuple):
    """Constants of the target, torque limits [N m], and length `h` [s] and number of the prediction's sub-steps."""

    target: TargetConstants
    limit: Any
    h: Any
    substeps: Any


class _Corrected(NamedTuple):
    """A sample after correction: estimate (x̂, d̂), innovation ν, u_ff, and the target's memory and `Aim`.

    `corners` are rows of K's table and their weights.
    """

    past: Past
    aim: Any
    u_ff: Any
    x: Estimate
    innovation: Any
    corners: Any


@functools.cache
def steps_of(physics: Physics, kept: tuple[int, ...], cosine: bool, points: int) -> tuple[Any, Any, Any]:
    """Return the functions correct, act and predict for arms with these equations; see `GainSchedule` for the rest.

    ``correct(memory, seen, c, observer)`` corrects (x̂, d̂)⁻ by the `Observation` `seen` and returns a `_Corrected`.
    ``act(found, seen, c, feedback)`` returns u = u_ff - d̂ - K (x̂ - x_d) [N m] for a `_Corrected` and `Constants`.
    ``predict(x, applied, c, arm)`` returns (x̂, d̂)⁻ of the next sample, for the arm under the applied torques.
    """
    target, PerJoint, State, n = target_of(physics), physics.PerJoint, physics.State, physics.joints

    def correct(memory: Observed, seen: Observation, c: Constants, observer: Any) -> _Corrected:
        past, aim, u_ff = target(memory.past, seen, c.target)
        arm, stiffness = c.target.arm, c.target.drives.stiffness

        def begin() -> Estimate:
            """Return the first estimate: K_t (θ - q) = g(q) for the measured θ, links as fast as motors, and d = 0."""

            def nearer(link: Any) -> Any:
                weight = physics.gravity(PerJoint(*link), arm)
                return tuple(q - g / k for q, g, k in zip(seen.q_motor, weight, stiffness, strict=True))

            link = repeat(_STATICS_STEPS, nearer, tuple(seen.q_motor))
            q, dq = tuple(seen.q_motor), tuple(seen.dq_motor)
            return Estimate(q, link, dq, dq, (0.0,) * n)

        x = when(memory.started == 0.0, begin, memory.predicted)
        corners = corners_of(seen.q_motor, kept, cosine, points)
        measured, predicted = (*seen.q_motor, *seen.dq_motor), (*x.q_motor, *x.dq_motor)
        innovation = [y - z for y, z in zip(measured, predicted, strict=True)]
        x = like(x, iter(on_table(observer, corners, 1.0, innovation, flat(x))))
        return _Corrected(past, aim, u_ff, x, innovation, corners)

    def act(found: _Corrected, seen: Observation, c: Constants, feedback: Any) -> list[Any]:
        x, aim = found.x, found.aim
        unbent = [d / k for d, k in zip(x.load, c.target.drives.stiffness, strict=True)]
        error = [
            *(a - (b - d) for a, b, d in zip(x.q_motor, aim.q, unbent, strict=True)),
            *(a - b for a, b in zip(x.q_link, seen.q_reference, strict=True)),
            *(a - b for a, b in zip(x.dq_motor, aim.dq, strict=True)),
            *(a - b for a, b in zip(x.dq_link, seen.dq_reference, strict=True)),
        ]
        unloaded = [u - d for u, d in zip(found.u_ff, x.load, strict=True)]
        return on_table(feedback, found.corners, -1.0, error, unloaded)

    def predict(x: Estimate, applied: Any, c: Constants, arm: Any) -> Estimate:
        held, load = PerJoint(*applied), PerJoint(*x.load)
        state = State(*(PerJoint(*part) for part in x[: len(State._fields)]))
        state = repeat(c.substeps, lambda now: physics.loaded_step(now, held, load, arm, c.h), state)
        return Estimate(*(tuple(part) for part in (*state, x.load)))

    return correct, act, predict


@functools.cache
def _law_of(smooth: bool, physics: Physics, kept: tuple[int, ...], cosine: bool, points: int) -> Any:
    correct, act, predict = steps_of(physics, kept, cosine, points)

    def observer_law(
        memory: Observed, seen: Observation, given: Any, feedback: Any, observer: Any, admit: Any = None
    ) -> tuple[Observed, Any]:
        c, arm = given if smooth else (given, given.target.arm)
        found, dry = correct(memory, seen, c, observer), c.target.drives.dry_friction
        torque = act(found, seen, c, feedback)
        applied = within(physics.PerJoint(*torque), c.limit) if admit is None else admit(torque)
        if smooth:
            applied = [
                u - dry_friction_ahead(v, a, dry_friction_of(dry, j), c.target)
                for j, (u, v, a) in enumerate(zip(applied, found.aim.dq, found.aim.ddq, strict=True))
            ]
        return Observed(found.past, 1.0, predict(found.x, applied, c, arm)), torque

    return observer_law
