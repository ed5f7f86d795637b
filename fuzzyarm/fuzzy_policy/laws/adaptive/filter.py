"""The extended Kalman filter of the adaptive observer, and the confidence in its estimates.

z = (x, p), with the elastic arm's state x = (θ, q, θ̇, q̇) and p of `belief`; P is the covariance of the error of z. All
functions are recorded and work in place on one lane's arrays, which determine the sizes.

    correct   for each measured quantity y with variance r:  ν = y - z_y,  s = max(P_yy + r, ν²/gate),
              z ← z + P_y ν/s,   P ← P - P_y P_yᵀ/s,
    predict   x ← x after a control period, for the arm with parameters p,   P ← F P Fᵀ + Q.

`gate` reduces the weight of outliers (Huber). The constants of the arm adapt only by the share

    λ = max(0, 1 - a/ν²)

of a correction, where a is a multiple of the noise variance: samples that sensor noise alone can explain do not change
the constants. Without this dead zone the stiffness drifts with the noise. The covariance is updated as in the
partial update of Schmidt's filter: entry (i, j) shrinks by 1 - (1 - λ_i)(1 - λ_j) of a whole correction.

The forces drift little while only noise corrects them. With c_k the correction of the forces by sample k, in N, and
means over about the last ten samples,

    s = |mean c|² / (mean |c|² + floor),    calm → 1 for s up to 0.08, falling to 0 for s from 0.3 on.

Corrections by noise have random directions, and s is about 0.05; those by a moving force have one, and s goes to 1.
The random walk of the forces is scaled by (1 - calm) + `calm_walk` calm. When calm falls, their variance also grows by
`reopening` seconds of walk.

A motor's torque may be wrong by the fraction w (Δu/u_max)² of its limit u_max, with w = `torque_doubt` and the largest
jump Δu of the commands on their way to the motors. A wrong torque constant or delay acts through such jumps, and its
effect would be mistaken for a load.

A filter may converge to a wrong delay. If the innovations are larger than it expects, the variance of the delay grows:
a sample with a mean ν²/s of 1 + a adds `_LATENESS_DOUBT` a, up to the initial variance. The same holds for a factor
common to all of the arm's constants, as caused by a wrong torque constant. For any two of the constants' factors i, k,

    P_ik ← P_ik + min(`scale_doubt` a, max(0, `_LARGEST_SCALE` - min P_jj))

with the minimum over all such factors j.

The law acts on the part of the load that encoder noise does not explain, see `_significant`. With the forces and the
payload l (the first entries of p), their initial guess l_0, and the state x,

    d² = (l - l_0)ᵀ P_ll⁻¹ (l - l_0),   s = max(0, 1 - c² calm ρ/d²),
    l_a = l_0 + s (l - l_0),            x_a = x - (1 - s) P_xl P_ll⁻¹ (l - l_0).

ρ is the largest ratio, of all joints, of the estimated noise variance to the one assumed for a measured angle. A load
within c standard deviations of that noise has no effect; a load far beyond is hardly reduced (the positive-part
James-Stein estimator). x_a is the mean of x, given l_a. The filter itself continues with x and l.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws._gain_schedule import schedule_of
from fuzzyarm.fuzzy_policy.laws.adaptive import belief as believed
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FACTORS, FLAG, KEPT, LONGEST_DELAY, AdaptiveWeights, Memory
from fuzzyarm.numbers.functions import array, each, floor, maximum, minimum, only, select

__all__ = [
    "MISTRUST", "Scratch", "Settings", "begin", "command", "correct", "fill", "numbers_at", "predict", "sent",
    "take_in", "update",
]  # fmt: skip

_ENOUGH = 1e6  # largest count of samples
_STATICS_STEPS = 20  # fixed-point iterations for the first estimate; for Table 1 each iteration adds three digits
_CHANGE = 6.0  # variance of e - e_last in `_note_noise`, relative to the variance of the angles' noise
_NOISE_SHARE = 0.03  # weight of a sample in the estimated encoder noise, after enough samples
MISTRUST = 8.0  # least variance assumed for a measured angle, relative to the variance of the estimated noise
_SURPRISE_SHARE = 0.02  # weight of a sample in the mean surprise
_DIVERGED = 50.0  # mean surprise at which a filter counts as diverged
_SWING_SHARE = 0.1  # weight of a sample in the mean jump of the commands
_SHARE = 0.1  # weight of a sample in the means of the corrections
_NOISE, _DIRECTED = 0.08, 0.3  # s up to which corrections count as noise, and s from which they count as a motion
_CALMING, _STIRRING = 0.02, 0.7  # weight of a sample in calm, when calm rises and when it falls
_LATENESS_DOUBT = 0.01  # variance added to the delay per surprise [control periods²]
_LARGEST_SCALE = 0.1  # if the variance of every factor is above this, the common factor is not doubted
_INSIGNIFICANT = 1.25  # c for an arm with a noise estimate that is a mean over all samples
_ROUNDING = 1e-9  # least share of a load's variance that the other loads do not explain
_STILL = 1e-3  # correction of the forces by a sample that counts as zero, in unit forces
# Steps of the finite differences for F (angles, velocities, loads, factors): far above rounding errors, and so small
# that the equations are nearly linear.
_STEPS = (1e-7, 1e-6, 1e-2, 1e-4)
_TINY = 1e-300


class Settings:
    """The constants of filter and law; n joints, N entries of the estimate z."""

    def __init__(self, arm: AnyArm, control_period: float, weights: AdaptiveWeights, feedback: np.ndarray) -> None:
        """Set up for the known arm, T [s] and `feedback`, the regulator's gains of `regulator.feedback_table`."""
        belief, p = believed.belief_of(equations_of(arm)), believed.prior(arm, weights)
        limit, inertia = per_joint_of(arm, "torque_limit"), per_joint_of(arm, "motor_inertia")
        n, loads, period, still = len(limit), belief.payload.stop, control_period, np.zeros(len(limit))
        encoder, unknown = np.repeat([weights.encoder_angle, weights.encoder_velocity], n), isinstance(arm, Robot)
        first_state = (weights.encoder_angle, weights.first_link_angle, *[weights.encoder_velocity] * 2)
        shared, cautious = np.zeros((2, 4 * n + len(p.guess)))
        for name in FACTORS:
            shared[4 * n :][getattr(belief, name)] = weights.first_scale
        for name in (*FACTORS, "lateness"):
            cautious[4 * n :][getattr(belief, name)] = 1.0
        self.weights = weights
        self.feedback = feedback
        # Joints over which K is tabulated, whether at evenly spaced cosines, and the number of points per joint.
        self.schedule = schedule_of(arm)[:3]
        self.soft_samples = weights.soft_start / period
        self.base, self.slopes = believed.affine_numbers(arm)  # a_0 and S
        self.guess = p.guess  # p_0
        self.spread = np.concatenate([np.repeat(first_state, n), p.spread])  # initial standard deviations of z (N,)
        self.shared = shared  # initial standard deviation of the common factor in each entry of z (N,)
        self.low, self.high = p.low, p.high  # lowest and highest p
        # Diagonal of Q (N,).
        self.noise = np.concatenate([still, still, weights.motor_torque * limit / inertia, still, p.walk]) ** 2 * period
        # Standard deviation of a motor velocity per squared jump of its command [rad/s / (N m)²], (n,).
        self.doubt = weights.torque_doubt * period / (inertia * limit)
        # Variance of the forces after `AdaptiveWeights.reopening` seconds of walk [N²], (forces,).
        self.reopening = p.walk[: belief.force.stop] ** 2 * weights.reopening
        self.still = (_STILL * believed.unit_force(arm)) ** 2  # correction of the forces that counts as zero [N²]
        self.steps = np.repeat(_STEPS, [2 * n, 2 * n, loads, len(p.guess) - loads])  # of the finite differences for F
        self.variances = encoder**2  # of the measured quantities (2 n,)
        self.cautious = cautious  # 1 for entries of z that adapt only beyond the dead zone, else 0 (N,)
        self.gate = weights.gate
        # Nothing was tuned for robots, so adaptation begins more cautiously. Their estimated noise stays close to its
        # initial guess for long, so that it cannot show which loads are significant.
        self.first_share = _NOISE_SHARE if unknown else 1.0  # largest weight of a sample in the estimated noise
        self.insignificant = 0.0 if unknown else _INSIGNIFICANT**2  # c² of `_significant`
        self.limit = limit  # torque limits [N m]
        self.mass = believed.mass_of(arm)  # mass of all links [kg]
        self.substeps = default_substeps(period, fastest_rate([arm]))  # number per control period
        self.substep = period / self.substeps  # h [s]

    @property
    def period(self) -> float:
        """The control period T [s]."""
        return self.substep * self.substeps

    def replaced(self, **parts: Any) -> Settings:
        """Return a copy with the attributes `parts` replaced."""
        other = copy.copy(self)
        vars(other).update(parts)
        return other

    @property
    def tables(self) -> tuple[np.ndarray, ...]:
        """The arrays that the law looks up by index, in a fixed order and in double precision."""
        parts = vars(self).values()
        return tuple(np.array(part, dtype=np.float64, order="C") for part in parts if isinstance(part, np.ndarray))

    def with_tables(self, tables: Any) -> Settings:
        """Return a copy with the arrays replaced by `tables`, in the same order."""
        names = [name for name, part in vars(self).items() if isinstance(part, np.ndarray)]
        return self.replaced(**dict(zip(names, tables, strict=True)))


