"""What the network of `learned-observer` sees: the unexplained z and the context c, each of order 1.

With the innovations ν_a and ν_o, y - ŷ⁻ of the adaptive and of the elastic observer, one number for each motor angle
and velocity, their torques u_a and u_o, and the load l = (forces, payload) of the beliefs p,

    z = (a(ν_a), b(ν_a), a(ν_o), b(ν_o), d̂/R, asinh((u_a - u_o)/(κ R)), the last ρ, asinh((l - l_0)/l_1)),
    a(ν) = asinh(ν/s),    b(ν) = asinh(ν/S) ν²/(s² + ν²),

with κ = `GAP_SHARE` and the `Units` R, s, S and l_1 of an arm: a(ν) resolves what is small; b(ν) is linear in what is
large and flat about zero. d̂ is what the elastic observer believes to load the links. z vanishes where nothing is
unexplained and the arm is on its target. From the observation and the beliefs follows

    c = (cos and sin of ψ_1, ..., ψ_n, q̇_d, q̈_d, u_ff, directions of the joints, direction of travel e, Jᵀ e,
         what is believed of lateness and noise, m),

ψ being the sum of the angles of joints with parallel axes up to this one (`units.turns_of`; θ_1 and θ_1 + θ_2 of the
two-joint arm), and e = v/√(|v|² + v_0²) with the reference velocity v of the tip, and likewise of the joints.
m = |v|²/(|v|² + v_1²) is 0 at rest and close to 1 in motion; for Table 1 v_1 = 0.1 mm/s.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import in_list, reader
from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, Memory
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.learned_policy.estimate.units import GAP_SHARE, Units
from fuzzyarm.learned_policy.functions import area_sine

__all__ = ["ContextParts", "Signals", "UnexplainedParts", "context_parts", "signals_of", "unexplained_parts"]

_SENSELESS = 1e6  # rad and rad/s, an innovation of a filter that has diverged
_NOISE, _NOISES = 1e-6, 3.0  # rad, unit of the noise that is read; e-fold of its asinh that counts as 1


class UnexplainedParts(NamedTuple):
    """Where the parts of z lie, in the order of the module's equation."""

    fine: Any
    coarse: Any
    slow_fine: Any
    slow_coarse: Any
    load: Any
    gap: Any
    residual: Any
    belief: Any


class ContextParts(NamedTuple):
    """Where the parts of c lie, in the order of the module's equation."""

    angles: Any
    velocities: Any
    accelerations: Any
    feedforward: Any
    signs: Any
    travel: Any
    lever: Any
    trust: Any
    motion: Any


class Signals(NamedTuple):
    """Compiled functions that fill z and c (numbers of `unexplained_parts` and `context_parts`) of one lane.

    Attributes:
        innovation: ``innovation(lane, o, m, units, ν, z)`` fills the parts that are of ν_a, before that filter's
            correction; 0 as an episode begins and where the filter has diverged. ν (2 n,) [rad, rad/s] becomes ν_a.
        unexplained: ``unexplained(ν, load, gap, residual, units, z)`` fills parts from ν_o (2 n,) [rad, rad/s], d̂ and
            u_a - u_o (n,) [N m] and the last ρ (n,).
        beliefs: ``beliefs(m, s, units, z, c)`` fills the parts of z and c that are of the corrected beliefs; 0 where
            the filter has diverged. In c these are lateness and its standard deviation [control periods], calm,
            surprise, and the noise that is read.
        context: ``context(lane, o, feedforward, limit, turns, arm, units, c)`` fills c from the observation (5 n,) of a
            lane, u_ff (n,) [N m], its limit (n,), `turns_of` (n,) and the record of the arm's constants.
    """

    innovation: Any
    unexplained: Any
    beliefs: Any
    context: Any


@functools.cache
def unexplained_parts(joints: int, axes: int) -> UnexplainedParts:
    """Return where the parts of z lie for so many joints and axes of the tip's space."""
    return UnexplainedParts(*consecutive(*[2 * joints] * 4, *[joints] * 3, axes + 2))


