"""The inputs of the network of `learned-observer`: the unexplained signals z and the context c, each of order 1.

Let ν_a and ν_o be the innovations y - ŷ⁻ of the adaptive and of the elastic observer (one entry for each motor angle
and velocity), u_a and u_o the torques of the two observers, and l = (forces, payload) the load in the beliefs p. Then

    z = (a(ν_a), b(ν_a), a(ν_o), b(ν_o), d̂/R, asinh((u_a - u_o)/(κ R)), the last output ρ, asinh((l - l_0)/l_1)),
    a(ν) = asinh(ν/s),    b(ν) = asinh(ν/S) ν²/(s² + ν²),

with κ = `GAP_SHARE`, the initial guess l_0 of l, and the `Units` R, s, S, l_1, v_0 and v_1 of an arm. a(ν) resolves
small innovations; b(ν) is linear in large ones and flat about zero. d̂ is the load on the links estimated by the elastic
observer. z vanishes where everything is explained and the arm is on its target. The observation and the beliefs give

    c = (cos and sin of ψ_1, ..., ψ_n, q̇_d, q̈_d, u_ff, directions of the joints, direction of travel e, Jᵀ e,
         beliefs about delay and noise, m),

where ψ_j is the sum of the angles of joints with parallel axes up to joint j (`turns_of`; θ_1 and θ_1 + θ_2 of the
two-joint arm), and e = v/√(|v|² + v_0²) with the reference velocity v of the tip; directions of joints are analogous.
m = |v|²/(|v|² + v_1²) is 0 at rest and close to 1 in motion.

The units of the two-joint arm were chosen for Table 1; for every arm, torques are relative to its torque limits. For a
robot given by its frames, every unit is that of Table 1 times a ratio between the robot and Table 1:

    forces, payload    r_F, r_m, see `scale_of`
    innovations        Γ_j/I_j, torque limit over motor inertia of the joint, relative to the first joint of Table 1
    q̇_d, q̈_d           the joint's velocity limit
    lengths, tip       the reach
"""

import functools
from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.arithmetic import consecutive
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.elementwise import root, select, sine_cosine
from fuzzyarm.envs.physics.equations import AnyArm, equations_of, robot_of, two_joints
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import load_scale
from fuzzyarm.envs.scenario.kinematics import reach, velocity_limits
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, Memory, mass_of, unit_force
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Settings
from fuzzyarm.fuzzy_policy.laws.learned.network import area_sine
from fuzzyarm.numbers.functions import each, maximum, only

__all__ = [
    "GAP_SHARE", "QUIET", "Units", "context_of", "context_parts", "scale_of", "see_beliefs", "see_innovation",
    "see_unexplained", "turns_of", "unexplained_parts", "units_of",
]  # fmt: skip

GAP_SHARE = 0.05  # share of R that is the unit of u_a - u_o
QUIET = 1.0 / 600.0  # share of the torques R: for a smaller load d̂ the elastic observer acts almost alone
_FINE = (5e-7, 2e-6, 1e-3, 4e-3)  # s of angles [rad] and velocities [rad/s] of the two-joint arm
_COARSE = (1e-5, 4e-5, 2e-2, 8e-2)  # S
_BEYOND = 1.2  # R over the torque limits
_FORCE, _MASS = 20.0, 1.0  # N and kg, l_1 of the arm of Table 1
_FASTEST, _JERKIEST = 3.0, 30.0  # units of q̇_d [rad/s] and of q̈_d [rad/s²]
_SLOW, _SLOW_TIP = 0.05, 0.02  # rad/s and m/s: a direction fades below these speeds
_REST = 1e-4  # m/s, v_1
_PARALLEL = 1e-9  # how far the cosine between parallel axes may be from 1


class _Scale(NamedTuple):
    """The size of an arm relative to Table 1: forces at its tip, masses, and lengths."""

    force: float
    mass: float
    length: float


def scale_of(arm: AnyArm) -> _Scale:
    """Return the size of an arm relative to Table 1: ratios of tip force, mass and reach.

    The tip force of the two-joint arm is the first motor's torque limit over the reach. The last motors of a robot may
    be far weaker than the first, so that `load_scale` gives the robot's ratios of force and mass.
    """
    paper = ArmParameters()
    if isinstance(arm, Robot):
        return _Scale(*load_scale(arm), reach(arm) / sum(paper.length))
    force, mass = unit_force(arm) / unit_force(paper), mass_of(arm) / mass_of(paper)
    return _Scale(force, mass, sum(arm.length) / sum(paper.length))


