"""The elastic arm as a policy predicts it, sub-step by sub-step, for all states near a point at once.

One sub-step h of `envs.physics.integrator`, with torques u on the motors and d on the links:

    x_m = x + h/2 v,    v_m = v + kick(x_m, v; h/2),    v' = v + kick(x_m, v_m; h),    q' = q_m + h/2 q̇',    θ' = θ + e.

It is a computation, not a motion: what follows encloses its numbers, in floats or not. With R the torque of the links,

    R(q_m, q̇_m, a) = K φ_m + B φ̇_m + d,    R(q_m, q̇_m, a) - R_c = M(q_m) δa + [R(·, a_c) - R_c],

so δa is linear but for |M - M_c| |δa| + |R_q - G| ρ_q + |R_q̇ - D| ρ_q̇. A motor's velocity v and way e are those of
v̇ ∈ α - f Sgn(v) with constants α and f = F(v_m)/I_a, see `stick_slip`: continuous in (v, α, f) and smooth but for
corners, with 0 <= ∂v'/∂v <= 1, 0 <= ∂v'/∂α <= h, |∂v'/∂f| <= h, because friction does not part two motions, and
0 <= ∂e/∂v <= t, 0 <= ∂e/∂α <= t²/2, |∂e/∂f| <= t²/2, where t <= h bounds how long the motor can move.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from flint import arb

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Arm, coriolis_torque, dry_frictions, gravity_torque, solve_mass_matrix
from fuzzyarm.envs.physics.friction import stick_slip
from fuzzyarm.eval.certified.tip.curve import check_curve, steepest_fall, strength
from fuzzyarm.eval.certified.tip.defects import dry_friction
from fuzzyarm.eval.certified.tip.enclosures import ROUND_UP, SLACK, Jet, NoBound, ball, centre, low_high, radius_of
from fuzzyarm.eval.certified.tip.forms import Forms
from fuzzyarm.eval.certified.tip.remainders import link_slopes

__all__ = ["Predictor"]

ANGLE, LINK, SPEED, LINK_SPEED, LOAD, TORQUE, MIDDLE, LINK_MIDDLE, SPEED_MIDDLE, LINK_SPEED_MIDDLE = (
    slice(i * JOINTS, (i + 1) * JOINTS) for i in range(10)
)
"""Where the numbers of a sub-step lie: θ, q, θ̇, q̇, d, u, then those of its middle."""

ROUNDED = 2.0**-46  # relative: a number is computed from its terms in fewer than a hundred float operations
WORTH = 1e-4  # share of a spread from which a remainder is worth columns of its own


class _Kick(NamedTuple):
    """What a motor's velocity and way become, v' and e, linear in (v, α, v_m): middles, gains (3,) and rests."""

    speed: Any
    way: Any
    speed_gain: np.ndarray
    way_gain: np.ndarray
    speed_rest: float
    way_rest: float


class Predictor:
    """The arm that is predicted, with its constants, its sub-step h [s] and their number."""

    def __init__(self, arm: Arm, h: float, substeps: int) -> None:
        """Take the constants in floats, h and the number of sub-steps."""
        self._arm, self._h, self._substeps = arm, h, substeps
        self._inertia = np.array([arm.motor_inertia1, arm.motor_inertia2])
        self._stiffness = np.diag([arm.stiffness1, arm.stiffness2])
        self._damping = np.diag([arm.damping1, arm.damping2])
        self._viscous = np.diag([arm.viscous1, arm.viscous2])
        check_curve(arm)
        self._steepest = [steepest_fall(joint, arm) for joint in range(JOINTS)]

    def advance(self, forms: Forms) -> None:
        """Take θ, q, θ̇, q̇, d and u, the 12 numbers of `forms`, over all sub-steps; d and u stay."""
        for _ in range(self._substeps):
            self._substep(forms)

    def _substep(self, forms: Forms) -> None:
        h, half = arb(self._h), arb(0.5 * self._h)
        rows = np.zeros((2 * JOINTS, TORQUE.stop))
        for at, (angle, speed) in enumerate(((ANGLE, SPEED), (LINK, LINK_SPEED))):
            rows[at * JOINTS : (at + 1) * JOINTS, angle] = np.eye(JOINTS)
            rows[at * JOINTS : (at + 1) * JOINTS, speed] = 0.5 * self._h * np.eye(JOINTS)
        m = forms.balls()
        moved = [m[i] + half * m[SPEED.start + i] for i in range(2 * JOINTS)]
        forms.extend(rows, moved, ROUNDED * np.abs(rows) @ forms.largest())
        self._kick(forms, half, SPEED, LINK_SPEED, ways=False)
        self._kick(forms, h, SPEED_MIDDLE, LINK_SPEED_MIDDLE, ways=True)
        # After the numbers of the middle stand θ', θ̇', q̇'; and q' = q_m + h/2 q̇'.
        angle, speed, link_speed = (slice(i * JOINTS, (i + 1) * JOINTS) for i in range(10, 13))
        rows = np.zeros((JOINTS, link_speed.stop))
        rows[:, LINK_MIDDLE], rows[:, link_speed] = np.eye(JOINTS), 0.5 * self._h * np.eye(JOINTS)
        m = forms.balls()
        ends = [m[LINK_MIDDLE.start + j] + half * m[link_speed.start + j] for j in range(JOINTS)]
        forms.extend(rows, ends, ROUNDED * np.abs(rows) @ forms.largest())
        link = slice(link_speed.stop, link_speed.stop + JOINTS)
        order = (angle, link, speed, link_speed, LOAD, TORQUE)
        forms.keep([i for part in order for i in range(part.start, part.stop)])

    def _kick(self, forms: Forms, duration: arb, mid: slice, link_mid: slice, *, ways: bool) -> None:
        """Append θ', with `ways`, and the velocities after a kick; those of its middle are at `mid` and `link_mid`."""
        n, dt = len(forms.middle), float(duration)
        m = forms.balls()
        bend, rate = np.zeros((JOINTS, n)), np.zeros((JOINTS, n))
        bend[:, MIDDLE], bend[:, LINK_MIDDLE] = np.eye(JOINTS), -np.eye(JOINTS)
        rate[:, mid], rate[:, link_mid] = np.eye(JOINTS), -np.eye(JOINTS)
        joint = self._stiffness @ bend + self._damping @ rate
        drive = -joint
        drive[:, TORQUE] += np.eye(JOINTS)
        drive[:, mid] -= self._viscous
        drive /= self._inertia[:, np.newaxis]
        alpha, links = self._accelerations(m, mid, link_mid)
        q, dq = ([m[part.start + j] for j in range(JOINTS)] for part in (LINK_MIDDLE, link_mid))
        about = link_slopes([q, dq, links], (arb(0), arb(0)), self._arm)
        mass, stiff, damp = (np.array([[centre(x) for x in row] for row in part]) for part in about)
        inverse = np.linalg.inv(mass)
        push = joint.copy()
        push[:, LOAD] += np.eye(JOINTS)
        push[:, LINK_MIDDLE] -= stiff
        push[:, link_mid] -= damp
        wanted = [LINK_MIDDLE, link_mid, SPEED, mid]
        picked = np.eye(n)[[i for part in wanted for i in range(part.start, part.stop)]]
        spread = forms.spread(np.vstack([picked, drive, inverse @ push]))
        q_r, dq_r, v_r, vm_r, alpha_r, links_r = spread.reshape(6, JOINTS)
        box = [[x + ball(0.0, r) for x, r in zip(*p, strict=True)] for p in ((q, q_r.tolist()), (dq, dq_r.tolist()))]
        wide = link_slopes([*box, links], (arb(0), arb(0)), self._arm)
        left = self._left_out(wide, (mass, stiff, damp), (q_r, dq_r, links_r), inverse)
        sizes = forms.largest()
        terms = np.abs(joint) @ sizes + sizes[TORQUE] + sizes[LOAD]
        terms += self._others_size(sizes[link_mid])
        rounded = ROUNDED * terms
        turned = np.zeros((JOINTS, n))
        turned[:, LINK_SPEED] = np.eye(JOINTS)
        turned += dt * inverse @ push
        rest = dt * np.abs(inverse) @ (rounded + left)
        ends = [m[LINK_SPEED.start + j] + duration * links[j] for j in range(JOINTS)]
        kicks = []
        for j in range(JOINTS):
            alpha_r[j] += radius_of(alpha[j], centre(alpha[j]))
            at = centre(alpha[j]), float(forms.middle[SPEED][j]), float(forms.middle[mid][j])
            kicks.append(self._slid(j, duration, at, (alpha_r[j], v_r[j], vm_r[j])))
        self._append_motors(forms, kicks, drive, mid, (dt, rounded, v_r), ways=ways)
        grown = np.zeros((JOINTS, len(forms.middle)))
        grown[:, :n] = turned
        forms.extend(grown, ends, rest + ROUNDED * sizes[LINK_SPEED])

    def _append_motors(
        self,
        forms: Forms,
        kicks: list[_Kick],
        drive: np.ndarray,
        mid: slice,
        scale: tuple[float, np.ndarray, np.ndarray],
        *,
        ways: bool,
    ) -> None:
        """Append θ', if asked for, and θ̇' of both motors."""
        n, (dt, rounded, spread) = len(forms.middle), scale
        slow, far = np.zeros((JOINTS, n)), np.zeros((JOINTS, n))
        for j, kick in enumerate(kicks):
            for rows, gain in ((slow, kick.speed_gain), (far, kick.way_gain)):
                rows[j, SPEED.start + j] += gain[0]
                rows[j] += gain[1] * drive[j]
                rows[j, mid.start + j] += gain[2]
        speed_rest = np.array([kick.speed_rest for kick in kicks])
        worth = ways & (speed_rest > WORTH * spread)  # what acts on the middle alone does not count much
        own, lost = np.diag(np.where(worth, speed_rest, 0.0)), np.where(worth, 0.0, speed_rest)
        lost += dt * rounded / self._inertia + ROUNDED * (np.abs(forms.middle[SPEED]) + spread)
        if ways:
            far[:, ANGLE] += np.eye(JOINTS)
            at = [arb(float(x)) + kick.way for x, kick in zip(forms.middle[ANGLE], kicks, strict=True)]
            rest = np.array([kick.way_rest for kick in kicks]) + dt * lost + ROUNDED * forms.largest()[ANGLE]
            forms.extend(np.vstack([far, slow]), [*at, *(k.speed for k in kicks)],
                         np.concatenate([rest, lost]), np.vstack([0.5 * dt * own, own]))  # fmt: skip
        else:
            forms.extend(slow, [k.speed for k in kicks], lost)

    def _accelerations(self, m: list[Any], mid: slice, link_mid: slice) -> tuple[list[Any], list[Any]]:
        """Return α of the motors without dry friction, and a of the links [rad/s²], at the middle."""
        arm = self._arm
        stiffness, damping = (arm.stiffness1, arm.stiffness2), (arm.damping1, arm.damping2)
        viscous, alpha, outer = (arm.viscous1, arm.viscous2), [], []
        q, dq = ([m[part.start + j] for j in range(JOINTS)] for part in (LINK_MIDDLE, link_mid))
        others = self._others(q, dq)
        for j in range(JOINTS):
            speed = m[mid.start + j]
            torque = stiffness[j] * (m[MIDDLE.start + j] - q[j]) + damping[j] * (speed - dq[j])
            alpha.append((m[TORQUE.start + j] - torque - viscous[j] * speed) / self._inertia[j].item())
            outer.append(torque + m[LOAD.start + j] - others[j])
        return alpha, list(solve_mass_matrix(q[1].cos(), outer[0], outer[1], arm))

    def _others_size(self, speed: np.ndarray) -> float:
        """Return a bound of all terms of C q̇ + g and of the friction, for |q̇| <= speed [N m]."""
        arm = self._arm
        fast = float(speed.sum())
        return float(
            2.0 * (arm.c4 + 2.0 * arm.c5 + arm.c2 * fast * fast)
            + 4.0 * sum(dry.static_friction for dry in dry_frictions(arm))
        )

    def _others(self, q: list[Any], dq: list[Any]) -> list[Any]:
        """Return C q̇ + g [N m]."""
        coriolis = coriolis_torque(q[1].sin(), dq[0], dq[1], self._arm)
        gravity = gravity_torque(q[0].sin(), (q[0] + q[1]).sin(), self._arm)
        return [a + b for a, b in zip(coriolis, gravity, strict=True)]

    @staticmethod
    def _left_out(
        wide: Any, about: tuple[np.ndarray, ...], spread: tuple[np.ndarray, ...], inverse: np.ndarray
    ) -> np.ndarray:
        """Return what the linear equation of the links leaves out (2,) [N m]."""
        mass, stiff, damp = (
            np.array(
                [[radius_of(x, c) for x, c in zip(*row, strict=True)] for row in zip(part, of.tolist(), strict=True)]
            )
            for part, of in zip(wide, about, strict=True)
        )
        fixed = stiff @ spread[0] + damp @ spread[1]
        reach = spread[2] + np.abs(inverse) @ fixed
        claimed = 1.1 * reach + 1e-12
        if not (reach + np.abs(inverse) @ (mass @ claimed) * ROUND_UP < claimed).all():
            raise NoBound("the predictor's links may be anywhere: its tube is too wide for their inertia")
        return np.asarray((fixed + mass @ claimed) * ROUND_UP)

    def _slid(self, joint: int, duration: arb, at: tuple[float, ...], spread: tuple[float, ...]) -> _Kick:
        """Return v' and e of a motor with α, v and v_m within `spread` of `at`."""
        (alpha, v, vm), (alpha_r, v_r, vm_r), dt = at, spread, float(duration)
        inertia = float(self._inertia[joint])
        slowest, fastest = max(0.0, abs(vm) - vm_r), abs(vm) + vm_r
        weak, strong = (x / inertia for x in strength(slowest, fastest, joint, self._arm))
        f = dry_friction(ball(vm), joint, self._arm) / inertia
        slack = SLACK * (abs(v) + v_r + dt * (abs(alpha) + alpha_r + strong))
        for side in (1.0, -1.0):
            low = side * v - v_r
            if low >= 0.0 and low + dt * (side * alpha - alpha_r - strong) >= slack:
                return self._slipping(joint, duration, at, side, vm_r, f)
        speed, way = stick_slip(ball(v), ball(alpha), f, duration)
        pulled, fast = abs(alpha) + alpha_r, abs(v) + v_r
        if pulled < weak and fast + dt * (pulled - weak) <= -slack:
            t = fast / (weak - pulled) * ROUND_UP
            rest = 0.5 * t * v_r + 0.25 * t * t * alpha_r + 0.5 * t * t * (strong - weak)
            return _Kick(arb(0), way, np.zeros(3), np.array([0.5 * t, 0.25 * t * t, 0.0]), 0.0, rest * ROUND_UP)
        part = 0.5 * v_r + 0.5 * dt * alpha_r + dt * (strong - weak)
        if part <= dt * strong:
            way_gain = np.array([0.5 * dt, 0.25 * dt * dt, 0.0])
            return _Kick(
                speed, way, np.array([0.5, 0.5 * dt, 0.0]), way_gain, part * ROUND_UP, 1.5 * dt * part * ROUND_UP
            )
        free = ball(v) + duration * ball(alpha)
        gains = np.array([1.0, dt, 0.0]), np.array([dt, 0.5 * dt * dt, 0.0])
        way = duration * (ball(v) + free) / 2
        return _Kick(free, way, *gains, dt * strong * ROUND_UP, 0.25 * dt * dt * strong * ROUND_UP)

    def _slipping(self, joint: int, duration: arb, at: tuple[float, ...], side: float, vm_r: float, f: Any) -> _Kick:
        """Return v' = v + h (α ∓ f) and e = h (v + v')/2 of a motor that turns to one side."""
        (alpha, v, vm), dt, inertia = at, float(duration), float(self._inertia[joint])
        slope = dry_friction(Jet.variable(ball(vm, vm_r), 0), joint, self._arm).slope(0)
        low, high = low_high(slope)
        low, high = max(low, -self._steepest[joint]), min(high, self._steepest[joint])
        gain = -side * 0.5 * (low + high) * dt / inertia
        rest = 0.5 * (high - low) * dt / inertia * vm_r * ROUND_UP + SLACK * abs(gain) * vm_r
        speed = ball(v) + duration * (ball(alpha) - side * f)
        gains = np.array([1.0, dt, gain]), 0.5 * dt * np.array([2.0, dt, gain])
        return _Kick(speed, duration * (ball(v) + speed) / 2, *gains, rest, 0.0)