@functools.cache
def context_parts(joints: int, axes: int) -> ContextParts:
    """Return where the parts of c lie for so many joints and axes of the tip's space."""
    return ContextParts(*consecutive(2 * joints, joints, joints, joints, joints, axes, joints, 5, 1))


@functools.cache
def signals_of(physics: Physics) -> Signals:
    """Return the functions for arms with these equations."""
    return Signals(*_innovations_of(physics), _beliefs_of(physics), _context_of(physics))


@register_jitable
def _scaled(innovation: np.ndarray, units: Units, fine: np.ndarray, coarse: np.ndarray) -> None:
    """Fill a(ν) and b(ν) from ν, each (2 n,)."""
    for k in range(len(innovation)):
        square = innovation[k] * innovation[k]
        fine[k] = area_sine(innovation[k] / units.fine[k])
        large = area_sine(innovation[k] / units.coarse[k])
        coarse[k] = large * (square / (square + units.fine[k] * units.fine[k]))


def _innovations_of(physics: Physics) -> tuple[Any, Any]:
    """Return the first two functions of `Signals`."""
    joints = physics.joints
    parts = unexplained_parts(joints, physics.axes)
    at_fine, at_coarse, at_slow_fine, at_slow_coarse, at_load, at_gap, at_residual, _ = parts

    @register_jitable
    def see_innovation(
        lane: int, o: Observation, m: Memory, units: Units, innovation: np.ndarray, z: np.ndarray
    ) -> None:
        predicted = m.flags[FLAG.samples] > 0.0 and m.flags[FLAG.lost] == 0.0
        for i in range(joints):
            innovation[i] = o.q_motor[lane, i] - m.z[i]
            innovation[joints + i] = o.dq_motor[lane, i] - m.z[2 * joints + i]
        for k in range(len(innovation)):
            # A filter that has diverged at this very sample says so only with its correction.
            if not (predicted and np.abs(innovation[k]) < _SENSELESS):
                innovation[k] = 0.0
        _scaled(innovation, units, z[at_fine], z[at_coarse])

    @register_jitable
    def see_unexplained(
        innovation: np.ndarray, load: np.ndarray, gap: np.ndarray, residual: np.ndarray, units: Units, z: np.ndarray
    ) -> None:
        _scaled(innovation, units, z[at_slow_fine], z[at_slow_coarse])
        for i in range(joints):
            z[at_load][i] = load[i] / units.torque[i]
            z[at_gap][i] = area_sine(gap[i] / (GAP_SHARE * units.torque[i]))
            z[at_residual][i] = residual[i]

    return see_innovation, see_unexplained


def _beliefs_of(physics: Physics) -> Any:
    """Return `Signals.beliefs`."""
    joints = physics.joints
    at_belief = unexplained_parts(joints, physics.axes).belief
    at_trust = context_parts(joints, physics.axes).trust

    @register_jitable
    def see_beliefs(m: Memory, s: Settings, units: Units, z: np.ndarray, c: np.ndarray) -> None:
        states, last, belief, trust = len(m.z) - len(s.guess), len(m.z) - 1, z[at_belief], c[at_trust]
        belief[:], trust[:] = 0.0, 0.0
        if m.flags[FLAG.lost] == 0.0:
            for k in range(len(units.load)):
                belief[k] = area_sine((m.z[states + k] - s.guess[k]) / units.load[k])
            loudest = m.noise[0]
            for j in range(1, joints):
                loudest = max(loudest, m.noise[j])
            deviation, noise = np.sqrt(max(m.P[last, last], 0.0)), np.sqrt(loudest)
            calm, surprise = m.flags[FLAG.calm], area_sine(m.flags[FLAG.surprise])
            trust[0], trust[1], trust[2] = m.z[last], deviation, calm
            trust[3:][0], trust[3:][1] = surprise, area_sine(noise / _NOISE) / _NOISES

    return see_beliefs


