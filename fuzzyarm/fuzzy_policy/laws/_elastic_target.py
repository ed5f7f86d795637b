"""The motor angles that put the tip on the reference, from the observation alone.

Links on the reference q_d need the torque τ_d = M_b(q_d) q̈_d + C(q_d, q̇_d) q̇_d + g(q_d) of the joints. With their
stiffness K_t and damping B_t it bends them by δ = θ_d - q_d,

    B_t δ̇ + K_t δ = τ_d,    so, with b = B_t/K_t,    δ = (τ_d - b τ̇_d + b² τ̈_d - ...)/K_t.

τ_d follows from the reference in the observation; its derivatives are backward differences over the last three
control periods. (`envs.scenario.elastic_reference` solves the same equation exactly for a reference known beforehand.)
The feedforward that moves the motors (inertia I_a, viscous friction f_v, dry friction F) along θ_d is

    u_ff = I_a θ̈_d + f_v θ̇_d + F(θ̇_d) sign θ̇_d + τ_d,

by default at t_k + T/2 instead of t_k: the mean over the next hold, extrapolated from the last two samples.
"""

import functools
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.checks import real
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.elementwise import sign
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.friction import dry_friction_of, stribeck_magnitude
from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.fuzzy_policy.known_arm import Drives, numbers_of
from fuzzyarm.fuzzy_policy.law import seen_by
from fuzzyarm.numbers.functions import flat, select
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

__all__ = ["Aim", "ElasticTarget", "Past", "TargetConstants", "motor_target", "past_of", "target_of"]


class Past(NamedTuple):
    """The memory of `ElasticTarget` from one sample to the next."""

    started: Any  # 1 once there has been a sample, else 0
    latest: Any  # τ_d of the last sample [N m]
    second: Any  # τ_d of the sample before that
    third: Any  # τ_d of the sample before that
    smooth: Any  # u_ff of the last sample, without dry friction [N m]


class Aim(NamedTuple):
    """The motors' target: angle θ_d [rad], velocity θ̇_d [rad/s] and acceleration θ̈_d [rad/s²], joint by joint."""

    q: Any
    dq: Any
    ddq: Any


class TargetConstants(NamedTuple):
    """The constants of the target: links, motors, and control period T [s].

    `friction` is 1 if u_ff includes dry friction, else 0. u_ff is that of `ahead` periods after the sample.
    """

    arm: Any
    drives: Drives
    period: Any
    friction: Any
    ahead: Any


def past_of(joints: int) -> Past:
    """Return the memory of `ElasticTarget`, for a number of joints, before the first sample."""
    return Past(0.0, *[(0.0,) * joints] * 4)


def motor_target(torques: Any, q: Any, dq: Any, ddq: Any, drive: Any, T: Any) -> tuple[Any, Any, Any, Any]:
    """Return one motor's θ_d, θ̇_d, θ̈_d and u_ff [N m] without dry friction, for q_d [rad] and its derivatives.

    `torques` has τ_d [N m] of this sample and of the three before it, the latest first; `drive` is the `Drives` of the
    joint, and T [s] is the control period.
    """
    now, latest, second, third = torques
    k, b = drive.stiffness, drive.damping / drive.stiffness
    # Backward differences of third order for τ̇_d and of second order for τ̈_d.
    rate = (11.0 * now - 18.0 * latest + 9.0 * second - 2.0 * third) / (6.0 * T)
    curvature = (2.0 * now - 5.0 * latest + 4.0 * second - third) / (T * T)
    velocity, acceleration = dq + (rate - b * curvature) / k, ddq + curvature / k
    smooth = drive.motor_inertia * acceleration + drive.viscous_friction * velocity + now
    return q + (now - b * (rate - b * curvature)) / k, velocity, acceleration, smooth


