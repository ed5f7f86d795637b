"""The parameters of a robot with n joints from logs: weighted linear least squares over physically possible bodies.

With motor and link as one body, the torques are linear in ten parameters of each link, in the frame of its joint, and
four of each joint (rotor inertia, viscous friction, Coulomb friction and a constant offset):

    Γ = Y(q, q̇, q̈) π = Σ_i Y_i (m, m c, J)_i + I_a q̈ + f_v q̇ + Γ_fc sign q̇ + offset

Link i has columns Y_i, mass m, mass center c and inertia J about the frame's origin. The logs determine only as many
combinations of the links' parameters as Y has independent columns; the starting robot, a weak prior, determines the
others. A body is possible if its pseudo-inertia is positive definite (Wensing, Kim, Slotine 2018):

    [[½ tr(J) 1 - J, m c], [(m c)ᵀ, m]] > 0

The alternating direction method of multipliers (ADMM) finds the best bodies, with non-negative rotor inertias and
friction: its projection cuts off negative eigenvalues. Rows that fit badly have less weight (Huber).
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import qr
from scipy.stats import t as student

from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.joint import DIMENSIONS, Link, as_rows
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.identification.log import Log, Motion

__all__ = ["RobotFit", "body_regressor", "estimated_robot"]

_BODY, _DRIVE = 10, 4  # parameters of a link and of a joint
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # entries of J, in their order in π
_ENTRIES = tuple("xyz"[i] + "xyz"[j] for i, j in _PAIRS)
_SLOWEST = 0.05  # rad/s: below this speed, the sign of a joint's friction is uncertain
_HUBER, _PASSES = 2.5, 4  # standard deviations; number of fits
_MOST = 4000  # samples
_PRIOR = 1e-3  # weight of the prior relative to all samples
_LEAST = 1e-6  # smallest eigenvalue of a scaled pseudo-inertia
_ITERATIONS, _CLOSE, _BALANCED = 4000, 1e-9, 10.0
_TOLD, _LEVEL = 0.1, 0.975
_GROUPS, _PARTS = 5, 3
_RANK = 1e-8
_QUANTITIES = ("motor_inertia", "viscous_friction", "coulomb_friction")
_UNITS = ("kg m^2", "N m s/rad", "N m")


class RobotFit(NamedTuple):
    """The robot that fits the logs, with a table row for each joint parameter, held-out errors and torque curves."""

    robot: Robot
    rows: tuple[dict[str, Any], ...]
    held_out: dict[str, tuple[float, ...]]  # share of each joint's torque left unexplained, for start and robot
    remarks: tuple[str, ...]
    curves: list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]  # name, times [s], measured and computed torques
    interrupted: bool


class _LogSamples(NamedTuple):
    """Samples of one log, or of a part of one."""

    Y: np.ndarray  # (N, n, 14 n)
    torque: np.ndarray  # (N, n) [N m]
    moving: np.ndarray  # whether a joint is faster than `_SLOWEST`, (N, n)
    time: np.ndarray  # (N,) [s]


def body_regressor(robot: Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """Return the columns of Y for the links, (N, n, 10 n), at q, q̇ and q̈ (N, n); order (m, m c, J) for each link.

    A column is the torque of a robot with one parameter 1, others 0.
    The column of a moment m c is the difference between the columns of two bodies of mass 1.
    """
    n, body = len(robot), Link(1.0, (0.1, 0.2, 0.3), ((1.0, 0.1, 0.2), (0.1, 1.1, 0.3), (0.2, 0.3, 1.2)))
    general = dataclasses.replace(  # so that its equations contain every parameter of a link
        robot, joints=tuple(dataclasses.replace(joint, link=body) for joint in robot.joints)
    )
    physics = equations_of(general)
    plant = physics.plant_of(general)._asdict()
    names = ["mass", *(f"center{axis}" for axis in "xyz"), *(f"inertia{entry}" for entry in _ENTRIES)]
    for k in range(n):
        for place, name in enumerate(names):
            column = np.zeros((_BODY * n, 1))
            column[_BODY * k + place] = 1.0
            if place == 0:
                column[_BODY * k : _BODY * k + 1 + DIMENSIONS] = 1.0
            if name[:-2] == "inertia" and name[-1] == name[-2]:  # so that J of a mass at a distance of 1 is 0
                others = [_BODY * k + 1 + axis for axis in range(DIMENSIONS) if "xyz"[axis] != name[-1]]
                column[others] = -1.0
            quantity, part = (
                (name, "") if place == 0 else (name[:6], name[6:]) if place <= DIMENSIONS else ("inertia", name[7:])
            )
            plant[f"{quantity}{k + 1}{part}"] = column
    arm = physics.constants(physics.Plant(**plant), 0.0, 0.0, 0.0)
    motion = (physics.PerJoint(*part.T) for part in (q, dq, ddq))
    found = physics.inverse_dynamics(*motion, arm)
    Y = np.stack([np.broadcast_to(row, (_BODY * n, len(q))) for row in found], axis=-1).transpose(1, 2, 0).copy()
    for k in range(n):
        Y[..., _BODY * k + 1 : _BODY * k + 1 + DIMENSIONS] -= Y[..., _BODY * k : _BODY * k + 1]
    return Y


def _numbers_of(robot: Robot) -> np.ndarray:
    """Return the parameters π (14 n,) of a robot: those of all links, ten each, then those of all joints, four each."""
    now, links = robot.arrays, []
    for mass, center, inertia in zip(now.mass, now.center, now.inertia, strict=True):
        J = inertia + mass * (center @ center * np.eye(DIMENSIONS) - np.outer(center, center))
        links += [mass, *(mass * center), *(J[i, j] for i, j in _PAIRS)]
    drives = [[*(getattr(joint.drive, name) for name in _QUANTITIES), 0.0] for joint in robot.joints]
    return np.array([*links, *np.ravel(drives)])


def _robot_with(pi: np.ndarray, start: Robot) -> Robot:
    """Return `start` with the parameters π (14 n,); ratios of static to Coulomb friction are kept."""
    joints = []
    for k, joint in enumerate(start.joints):
        mass, *moment = pi[_BODY * k : _BODY * k + 1 + DIMENSIONS].tolist()
        center, J = np.array(moment) / mass, np.zeros((DIMENSIONS, DIMENSIONS))
        for (i, j), value in zip(_PAIRS, pi[_BODY * k + 1 + DIMENSIONS : _BODY * (k + 1)], strict=True):
            J[i, j] = J[j, i] = value
        inertia = J - mass * (center @ center * np.eye(DIMENSIONS) - np.outer(center, center))
        first = _BODY * len(start) + _DRIVE * k
        rotor, viscous, coulomb = pi[first : first + len(_QUANTITIES)].tolist()
        old = joint.drive
        ratio = old.static_friction / old.coulomb_friction if old.coulomb_friction else 1.0
        drive = dataclasses.replace(
            old,
            motor_inertia=rotor,
            viscous_friction=viscous,
            coulomb_friction=coulomb,
            static_friction=ratio * coulomb,
        )
        link = Link(mass, tuple(center.tolist()), as_rows(inertia))
        joints.append(dataclasses.replace(joint, link=link, drive=drive))
    return dataclasses.replace(start, joints=tuple(joints))


def _samples_of(robot: Robot, motion: Motion, period: float, most: int) -> _LogSamples:
    every = max(1, int((motion.settled.stop - motion.settled.start) / min(2.0 * motion.independent, most)))
    q, dq, ddq, torque = (part[motion.settled][::every] for part in motion[:4])
    n, drive = len(robot), np.zeros((*q.shape, _DRIVE * len(robot)))
    for k in range(n):
        columns = ddq[:, k], dq[:, k], np.sign(dq[:, k]), np.ones(len(q))
        drive[:, k, _DRIVE * k : _DRIVE * (k + 1)] = np.stack(columns, axis=-1)
    Y = np.concatenate([body_regressor(robot, q, dq, ddq), drive], axis=-1)
    time = (motion.settled.start + every * np.arange(len(q))) * period
    return _LogSamples(Y, torque, np.abs(dq) > _SLOWEST, time)


class _Cones:
    """The scaled pseudo-inertias of all links, and the parameters of the joints, as linear functions of scaled π."""

    def __init__(self, robot: Robot) -> None:
        n = len(robot)
        ends = [np.linalg.norm(joint.position) for joint in robot.joints[1:]] + [np.linalg.norm(robot.tip)]
        reach = np.maximum(ends, [max(0.05, *map(abs, joint.link.center)) for joint in robot.joints])
        start = _numbers_of(robot)
        scale = []
        for mass, length in zip(robot.arrays.mass, reach, strict=True):
            scale += [mass, *[mass * length] * DIMENSIONS, *[mass * length**2] * len(_PAIRS)]
        least = [[0.0, *[1e-2 * joint.drive.torque_limit] * (_DRIVE - 1)] for joint in robot.joints]
        self.scale = np.array([*scale, *np.maximum(start[_BODY * n :], np.ravel(least))])
        self.n, basis = n, np.zeros((_BODY, DIMENSIONS + 1, DIMENSIONS + 1))
        basis[0, -1, -1] = 1.0
        for axis in range(DIMENSIONS):
            basis[1 + axis, axis, -1] = basis[1 + axis, -1, axis] = 1.0
        for place, (i, j) in enumerate(_PAIRS, start=1 + DIMENSIONS):
            basis[place, i, j] -= 1.0
            basis[place, j, i] = basis[place, i, j]
            if i == j:
                basis[place, range(DIMENSIONS), range(DIMENSIONS)] += 0.5
        flat = basis.reshape(_BODY, -1).T
        self.matrix = np.zeros((len(flat) * n + _DRIVE * n, len(self.scale)))
        for k in range(n):
            self.matrix[len(flat) * k : len(flat) * (k + 1), _BODY * k : _BODY * (k + 1)] = flat
        self.matrix[len(flat) * n :, _BODY * n :] = np.eye(_DRIVE * n)
        self._links, self._back = len(flat) * n, np.linalg.pinv(self.matrix)
        self._offsets = np.arange(_DRIVE * n) % _DRIVE == _DRIVE - 1

    def projected(self, values: np.ndarray) -> np.ndarray:
        """Return the physically possible numbers nearest to `values` (20 n,).

        Argument and result: scaled pseudo-inertias of the links, 16 entries each, then scaled parameters of the joints.
        """
        bodies = values[: self._links].reshape(self.n, DIMENSIONS + 1, DIMENSIONS + 1)
        size, turn = np.linalg.eigh(0.5 * (bodies + bodies.transpose(0, 2, 1)))
        bodies = (turn * np.maximum(size, _LEAST)[:, np.newaxis]) @ turn.transpose(0, 2, 1)
        drives = values[self._links :]
        return np.concatenate([bodies.ravel(), np.where(self._offsets, drives, np.maximum(drives, _LEAST))])

    def minimum(self, H: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the scaled π that minimises ½ πᵀ H π - bᵀ π among physically possible robots, by ADMM."""
        weight = float(np.exp(np.mean(np.log(np.maximum(np.diag(H), 1e-12 * np.diag(H).max())))))
        z = self.projected(self.matrix @ np.linalg.solve(H, b))
        dual, factor = np.zeros(len(z)), None
        for k in range(_ITERATIONS):
            if factor is None:
                factor = np.linalg.inv(H + weight * self.matrix.T @ self.matrix)
            y = factor @ (b + weight * self.matrix.T @ (z - dual))
            before, image = z, self.matrix @ y
            z = self.projected(image + dual)
            dual = dual + image - z
            apart, moved = float(np.linalg.norm(image - z)), float(np.linalg.norm(z - before))
            if max(apart, moved) < _CLOSE * float(np.linalg.norm(z)):
                break
            if k % 50 == 49 and max(apart, moved) > _BALANCED * min(apart, moved):
                change = 3.0 if apart > moved else 1.0 / 3.0
                weight, dual, factor = weight * change, dual / change, None
        return np.asarray(self._back @ z)