class Units(NamedTuple):
    """The units of the network's inputs, for n joints and a tip in a plane or in space."""

    torque: Any  # R (n,), 1.2 times the torque limits [N m]: unit of loads; unit and bound of residual torques
    # l_1 (axes + 2,), of the forces along the direction of travel and along each axis [N], and the payload [kg]
    load: Any
    fine: Any  # s (2 n,) of the innovation of angles [rad] and velocities [rad/s]
    coarse: Any  # S (2 n,) of large innovations
    velocity: Any  # of q̇_d (n,) [rad/s]
    acceleration: Any  # of q̈_d (n,) [rad/s²]
    slow: Any  # joint velocities (n,) [rad/s] below which the direction of a joint fades
    slow_tip: Any  # v_0 [m/s]
    rest: Any  # v_1 [m/s]
    length: Any  # of the levers Jᵀ e [m]


def units_of(arm: AnyArm) -> Units:
    """Return the units of the network's inputs for an arm."""
    limit, scale, paper = per_joint_of(arm, "torque_limit"), scale_of(arm), ArmParameters()
    length, speed, fine, coarse, axes = 1.0, np.ones(len(limit)), np.array(_FINE), np.array(_COARSE), len(paper.length)
    if isinstance(arm, Robot):
        quickness = limit / per_joint_of(arm, "motor_inertia") * (paper.motor_inertia[0] / paper.torque_limit[0])
        fine, coarse = (np.concatenate([unit[0] * quickness, unit[2] * quickness]) for unit in (_FINE, _COARSE))
        length, speed = scale.length, velocity_limits(arm) / paper.velocity_limit[0]
        axes = equations_of(arm).axes
    load = np.array([*[_FORCE * scale.force] * (axes + 1), _MASS * scale.mass])
    of_joints = _FASTEST * speed, _JERKIEST * speed, _SLOW * speed
    return Units(_BEYOND * limit, load, fine, coarse, *of_joints, _SLOW_TIP * length, _REST * length, length)


def turns_of(arm: AnyArm) -> np.ndarray:
    """Return the factors σ (n,) of the angles ψ_j = θ_j + σ_j ψ_(j-1).

    σ_j is 1 if the axes of joints j - 1 and j are parallel, -1 if they are opposite, else 0; the first factor is 0.
    """
    now = robot_of(arm).arrays
    cosine = np.einsum("ja,jab,jb->j", now.axis[:-1], now.rotation[1:], now.axis[1:])
    parallel = np.abs(np.abs(cosine) - 1.0) < _PARALLEL
    return np.concatenate([[0.0], np.where(parallel, np.rint(cosine), 0.0)])


_SENSELESS = 1e6  # rad and rad/s; a larger innovation shows that the filter has diverged
_NOISE, _NOISES = 1e-6, 3.0  # rad, unit of the estimated noise; value of its asinh that counts as 1


# The slices of the parts of z and of c, in the order of the module's equations.
_UnexplainedParts = namedtuple("_UnexplainedParts", "fine coarse slow_fine slow_coarse load gap residual belief")
_ContextParts = namedtuple(
    "_ContextParts", "angles velocities accelerations feedforward signs travel lever trust motion"
)


@functools.cache
def unexplained_parts(joints: int, axes: int) -> _UnexplainedParts:
    """Return the slices of the parts of the unexplained signals z for given numbers of joints and tip axes."""
    return _UnexplainedParts(*consecutive(*[2 * joints] * 4, *[joints] * 3, axes + 2))


@functools.cache
def context_parts(joints: int, axes: int) -> _ContextParts:
    """Return the slices of the parts of the context c for given numbers of joints and tip axes."""
    return _ContextParts(*consecutive(2 * joints, joints, joints, joints, joints, axes, joints, 5, 1))


def see_innovation(seen: Observation, m: Memory, units: Units, z: Any, parts: _UnexplainedParts) -> None:
    """Fill z with the adaptive observer's innovation ν_a; 0 when an episode begins or if the filter has diverged."""
    joints = len(seen.q_motor)
    predicted = (m.flags[FLAG.samples] > 0.0) & (m.flags[FLAG.lost] == 0.0)
    raw = [q - m.z[i] for i, q in enumerate(seen.q_motor)]
    raw += [dq - m.z[2 * joints + i] for i, dq in enumerate(seen.dq_motor)]
    # A filter that diverges at this sample is marked as diverged only by the correction.
    innovation = [select(predicted & (abs(number) < _SENSELESS), number, 0.0) for number in raw]
    _scaled(innovation, units, z[parts.fine], z[parts.coarse])


def see_unexplained(
    innovation: Any, load: Any, gap: Any, residual: Any, units: Units, z: Any, parts: _UnexplainedParts
) -> None:
    """Fill the slices of z in `parts` that belong to the first four arguments; `units` scale them.

    These arguments are ν_o (2 n,) [rad, rad/s], d̂ (n,) [N m], u_a - u_o (n,) [N m], and ρ (n,) of the previous sample.
    """
    _scaled(innovation, units, z[parts.slow_fine], z[parts.slow_coarse])
    seen_load, seen_gap, seen_residual = z[parts.load], z[parts.gap], z[parts.residual]
    for i, torque in enumerate(units.torque.tolist()):
        seen_load[i], seen_gap[i], seen_residual[i] = load[i] / torque, gap[i] / (GAP_SHARE * torque), residual[i]
    _squash(seen_gap)