class _Copies(NamedTuple):
    """Copies of the arm that differ in state, torques, force or constants; a column of each array is one copy."""

    state: Any  # (4 n, copies)
    torque: Any  # (n, copies)
    force: Any  # force line (rows, copies)
    numbers: Any  # a of the arm (k, copies)


class Scratch:
    """Intermediate results of filter and law for one lane; n joints, N entries of z, and a tip in a plane or in space.

    A force line has a row for each axis of the mean force, then a row for each axis of its change.
    """

    def __init__(self, physics: Physics, s: Settings, known: Any = None) -> None:
        """Allocate the arrays.

        `known` is a tip force [N] known beforehand, to which the estimated force is added; its rows (`KEPT` + 1, axes)
        are for this sample, the samples before it, latest first, and the next one; None for no force.
        """
        n, N, axes, forces = physics.joints, len(s.spread), physics.axes, physics.axes + 1

        def copies(count: int) -> _Copies:
            return _Copies(array(4 * n, count), array(n, count), array(2 * axes, count), array(len(s.base), count))

        self.arm = believed.ArmFunctions(physics)
        self.copies = copies(1 + N + n)  # each with one entry changed: the differences give the columns of F
        self.F = array(4 * n, N)  # only the rows of x
        self.wide = array(n)  # steps of the motor velocities
        self.one = copies(1)
        self.numbers = array(len(s.base))  # a of the arm
        self.innovation, self.expected = array(2 * n), array(2 * n)  # ν and P_yy + r of each measured quantity
        self.columns = array(2 * n, N)  # P_y of each measured quantity
        self.measured = array(2 * n)  # θ and θ̇
        self.variances = array(2 * n)  # of the measured quantities
        self.silent = array(2 * n)  # a of the module's docstring
        self.acted = array(N)  # z on which the law acts, see `_significant`
        self.link_torque = array(KEPT, n)  # τ_d of each kept reference
        self.travel = array(KEPT + 1, axes)  # direction of travel at each kept reference, then at the next one
        self.directions = array(2 * axes, forces)  # force line of each unit force
        self.line = array(2 * axes)  # force line of the known force
        self.known = array(KEPT + 1, axes) if known is None else known
        for i in each(2 * axes):
            self.line[i] = 0.0
            for force in each(forces):
                self.directions[i, force] = 0.0
        for i in each(axes):
            self.directions[i, 1 + i] = 1.0
        for k in each(KEPT + 1 if known is None else 0):
            for i in each(axes):
                self.known[k, i] = 0.0