def _context_of(physics: Physics) -> Any:
    """Return `Signals.context`."""
    joints, axes = physics.joints, physics.axes
    parts, (tip_velocity, tip_lever) = context_parts(joints, axes), _tip_of(physics)
    at_angles, at_velocities, at_accelerations, at_feedforward, at_signs, at_travel, at_lever, _, _ = parts
    at_motion = parts.motion.start

    @register_jitable
    def see_context(
        lane: int,
        o: Observation,
        feedforward: np.ndarray,
        limit: np.ndarray,
        turns: np.ndarray,
        arm: Any,
        units: Units,
        c: np.ndarray,
    ) -> None:
        q, dq, ddq = o.q_motor[lane], o.dq_reference[lane], o.ddq_reference[lane]
        angles, turned = c[at_angles], 0.0
        for i in range(joints):
            turned = q[i] + turns[i] * turned
            sine, cosine = sine_cosine(turned)
            angles[2 * i], angles[2 * i + 1] = cosine, sine
        travel, lever = c[at_travel], c[at_lever]
        tip_velocity(q, dq, arm, travel)
        square = 0.0
        for i in range(axes):
            square += travel[i] * travel[i]
        speed = np.sqrt(square + units.slow_tip * units.slow_tip)
        c[at_motion] = square / (square + units.rest * units.rest)
        for i in range(axes):
            travel[i] = travel[i] / speed
        tip_lever(q, travel, arm, lever)
        for i in range(joints):
            lever[i] = lever[i] / units.length
            c[at_velocities][i], c[at_accelerations][i] = dq[i] / units.velocity[i], ddq[i] / units.acceleration[i]
            c[at_feedforward][i] = feedforward[i] / limit[i]
            c[at_signs][i] = dq[i] / np.sqrt(dq[i] * dq[i] + units.slow[i] * units.slow[i])

    return see_context


def _tip_of(physics: Physics) -> tuple[Any, Any]:
    """Return ``velocity(q, dq, arm, v)`` and ``lever(q, e, arm, l)``, which fill v (axes,) [m/s] and l = Jᵀ e (n,)."""
    if physics is two_joints():
        return _planar_velocity, _planar_lever
    joints, axes, velocity_of, load_of = physics.joints, physics.axes, physics.tip_velocity, physics.tip_load
    per_joint, point = reader(physics.PerJoint, in_list), reader(physics.Point, in_list)

    @register_jitable
    def velocity(q: np.ndarray, dq: np.ndarray, arm: Any, v: np.ndarray) -> None:
        moved = velocity_of(per_joint(q, 0), per_joint(dq, 0), arm)
        for i in range(axes):
            v[i] = moved[i]

    @register_jitable
    def lever(q: np.ndarray, e: np.ndarray, arm: Any, filled: np.ndarray) -> None:
        found = load_of(per_joint(q, 0), point(e, 0), arm)
        for j in range(joints):
            filled[j] = found[j]

    return velocity, lever


# Of the two-joint arm in the order of operations in which the shipped network was trained: the same bits.
@register_jitable
def _planar_velocity(q: np.ndarray, dq: np.ndarray, arm: Any, v: np.ndarray) -> None:
    (s1, c1), (s12, c12) = sine_cosine(q[0]), sine_cosine(q[0] + q[1])
    both = dq[0] + dq[1]
    v[0] = -arm.length1 * s1 * dq[0] - arm.length2 * s12 * both
    v[1] = arm.length1 * c1 * dq[0] + arm.length2 * c12 * both


@register_jitable
def _planar_lever(q: np.ndarray, e: np.ndarray, arm: Any, lever: np.ndarray) -> None:
    (s1, c1), (s12, c12) = sine_cosine(q[0]), sine_cosine(q[0] + q[1])
    lever[1] = arm.length2 * (c12 * e[1] - s12 * e[0])
    lever[0] = arm.length1 * (c1 * e[1] - s1 * e[0]) + lever[1]
