"""Sets of initial states of a lap: a box about the environment's start, and sets that contain the ends of laps.

    x = c + C π + G g,      |g_i| <= 1,      π: the factors of the uncertain constants, the same in every lap.

x is the state of the tube: θ, q, θ̇, q̇, the policy's memory and, if torques act late, the torque that acts next. If
a lap ends within the set in which the next lap begins, the bounds of both laps hold in succession; if it ends within
its own initial set, they hold in every later lap.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.common.documents import read_json, read_toml, record
from fuzzyarm.proof.tip.enclosures import SLACK
from fuzzyarm.proof.tip.transition import layout
from fuzzyarm.proof.tip.zonotope import SOURCES, Zonotope, merged, reach

__all__ = ["LapSet", "StartBox"]

_Width = float | tuple[float, ...]  # one number for all joints, or one for each
_UNITS = {"angle": "rad", "bending": "rad", "velocity": "rad/s", "bending_velocity": "rad/s"}
_WIDEST = 1e3  # largest half width, in its unit
_KEPT = 1500  # columns of the end of a lap that remain separate in the set around it
_NARROW = 1e-6  # totals below which no column remains separate; such a set is far below any bound of interest
_ROOM, _WIDE_ROOM = 1.005, 1.5  # factors that enlarge this set, with and without separate columns
_LEAST = 1e-11, 1e-11, 1e-10, 1e-10  # least added reach in θ, q [rad], θ̇ and q̇ [rad/s]; for the others see `around`
_ALIKE = 0.9  # share of a column's norm that a multiple of another must remove, for the multiple to be used


@dataclasses.dataclass(frozen=True)
class StartBox:
    """Half the widths of a box about the environment's initial state: one number, or one for each joint or entry."""

    angle: _Width = 0.0  # of the motors, with the bending fixed [rad]
    bending: _Width = 0.0  # of the joints, θ - q [rad]
    velocity: _Width = 0.0  # of the motors, with the bending velocity fixed [rad/s]
    bending_velocity: _Width = 0.0  # of the joints, θ̇ - q̇ [rad/s]
    memory: float | tuple[float, ...] = 0.0  # of the policy's memory, in its units; one number, or one for each entry

    def __post_init__(self) -> None:
        for name in (*_UNITS, "memory"):
            given, unit = getattr(self, name), _UNITS.get(name, "")
            if isinstance(given, tuple | list):
                widths: Any = checks.reals(name, given, len(given), unit, low=0.0, high=_WIDEST)
                widths = widths[0] if name in _UNITS and len(set(widths)) == 1 else widths
            else:
                widths = checks.real(name, given, unit, low=0.0, high=_WIDEST)
            object.__setattr__(self, name, widths)

    @classmethod
    def of(cls, words: Sequence[str]) -> StartBox:
        """Return the box from the name of a TOML or JSON file of the fields, or from one number for each field."""
        if len(words) == len(dataclasses.fields(cls)):
            try:
                return cls(*map(float, words))
            except ValueError as error:
                raise ValueError(f"start: {error}") from None
        path = Path(words[0])
        if len(words) > 1 or path.suffix not in (".toml", ".json"):
            names = ", ".join(field.name for field in dataclasses.fields(cls))
            raise ValueError(
                f"start = {checks.shown(' '.join(words))} must be a .toml or .json file, or one number for each of "
                f"{names}"
            )
        try:
            return record(read_toml(path) if path.suffix == ".toml" else read_json(path), cls)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}: {error}") from None

    def in_words(self) -> str:
        """Return the half widths that are not zero as text: "angle ± 0.0005 rad, ..."."""

        def numbers(width: Any) -> str:
            return " and ".join(map(repr, width)) if isinstance(width, tuple) else repr(width)

        named = {name: getattr(self, name) for name in (*_UNITS, "memory")}
        parts = [f"{k.replace('_', ' ')} ± {numbers(w)} {_UNITS.get(k, '')}".strip() for k, w in named.items() if w]
        return ", ".join(parts) or "one state"

    def columns(self, joints: int, numbers: int, memory: int) -> np.ndarray:
        """Return the box as columns (numbers, 4 · joints + memory).

        `numbers` is the length of x, `memory` that of the memory.
        """
        if isinstance(self.memory, tuple) and len(self.memory) != memory:
            raise ValueError(f"memory has {len(self.memory)} numbers; this policy needs {memory}")
        for name in _UNITS:
            if isinstance(width := getattr(self, name), tuple) and len(width) != joints:
                raise ValueError(f"{name} has {len(width)} numbers; needed: one for each of the {joints} joints")
        halves = [np.broadcast_to(getattr(self, name), joints) for name in _UNITS]
        rows, states = layout(joints, 2).rows, 4 * joints
        made = np.zeros((numbers, states + memory))
        angle, bending = np.diag(np.concatenate(halves[0::2])), np.diag(np.concatenate(halves[1::2]))
        motors, links = np.r_[rows.theta, rows.d_theta], np.r_[rows.link, rows.d_link]
        made[np.ix_(motors, range(len(angle)))], made[np.ix_(links, range(len(angle)))] = angle, angle
        made[np.ix_(links, range(len(angle), states))] = -bending
        made[states : states + memory, states:] = np.diag(np.broadcast_to(self.memory, memory))
        return made