def correct(m: Memory, s: Settings, room: Scratch, seen: Observation) -> None:
    """Correct the estimate z and P with a sample unless the filter has diverged; fill `room.acted`, the z to act on."""
    for i in each(len(room.acted)):  # also for a diverged filter, so that every entry is defined
        room.acted[i] = m.z[i]
    for _ in only(m.flags[FLAG.lost] == 0.0):
        take_in(m, room, seen)
        begin(m, s, room)
        _note_noise(m, s, room)
        before = array(len(s.reopening))
        for i in each(len(before)):
            before[i] = m.z[4 * len(m.noise) + i]
        surprise = update(m, s, room)
        m.flags[FLAG.surprise] += _SURPRISE_SHARE * (surprise - m.flags[FLAG.surprise])
        _doubt(m, s, maximum(0.0, surprise - 1.0))
        _note_moves(m, s, before)
        _confine(m, s)
        _note_swing(m, s)
        right = (m.flags[FLAG.surprise] < _DIVERGED) & (m.flags[FLAG.swing] < s.weights.largest_swing)
        m.flags[FLAG.lost] = select(right & _finite(m), m.flags[FLAG.lost], 1.0)
        _significant(m, s, room)


def take_in(m: Memory, room: Scratch, seen: Observation) -> None:
    """Store the measurements and the reference of a sample, and count the sample."""
    joints = len(m.noise)
    for j in range(joints):
        room.measured[j], room.measured[joints + j] = seen.q_motor[j], seen.dq_motor[j]
        for order, now in enumerate((seen.q_reference[j], seen.dq_reference[j], seen.ddq_reference[j])):
            for k in range(KEPT - 1, 0, -1):
                m.references[k, order, j] = m.references[k - 1, order, j]
            m.references[0, order, j] = now
    m.flags[FLAG.samples] = minimum(m.flags[FLAG.samples] + 1.0, _ENOUGH)