def see_beliefs(
    m: Memory, s: Settings, units: Units, z: Any, c: Any, parts: _UnexplainedParts, in_context: _ContextParts
) -> None:
    """Fill entries of z with the load, and of c with beliefs about delay and noise; 0 where the filter has diverged.

    In c these are the delay and its standard deviation [control periods], calm, surprise (see `_Flags`) and noise.
    """
    states, last, belief, trust = len(m.z) - len(s.guess), len(m.z) - 1, z[parts.belief], c[in_context.trust]
    for numbers in (belief, trust):
        for k in each(len(numbers)):
            numbers[k] = 0.0
    for _ in only(m.flags[FLAG.lost] == 0.0):
        for k, unit in enumerate(units.load.tolist()):
            belief[k] = (m.z[states + k] - s.guess[k]) / unit
        _squash(belief)
        loudest = m.noise[0]
        for j in range(1, len(m.noise)):
            loudest = maximum(loudest, m.noise[j])
        deviation, noise = root(maximum(m.P[last, last], 0.0)), root(loudest)
        trust[0], trust[1], trust[2] = m.z[last], deviation, m.flags[FLAG.calm]
        trust[3], trust[4] = area_sine(m.flags[FLAG.surprise]), area_sine(noise / _NOISE) / _NOISES


@functools.cache
def context_of(physics: Physics) -> Any:
    """Return ``context(seen, feedforward, limit, turns, arm, units, c)``.

    It fills c from an observation, u_ff and torque limits (n,) [N m], `turns_of` (n,), the arm's constants and `Units`.
    """
    parts, planar = context_parts(physics.joints, physics.axes), physics is two_joints()

    def context(
        seen: Observation, feedforward: Any, limit: Any, turns: np.ndarray, arm: Any, units: Units, c: Any
    ) -> None:
        q, dq, ddq = seen.q_motor, seen.dq_reference, seen.ddq_reference
        angles, turned = c[parts.angles], 0.0
        for i, turn in enumerate(turns.tolist()):
            turned = q[i] + turn * turned
            sine, cosine = sine_cosine(turned)
            angles[2 * i], angles[2 * i + 1] = cosine, sine
        velocity: Any = _planar_velocity(q, dq, arm) if planar else physics.tip_velocity(q, dq, arm)
        square = 0.0
        for v in velocity:
            square = square + v * v
        speed = root(square + units.slow_tip * units.slow_tip)
        c[parts.motion.start] = square / (square + units.rest * units.rest)
        travel = [v / speed for v in velocity]
        for i, number in enumerate(travel):
            c[parts.travel][i] = number
        lever = _planar_lever(q, travel, arm) if planar else physics.tip_load(q, physics.Point(*travel), arm)
        for i, number in enumerate(lever):
            slow = float(units.slow[i])
            c[parts.lever][i] = number / units.length
            c[parts.velocities][i] = dq[i] / float(units.velocity[i])
            c[parts.accelerations][i] = ddq[i] / float(units.acceleration[i])
            c[parts.feedforward][i] = feedforward[i] / limit[i]
            c[parts.signs][i] = dq[i] / root(dq[i] * dq[i] + slow * slow)

    return context


def _scaled(innovation: Any, units: Units, fine: Any, coarse: Any) -> None:
    """Fill `fine` with asinh(ν/s) and `coarse` with asinh(ν/S) ν²/(s² + ν²) for an innovation ν, (2 n,) each."""
    for k, number in enumerate(innovation):
        fine[k], coarse[k] = number / float(units.fine[k]), number / float(units.coarse[k])
    _squash(fine)
    _squash(coarse)
    for k, number in enumerate(innovation):
        square, unit = number * number, float(units.fine[k])
        coarse[k] = coarse[k] * (square / (square + unit * unit))


def _squash(numbers: Any) -> None:
    """Replace the entries of an array by their asinh."""
    for k in each(len(numbers)):
        numbers[k] = area_sine(numbers[k])


# v (axes,) [m/s] and Jᵀ e (n,) of the two-joint arm, with the order of operations, and thus the bits, of the shipped
# network's training run.
def _planar_velocity(q: Any, dq: Any, arm: Any) -> tuple[Any, Any]:
    (s1, c1), (s12, c12) = sine_cosine(q[0]), sine_cosine(q[0] + q[1])
    both = dq[0] + dq[1]
    x = -arm.length1 * s1 * dq[0] - arm.length2 * s12 * both
    return x, arm.length1 * c1 * dq[0] + arm.length2 * c12 * both


def _planar_lever(q: Any, e: Any, arm: Any) -> tuple[Any, Any]:
    (s1, c1), (s12, c12) = sine_cosine(q[0]), sine_cosine(q[0] + q[1])
    second = arm.length2 * (c12 * e[1] - s12 * e[0])
    return arm.length1 * (c1 * e[1] - s1 * e[0]) + second, second