class _Fit(NamedTuple):
    pi: np.ndarray  # (14 n,)
    deviation: np.ndarray  # of each parameter for independent noise, in scales, (14 n,)
    half_width: np.ndarray | None  # of the 95 % intervals between logs, (14 n,)


def _fitted(parts: Sequence[_LogSamples], start: Robot, cones: _Cones, told: np.ndarray) -> _Fit:
    """Return the fit of a robot to logs; joint parameters outside the mask `told` (4 n,) stay near those of `start`."""
    prior, n, sigma = _numbers_of(start), len(start), np.ones(len(start))
    weights = [part.moving.astype(float) for part in parts]
    pi = prior
    for k in range(_PASSES):
        slopes = []
        for part, weight in zip(parts, weights, strict=True):
            Y = part.Y * cones.scale
            slopes.append((np.einsum("ijp,ij,ijq->pq", Y, weight / sigma**2, Y, optimize=True),
                           np.einsum("ijp,ij,ij->p", Y, weight / sigma**2, part.torque)))  # fmt: skip
        H, b = (sum(one[place] for one in slopes) for place in (0, 1))
        known = np.full(len(b), _PRIOR * float(np.sum([weight.sum() for weight in weights])) / len(b))
        known[_BODY * n :] *= np.where(told, 1e-3, 1.0)
        full = H + np.diag(known)
        pi = cones.scale * cones.minimum(full, b + known * prior / cones.scale)
        if k < _PASSES - 1:
            left = [part.torque - part.Y @ pi for part in parts]
            size = np.concatenate([np.where(part.moving, one, np.nan) for part, one in zip(parts, left, strict=True)])
            sigma = np.maximum(1.4826 * np.nanmedian(np.abs(size), axis=0), 1e-6)
            weights = [
                part.moving * np.minimum(1.0, _HUBER * sigma / np.maximum(np.abs(one), 1e-12))
                for part, one in zip(parts, left, strict=True)
            ]
    inverse = np.linalg.inv(full)
    half, count = None, len(parts)
    if count > 1:
        gradients = np.array([b_l - H_l @ (pi / cones.scale) for H_l, b_l in slopes]) @ inverse
        spread = np.sqrt(np.sum(gradients**2, axis=0) * count / (count - 1))
        half = student.ppf(_LEVEL, count - 1) * spread * cones.scale
    return _Fit(pi, np.sqrt(np.diag(inverse)), half)