def begin(m: Memory, s: Settings, room: Scratch) -> None:
    """Initialise z and P if the sample is the first one of an episode.

    The initial z has the measured θ, q with K_t (θ - q) = g(q), links with the motors' velocities, and p = p_0; after
    an earlier pass, only the forces of p are reset.
    """
    joints = len(m.noise)
    bent, link, taught = array(joints), m.z[joints : 2 * joints], m.flags[FLAG.taught] != 0.0
    still, force = [0.0] * joints, [0.0] * room.known.shape[1]
    for _ in only(m.flags[FLAG.samples] == 1.0):
        arm = room.arm.constants_in(s.base)
        for _ in only(taught):
            _forget(m, s, 4 * joints + len(s.reopening))
        for _ in only(~taught):
            _forget(m, s, len(m.z))
        for j in range(joints):
            m.z[j] = link[j] = room.measured[j]
            m.z[2 * joints + j] = m.z[3 * joints + j] = room.measured[joints + j]
            m.noise[j] = s.variances[j]
            for part in each(len(m.read)):
                m.read[part, j] = room.measured[j]
            for k in range(1, KEPT):
                for order in range(3):
                    m.references[k, order, j] = m.references[0, order, j]
        for _ in each(_STATICS_STEPS):
            for j, tau in enumerate(room.arm.link_torque(link, still, still, force, arm)):
                bent[j] = tau
            for j in range(joints):
                link[j] = room.measured[j] - bent[j] / room.arm.drive(s.base, j).stiffness
        for k in each(len(m.commands)):
            for j in each(joints):
                m.commands[k, j] = bent[j]


def _forget(m: Memory, s: Settings, count: int) -> None:
    """Reset the first `count` entries of z: the covariance to its initial value, and the entries of p to p_0."""
    states = len(m.z) - len(s.guess)
    for i in each(count):
        for j in each(len(m.z)):
            m.P[i, j] = m.P[j, i] = 0.0
    for i in each(count):
        m.P[i, i] = s.spread[i] * s.spread[i]
        for j in each(count):
            m.P[i, j] += s.shared[i] * s.shared[j]
    for i in each(count - states):
        m.z[states + i] = s.guess[i]