class LapSet(NamedTuple):
    """A set of states x, each with `numbers` entries, in which a lap begins."""

    centre: np.ndarray  # c of θ, q, θ̇, q̇ (8,)
    memory: np.ndarray  # c of the policy's memory (m,)
    waiting: np.ndarray  # c of the torque that acts next (2,) [N m]; (0,) if torques do not act late
    constants: np.ndarray  # C (numbers, constants)
    columns: np.ndarray  # G (numbers, n); the last `numbers` of them are linearly independent

    @classmethod
    def around(cls, point: tuple[np.ndarray, np.ndarray, np.ndarray], deviations: Zonotope) -> LapSet:
        """Return a set that contains the end of a lap: a point c plus deviations.

        `point` is c: state (8,), memory (m,) and waiting torque (0 or 2,). The largest columns of the deviations
        remain; a parallelepiped encloses all others.
        """
        constants, others = _parted(deviations)
        totals = deviations.totals()
        apart, room = (_KEPT, _ROOM) if totals.max() > _NARROW else (0, _WIDE_ROOM)
        states = len(point[0])
        least = np.concatenate([np.repeat(_LEAST, states // len(_LEAST)), 1e-3 * totals[states:] + 1e-13])
        order = np.argsort((1.0 / (totals + least)) @ -np.abs(others), kind="stable")
        kept, rest = others[:, order[:apart]], others[:, order[apart:]]
        block, missed = merged(np.hstack([rest, np.diag(deviations.box + least)]))
        W = np.linalg.inv(block)
        block = block * (room + (room - 1.0) * reach(W, kept) + np.abs(W) @ missed)
        return cls(*point, constants, np.hstack([room * kept, block]))

    def deviations(self) -> Zonotope:
        """Return C π + G g as a zonotope; the source of the columns G is the start of the lap."""
        numbers, constants = self.constants.shape
        made = Zonotope(numbers, constants)
        made.columns = np.hstack([self.constants, self.columns])
        made.source = np.concatenate([made.source, np.full(self.columns.shape[1], SOURCES.index("start of the lap"))])
        return made

    def filled(self, point: tuple[np.ndarray, np.ndarray, np.ndarray], deviations: Zonotope) -> float:
        """Return a bound on this set's |g_i| for all points of the end of a lap; at most 1 means that all lie inside.

        The end is the `point` c⁺ plus deviations, as in `around`, whose columns are C⁺ for the constants, and others.
        The end minus this set's c + C π is Y y, |y_i| <= 1, where Y has the columns c⁺ - c, C⁺ - C and the others.
        For G = [G', B] with B square and any matrix Γ', G g = Y y has a solution g = (g', g'') with g' = Γ' y and
        B g'' = z, z = (Y - G' Γ') y. For W near B⁻¹ and E = I - W B, |g''| <= |W z| + |E| max |W z| / (1 - max Σ |E|).
        """
        numbers, block = len(self.columns), self.columns[:, -len(self.columns) :]
        constants, others = _parted(deviations)
        if [*map(np.shape, self[:4]), numbers] != [*map(np.shape, (*point, constants)), len(others)]:
            return math.inf
        shift = np.concatenate(point)[:, np.newaxis] - np.concatenate(self[:3])[:, np.newaxis]
        kept, factors, rest = _shared(self.columns[:, :-numbers], others)
        try:
            W = np.linalg.inv(block)
        except np.linalg.LinAlgError:
            return math.inf
        sizes = np.abs(kept) @ np.abs(factors) + 2.0 * np.abs(others).sum(axis=1)
        columns = np.hstack([shift, constants - self.constants, rest])
        sizes += np.abs(columns[:, : 1 + constants.shape[1]]).sum(axis=1) + deviations.box
        image = reach(W, columns) + np.abs(W) @ (deviations.box + 4.0 * SLACK * sizes)
        error = np.abs(np.eye(numbers) - W @ block) + 4.0 * SLACK * np.abs(W) @ np.abs(block)
        left = 1.0 - error.sum(axis=1).max()
        if not left > 0.5:
            return math.inf
        own = (image + error.sum(axis=1) * image.max() / left) * (1.0 + 4.0 * SLACK)
        return float(max(own.max(), np.abs(factors).max(initial=0.0)))


def _parted(deviations: Zonotope) -> tuple[np.ndarray, np.ndarray]:
    """Return the zonotope's columns for the uncertain constants, and its other columns."""
    first = int((deviations.source < 0).sum())
    return deviations.columns[:, :first], deviations.columns[:, first:]


def _shared(kept: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Subtract from some of `columns` (numbers, n) a nearly equal multiple of a column of `kept` (numbers, k).

    No column is used twice. Return `kept`, the factors (k,) of its columns, within ±1 and 0 if unused, and `columns`
    after the subtraction.
    """
    if not kept.shape[1] or not columns.shape[1]:
        return kept, np.zeros(kept.shape[1]), columns
    units = np.abs(columns).sum(axis=1) + 1e-300
    a, b = kept / units[:, np.newaxis], columns / units[:, np.newaxis]
    long, wide = np.linalg.norm(a, axis=0), np.linalg.norm(b, axis=0)
    rest, factors, used = columns.copy(), np.zeros(kept.shape[1]), np.zeros(columns.shape[1], dtype=bool)
    for i in np.argsort(-long)[: np.count_nonzero(long)]:
        products = a[:, i] @ b
        distance = np.linalg.norm(b - a[:, [i]] * np.clip(products / long[i] ** 2, -1, 1), axis=0)
        gain = np.where(used, -1.0, wide - distance)
        j = int(np.argmax(gain))
        if gain[j] > _ALIKE * wide[j]:
            factors[i] = min(max(products[j] / long[i] ** 2, -1.0), 1.0)
            rest[:, j] -= factors[i] * kept[:, i]
            used[j] = True
    return kept, factors, rest