def estimated_robot(logs: Sequence[Log], start: Robot, advance: Callable[[], None]) -> RobotFit:
    """Return the robot that fits the logs best; frames, springs and limits are those of `start`.

    `advance` is called after each fit. ValueError: the joints rest in all logs.
    """
    parts = [_samples_of(start, log.smoothed(), log.period, _MOST // len(logs)) for log in logs]
    moving = np.concatenate([part.moving for part in parts])
    if not moving.any():
        raise ValueError(f"too little excitation: no joint exceeds {_SLOWEST:g} rad/s; record a faster motion")
    n, cones, interrupted = len(start), _Cones(start), False
    fit = _fitted(parts, start, cones, np.ones(_DRIVE * n, dtype=bool))
    advance()
    told = fit.deviation[_BODY * n :] < _TOLD
    if not told.all():
        fit = _fitted(parts, start, cones, told)
    robot, prior = _robot_with(fit.pi, start), _numbers_of(start)
    held: dict[str, tuple[float, ...]] = {"start": _shares([(part, prior) for part in parts])}
    try:
        if len(parts) == 1:
            cut = np.arange(len(parts[0].torque)) * _PARTS // len(parts[0].torque)
            pieces = [_LogSamples(*(values[cut == k] for values in parts[0])) for k in range(_PARTS)]
        else:
            pieces = parts
        groups, pairs = min(len(pieces), _GROUPS), []
        for group in range(groups):
            others = _fitted([one for k, one in enumerate(pieces) if k % groups != group], start, cones, told)
            pairs += [(one, others.pi) for k, one in enumerate(pieces) if k % groups == group]
            advance()
        held["robot"] = _shares(pairs)
    except KeyboardInterrupt:
        interrupted = True
    rows = []
    for k, joint in enumerate(start.joints):
        for place, (name, unit) in enumerate(zip(_QUANTITIES, _UNITS, strict=True), start=_BODY * n + _DRIVE * k):
            known = bool(told[place - _BODY * n])
            half = np.nan if fit.half_width is None else fit.half_width[place]
            ends = (None, None) if not known or np.isnan(half) else (fit.pi[place] - half, fit.pi[place] + half)
            low, high = (None if end is None else float(end) for end in ends)
            rows.append({
                "name": f"{joint.name}: {name}", "unit": unit, "start": float(prior[place]),
                "value": float(fit.pi[place]), "low": low, "high": high, "told": known, "needed": False,
            })  # fmt: skip
    Y = np.concatenate([part.Y[..., : _BODY * n].reshape(-1, _BODY * n) * cones.scale[: _BODY * n] for part in parts])
    diagonal = np.abs(np.diag(qr(Y, mode="r", pivoting=True)[0]))
    remarks = [
        f"The logs determine {np.count_nonzero(diagonal > _RANK * diagonal[0])} combinations of the {_BODY * n} "
        "numbers of the links; the others are those of the starting arm and do not affect the torques.",
        "Stiffness, damping and friction at rest are not determined: they are those of the starting arm.",
    ]
    offsets = fit.pi[_BODY * n + _DRIVE - 1 :: _DRIVE]
    if np.any(np.abs(offsets) > 0.02 * np.concatenate([part.torque for part in parts]).std(axis=0)):
        values = ", ".join(f"{value:.3g}" for value in offsets)
        remarks.append(f"The file leaves out the constant torques that were found: {values} N m.")
    if len(parts) == 1:
        remarks.append("One log does not show how the values differ between logs, so there are no intervals.")
    curves = [(log.name, part.time, part.torque, part.Y @ fit.pi) for log, part in zip(logs, parts, strict=True)]
    return RobotFit(robot, tuple(rows), held, tuple(remarks), curves, interrupted)


def _shares(pairs: Sequence[tuple[_LogSamples, np.ndarray]]) -> tuple[float, ...]:
    """Return, for each joint, rms residual over rms torque; `pairs` are samples with the parameters π (14 n,).

    The torque counts as at least a thousandth of the largest joint's, because a motor may be off.
    """
    left = np.concatenate([(part.torque - part.Y @ pi) * part.moving for part, pi in pairs])
    torque = np.sqrt(np.mean(np.concatenate([part.torque * part.moving for part, _ in pairs]) ** 2, axis=0))
    return tuple((np.sqrt(np.mean(left**2, axis=0)) / np.maximum(torque, 1e-3 * max(torque.max(), 1e-9))).tolist())