def _note_noise(m: Memory, s: Settings, room: Scratch) -> None:
    """Estimate the variance σ² of the angles' noise from the part of their changes that velocities do not explain.

        e = θ - θ_last - T (θ̇ + θ̇_last)/2,    σ² ← σ² + share ((e - e_last)²/6 - σ²).

    Without noise, e is 0 for a torque that is constant between two samples, and e hardly changes if the loop vibrates.
    σ² is the mean over all samples from the third on, until the weight `share` has fallen to `_NOISE_SHARE`.
    """
    joints, samples = len(m.noise), m.flags[FLAG.samples]
    share = maximum(_NOISE_SHARE, 1.0 / maximum(samples - 2.0, 1.0))
    share = select(samples > 2.0, minimum(share, s.first_share), 0.0)
    for j in each(joints):
        angle, velocity = room.measured[j], room.measured[joints + j]
        rest = angle - m.read[0, j] - 0.5 * s.period * (velocity + m.read[1, j])
        change = rest - m.read[2, j]
        m.noise[j] += share * (change * change / _CHANGE - m.noise[j])
        m.read[0, j], m.read[1, j], m.read[2, j] = angle, velocity, rest
        ratio = s.variances[joints + j] / s.variances[j]
        room.silent[j] = s.weights.dead_zone * m.noise[j]
        room.silent[joints + j] = room.silent[j] * ratio
        room.variances[j] = maximum(s.variances[j], MISTRUST * m.noise[j])
        room.variances[joints + j] = room.variances[j] * ratio


def update(m: Memory, s: Settings, room: Scratch) -> Any:
    """Correct z and P by the measurements in `room`.

    Return the mean over them of the squared innovation, relative to its expected variance.
    """
    z, P, joints, surprise = m.z, m.P, len(room.measured) // 2, array(1)
    surprise[0] = 0.0
    for half in range(2):
        for joint in each(joints):
            k, at = half * joints + joint, 2 * half * joints + joint  # θ and θ̇ in x
            innovation = room.measured[k] - z[at]
            square, spread = innovation * innovation, P[at, at] + room.variances[k]
            room.innovation[k], room.expected[k], column = innovation, spread, room.columns[k]
            surprise[0] += square / spread
            spread = maximum(spread, square / s.gate)
            learned = maximum(0.0, 1.0 - room.silent[k] / (square + _TINY))
            kept = 1.0 - (1.0 - learned) * (1.0 - learned)
            for i in each(len(z)):
                column[i] = P[at, i]
            for i in each(len(z)):
                factor, shy = column[i] / spread, s.cautious[i] > 0.0
                z[i] += factor * innovation * select(shy, learned, 1.0)
                share = select(shy, kept, 1.0)
                for j in each(len(z)):
                    P[i, j] -= factor * column[j] * select(s.cautious[j] > 0.0, share, 1.0)
    return surprise[0] / (2.0 * joints)


def _doubt(m: Memory, s: Settings, surprise: Any) -> None:
    """Increase the variances of the delay and of the constants' common factor.

    `surprise` is the mean of ν² relative to its expected value, minus 1.
    """
    last, first, beliefs, least = len(m.z) - 1, len(m.z) - len(s.guess), len(s.guess), array(1)
    m.P[last, last] = minimum(m.P[last, last] + _LATENESS_DOUBT * surprise, s.spread[last] * s.spread[last])
    least[0] = _LARGEST_SCALE
    for belief in each(beliefs):
        i = first + belief
        least[0] = select(s.shared[i] > 0.0, minimum(least[0], m.P[i, i]), least[0])
    more = minimum(s.weights.scale_doubt * surprise, _LARGEST_SCALE - least[0])
    for belief in each(beliefs):
        for other in each(beliefs):
            i, k = first + belief, first + other
            m.P[i, k] = select((s.shared[i] > 0.0) & (s.shared[k] > 0.0), m.P[i, k] + more, m.P[i, k])