def dry_friction_ahead(velocity: Any, acceleration: Any, dry: Any, c: TargetConstants) -> Any:
    """Return a motor's dry friction [N m] after `c.ahead` periods, given its motion now and the parameters `dry`."""
    middle = velocity + c.ahead * c.period * acceleration
    return stribeck_magnitude(middle, dry) * sign(middle)


@functools.cache
def target_of(physics: Physics) -> Any:
    """Return ``target(past, seen, constants)`` for these equations: it finds the next `Past`, `Aim` and u_ff [N m]."""

    def target(past: Past, seen: Observation, c: TargetConstants) -> tuple[Past, Aim, tuple[Any, ...]]:
        torque = physics.inverse_dynamics(seen.q_reference, seen.dq_reference, seen.ddq_reference, c.arm)
        d, T, found = c.drives, c.period, []
        for j, now in enumerate(torque):
            drive = Drives._make((*(part[j] for part in d[:-1]), dry_friction_of(d.dry_friction, j)))
            begins = past.started == 0.0
            latest, second, third = (select(begins, now, x[j]) for x in (past.latest, past.second, past.third))
            q, dq, ddq = seen.q_reference[j], seen.dq_reference[j], seen.ddq_reference[j]
            theta, velocity, acceleration, smooth = motor_target((now, latest, second, third), q, dq, ddq, drive, T)
            before = select(begins, smooth, past.smooth[j])
            slip = dry_friction_ahead(velocity, acceleration, drive.dry_friction, c)
            u_ff = smooth + c.ahead * (smooth - before) + c.friction * slip
            found.append((latest, second, smooth, theta, velocity, acceleration, u_ff))
        latest, second, smooth, theta, velocity, acceleration, u_ff = zip(*found, strict=True)
        aim = Aim(*(physics.PerJoint(*part) for part in (theta, velocity, acceleration)))
        return Past(1.0, tuple(torque), latest, second, smooth), aim, u_ff

    return target


class ElasticTarget:
    """The motors' target θ_d, its derivatives and u_ff, sample by sample; see the module's docstring."""

    def __init__(
        self, parameters: AnyArm, control_period: float, *, friction: bool = True, average: bool = True
    ) -> None:
        """Set up the target for the arm as the controller knows it and T [s], which must be positive.

        `friction` says whether u_ff includes dry friction, `average` whether it is for the middle of the next hold.
        """
        period, physics = real("control_period", control_period, "s", above=0.0), equations_of(parameters)
        self._joints, self.memory_size = physics.joints, len(flat(past_of(physics.joints)))
        self._parameters = parameters
        self.constants = TargetConstants(*numbers_of(parameters), period, float(friction), 0.5 * float(average))
        self._numbers = np.array(flat(self.constants))

    @property
    def of(self) -> Any:
        """The function that `target_of` returns for the arm."""
        return target_of(equations_of(self._parameters))

    def advance(self, observation: np.ndarray, memory: np.ndarray, target: np.ndarray, feedforward: np.ndarray) -> None:
        """Fill `target` (lanes, 3 n) with θ_d [rad], θ̇_d [rad/s] and θ̈_d [rad/s²]; advance the memory.

        `feedforward` (lanes, n) becomes the unclipped u_ff [N m]. Only the reference in `observation` (lanes, 5 n) is
        used. A memory (lanes, memory_size) of zeros begins an episode with the arm at rest.
        """
        self._kernel((memory, observation, target, feedforward), self._numbers)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_kernel"}

    @functools.cached_property
    def _kernel(self) -> Kernel:
        def advance(past: Past, seen: Observation, _aim: Aim, _u_ff: Any, c: TargetConstants) -> tuple[Any, ...]:
            past, aim, u_ff = self.of(past, seen, c)
            return past, seen, aim, u_ff

        nothing = (0.0,) * self._joints
        ports = past_of(self._joints), seen_by(self._joints), Aim(nothing, nothing, nothing), nothing
        return Kernel(Program(advance, ports, self.constants))