def _note_moves(m: Memory, s: Settings, before: Any) -> None:
    """Update `calm` and the variances of the forces after a correction; the forces were `before` (forces,) [N]."""
    first, forces = len(m.z) - len(s.guess), len(before)
    for i in each(forces):
        m.moves[i] += _SHARE * (m.z[first + i] - before[i] - m.moves[i])
    square = _summed(forces, lambda i: (m.z[first + i] - before[i]) * (m.z[first + i] - before[i]))
    mean = _summed(forces, lambda i: m.moves[i] * m.moves[i])
    m.moves[forces] += _SHARE * (square - m.moves[forces])
    directed = mean / (m.moves[forces] + s.still)
    calm = 1.0 - minimum(maximum((directed - _NOISE) / (_DIRECTED - _NOISE), 0.0), 1.0)
    change = calm - m.flags[FLAG.calm]
    stirred = change * _STIRRING
    for _ in only(change < 0.0):
        for i in each(forces):
            m.P[first + i, first + i] -= stirred * s.reopening[i]
    m.flags[FLAG.calm] += select(change < 0.0, stirred, change * _CALMING)


def _confine(m: Memory, s: Settings) -> None:
    """Clip the parameters p to their ranges, and adjust the other entries of z according to the covariance."""
    first = len(m.z) - len(s.low)
    for j in each(len(s.low)):
        at = first + j
        found = m.z[at]
        inside = minimum(maximum(found, s.low[j]), s.high[j])
        for _ in only(inside != found):
            share = (inside - found) / maximum(m.P[at, at], _TINY)
            for i in each(len(m.z)):
                m.z[i] += m.P[i, at] * share
            m.z[at] = inside
    for j in each(len(s.low)):
        m.z[first + j] = minimum(maximum(m.z[first + j], s.low[j]), s.high[j])


def _note_swing(m: Memory, s: Settings) -> None:
    """Include the last jump of the commands in their mean jump w, which is zero when an episode begins.

    w ← w + `_SWING_SHARE` (max_j |u_k - u_k-1| / u_max - w). If motors are much stronger or more delayed than
    estimated, commands swing between limits, and w approaches 2.
    """
    jump: Any = 0.0
    for j in range(len(m.noise)):
        jump = maximum(jump, abs(m.commands[0, j] - m.commands[1, j]) / s.limit[j])
    swing = select(m.flags[FLAG.samples] == 1.0, 0.0, m.flags[FLAG.swing])
    m.flags[FLAG.swing] = swing + _SWING_SHARE * (jump - swing)


def _finite(m: Memory) -> Any:
    """Return whether the sums of z and of P are finite."""
    size = len(m.z)
    total = _summed(size, lambda i: m.z[i]) + _summed(size, lambda i: _summed(size, lambda j: m.P[i, j]))
    return total - total == 0.0


def _significant(m: Memory, s: Settings, room: Scratch) -> None:
    """Fill `room.acted` with z, in which l_a replaces the load and x_a the state x, see the module's docstring."""
    joints, loads, acted, ratio = len(m.noise), len(s.reopening) + 1, room.acted, array(1)
    states, deviation, factor = 4 * joints, array(loads), array(loads, loads)  # P_ll⁻¹ (l - l_0), and L of P_ll = L Lᵀ
    ratio[0] = 0.0
    for i in each(len(acted)):
        acted[i] = m.z[i]
    for j in each(joints):
        ratio[0] = maximum(ratio[0], m.noise[j] / room.variances[j])
    for i in each(loads):
        acted[states + i] -= s.guess[i]
    _factorise(m.P[states : states + loads, states : states + loads], factor)
    _solve(factor, acted[states : states + loads], deviation)
    square = _dot(acted[states : states + loads], deviation, _TINY)
    kept = maximum(0.0, 1.0 - s.insignificant * m.flags[FLAG.calm] * ratio[0] / maximum(square, _TINY))
    for i in each(states):
        for k in each(loads):
            acted[i] -= (1.0 - kept) * m.P[i, states + k] * deviation[k]
    for i in each(loads):
        acted[states + i] = s.guess[i] + kept * acted[states + i]


def _dot(a: Any, b: Any, start: Any = 0.0) -> Any:
    """Return start + aᵀ b."""
    return _summed(len(a), lambda i: a[i] * b[i], start)


def _summed(count: int, term: Callable[[Any], Any], start: Any = 0.0) -> Any:
    """Return start + term(0) + ... + term(count - 1), added in this order."""
    total = array(1)
    total[0] = start
    for i in each(count):
        total[0] += term(i)
    return total[0]


def _factorise(A: Any, L: Any) -> None:
    """Fill the lower triangle of L, the Cholesky factor of A = L Lᵀ."""
    for i in each(len(A)):
        for j in each(i):
            L[i, j] = A[i, j]
            for k in each(j):
                L[i, j] -= L[i, k] * L[j, k]
            L[i, j] /= L[j, j]
        L[i, i] = A[i, i]
        for k in each(i):
            L[i, i] -= L[i, k] * L[i, k]
        L[i, i] = root(maximum(maximum(L[i, i], _ROUNDING * A[i, i]), _TINY))


def _solve(L: Any, b: Any, y: Any) -> None:
    """Fill y with the solution of L Lᵀ y = b."""
    for i in each(len(L)):
        y[i] = b[i]
        for k in each(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
    for behind in each(len(L)):
        i = len(L) - 1 - behind
        for later in each(behind):
            k = i + 1 + later
            y[i] -= L[k, i] * y[k]
        y[i] /= L[i, i]


def predict(m: Memory, s: Settings, room: Scratch, torque: Any) -> None:
    """Advance z and P to the next sample, with the commands that reach the motors until then.

    A diverged filter does not change. The filter is marked as diverged if the law's `torque` (n,) is not a number.
    """
    joints, last = len(m.noise), len(m.z) - 1
    for _ in only(m.flags[FLAG.lost] == 0.0):
        numbers_at(m.z[4 * joints :], s, room.numbers)
        lateness, wide = m.z[last], root(maximum(m.P[last, last], 0.0))
        early, late = maximum(lateness - wide, 0.0), minimum(lateness + wide, float(LONGEST_DELAY))
        applied, slope = array(joints), array(joints)
        total: Any = 0.0
        for j in range(joints):
            applied[j] = _mean_torque(m.commands, lateness, j)
            change = _mean_torque(m.commands, late, j) - _mean_torque(m.commands, early, j)
            slope[j] = change / maximum(late - early, 1e-9)
            total = total + torque[j]
        _spread_copies(m, s, room, applied, slope)
        room.arm.hold(*room.copies, s.substep, s.substeps)
        _step(m, s, room)
        _spread_out(m, s)
        m.flags[FLAG.lost] = select(total - total == 0.0, m.flags[FLAG.lost], 1.0)


def numbers_at(p: Any, s: Settings, numbers: Any) -> None:
    """Fill `numbers` with a = a_0 + S (p - p_0), the arm's constants for p."""
    for i in each(len(s.base)):
        numbers[i] = s.base[i]
        for j in each(len(p)):
            numbers[i] += s.slopes[i, j] * (p[j] - s.guess[j])


def _mean_torque(commands: Any, lateness: Any, joint: Any) -> Any:
    whole = floor(lateness)
    rest = lateness - whole
    return (1.0 - rest) * sent(commands, whole, joint) + rest * sent(commands, whole + 1.0, joint)


def command(m: Memory, s: Settings, torque: Any) -> None:
    """Store a torque (n,) [N m], clipped to its limits, as the command of this sample."""
    for j in each(len(m.noise)):
        for k in range(LONGEST_DELAY + 1, 0, -1):
            m.commands[k, j] = m.commands[k - 1, j]
        m.commands[0, j] = minimum(maximum(torque[j], -s.limit[j]), s.limit[j])


def sent(commands: Any, place: Any, joint: Any) -> Any:
    """Return ``commands[place, joint]`` [N m] by comparisons: no array index depends on data. Place 0 is the newest."""
    torque = commands[0, joint]
    for k in range(1, len(commands)):
        torque = select(place == float(k), commands[k, joint], torque)
    return torque


def fill(copies: _Copies, z: Any, room: Scratch) -> None:
    """Fill the copies of the arm with the state and the force of z and with the constants in `room`.

    Their torques do not change.
    """
    states = len(copies.state)
    for lane in each(copies.state.shape[1]):
        for i in each(states):
            copies.state[i, lane] = z[i]
        for i in each(len(room.numbers)):
            copies.numbers[i, lane] = room.numbers[i]
        for i in each(len(room.line)):
            copies.force[i, lane] = room.line[i]
            for j in each(room.directions.shape[1]):
                copies.force[i, lane] += room.directions[i, j] * z[states + j]


def _spread_copies(m: Memory, s: Settings, room: Scratch, torque: Any, torque_slope: Any) -> None:
    """Fill the copies of the arm for finite differences.

    The first is for z, the next are for z with one entry increased by a step, the last for z with one motor velocity
    reduced by a step. A motor velocity's step is its standard deviation, because a sticking joint would not respond to
    a small step. `torque` (n,) [N m] is the motors', `torque_slope` (n,) its derivative with respect to the delay.
    """
    state, torques, force, numbers = room.copies
    joints, states, size, forces = len(torque), len(state), len(m.z), len(s.reopening)
    offset = size - 1 - joints
    fill(room.copies, m.z, room)
    for lane in each(state.shape[1]):
        for j in each(joints):
            torques[j, lane] = torque[j] + m.z[offset + j]
    for j in each(states):
        state[j, 1 + j] += s.steps[j]
    for j in each(joints):
        at = 2 * joints + j
        room.wide[j] = maximum(root(maximum(m.P[at, at], 0.0)), s.steps[at])
        state[at, 1 + at] = m.z[at] + room.wide[j]
        state[at, 1 + size + j] = m.z[at] - room.wide[j]
    for j in each(forces):
        for i in each(len(force)):
            force[i, 1 + states + j] += room.directions[i, j] * s.steps[states + j]
    for other in each(size - states - 1 - forces):
        j = forces + other
        for i in each(len(numbers)):
            numbers[i, 1 + states + j] += s.slopes[i, j] * s.steps[states + j]
    for j in each(joints):
        torques[j, size] += torque_slope[j]
        torques[j, 1 + offset + j] += s.steps[offset + j]


def _step(m: Memory, s: Settings, room: Scratch) -> None:
    """Fill F = ∂x⁺/∂z, x⁺ the x at the next sample, from finite differences of `room.copies`; advance z and P."""
    state, F, FP, z, P = room.copies.state, room.F, array(*room.F.shape), m.z, m.P
    joints, states, size = len(room.wide), len(state), len(z)
    for i in each(states):
        for j in each(size - 1):
            F[i, j] = (state[i, 1 + j] - state[i, 0]) / s.steps[j]
        F[i, size - 1] = state[i, size] - state[i, 0]
        for j in each(joints):
            F[i, 2 * joints + j] = (state[i, 1 + 2 * joints + j] - state[i, 1 + size + j]) / (2.0 * room.wide[j])
    for i in each(states):
        z[i] = state[i, 0]
        for j in each(size):
            FP[i, j] = 0.0
        for k in each(size):
            slope = F[i, k]
            for j in each(size):
                FP[i, j] += slope * P[k, j]
    for i in each(states):
        for j in each(i + 1):
            P[i, j] = P[j, i] = _dot(FP[i], F[j])
        for other in each(size - states):
            j = states + other
            P[i, j] = P[j, i] = FP[i, j]
    for i in each(size):
        P[i, i] += s.noise[i]


def _spread_out(m: Memory, s: Settings) -> None:
    """Adjust the noise that `_step` added to P: reduce it for calm forces, raise it for motors after a torque jump."""
    joints, states = len(m.noise), 4 * len(m.noise)
    share = 1.0 - (1.0 - s.weights.calm_walk) * m.flags[FLAG.calm]
    for force in each(len(s.reopening)):
        i = states + force
        m.P[i, i] -= (1.0 - share * share) * s.noise[i]
    for j in each(joints):
        jump: Any = 0.0
        for k in range(LONGEST_DELAY + 1):
            jump = maximum(jump, abs(m.commands[k, j] - m.commands[k + 1, j]))
        wrong = s.doubt[j] * jump * jump
        m.P[2 * joints + j, 2 * joints + j] += wrong * wrong
