"""The file of a proven bound: the claim, and the centre and the radii of the tube, from which it can be checked again.

A bound by cells has a file for the whole set and one file for each cell. The files contain no code. Every
float is written as the shortest decimal that identifies it, so it is read back exactly. Fields of both kinds of files:

    schema          fuzzyarm-tip-bound/2, of cells fuzzyarm-tip-cells/3
    policy, case    names
    arm             fields of `ArmParameters` or `Robot` for which the policy is loaded; null: those that its name
                    stands for
    set_name        a label
    plants          fields of `PlantSet`
    path            name of the path
    points          fields of `GivenPath`, a given path that replaces `path`; or null
    duration        of the motion [s], one lap of N = ceil(duration / T) control steps, T = 1 ms
    start           fields of `StartBox`, a box about the environment's start in which the first lap begins; null: none
    laps            "one"; or "ever": motion and case are repeated, and sample N of a lap is sample 0 of the next
    bound           bound on the tip error at every instant of all laps [m]

of a single bound:

    files           SHA-256 of the policy's files, by name
    tip             bounds on the tip error at the end of control steps 1 to n <= N of the first lap [m]
    whole           the same at every instant of each step, its ends included [m]
    steps           for each step its segments: duration [s]; modes and plans of the motors; angles (4, 8) [rad], the
                    coefficients in s in [-1, 1] of the centre's θ_1, θ_2, q_1, q_2; end (8,), its end; tube (18,)
    later           with laps "ever" one or more laps: `tip`, `whole` and `steps` as above, n = N; and `begin`, the set
                    x = c + C π + G g in which the lap begins, |g_i| <= 1, π: the factors of the uncertain constants.
                    x are θ, q, θ̇, q̇ (8); the entries of the policy's memory that depend on measurements (m); and, if
                    torques act late, the torque that acts next (2). `begin` has c as centre (8,), memory (m,) and
                    waiting (0 or 2,), C as constants and G as columns, both lists of columns. Each lap ends in the set
                    of the next lap; the last one ends in its own set, so its bounds hold in all laps that follow

and of cells: `samples`, the number of steps of the first lap that are bounded, and `cells`, the names of their files.
"""

import dataclasses
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from fuzzyarm.common.arithmetic import at_most
from fuzzyarm.common.checks import finite_array, instance, path_of, real
from fuzzyarm.common.console import escaped
from fuzzyarm.common.documents import DocumentError, check_schema, open_regular, read_json, record
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.envs.scenario.reference import PathReference
from fuzzyarm.policies.spec import load_policy, resolve, without_guest
from fuzzyarm.policies.tip_bound import (
    PERIOD,
    LapClaim,
    TipBound,
    TipClaim,
    arm_in_words,
    find_bound,
    plain,
)
from fuzzyarm.proof.tip.centre import DEGREE, Mode, Segment
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.friction_bounds import Plan
from fuzzyarm.proof.tip.laps import LapSet, StartBox
from fuzzyarm.proof.tip.period import TubeClaim
from fuzzyarm.proof.tip.plant import RANGES, SETS, PlantSet, check_set_name
from fuzzyarm.proof.tip.transition import StateLayout, layout
from fuzzyarm.proof.tip.tube import TubeStep

__all__ = ["BoundCheck", "CellBound", "check_bound", "is_bound", "save_bound", "save_cells"]

_SCHEMA, _CELLS_SCHEMA = "fuzzyarm-tip-bound/2", "fuzzyarm-tip-cells/3"  # of the file of a bound, and of one by cells
_LARGEST = 1e6  # largest value in a tube or a bound
_POINT = ("centre", "memory", "waiting")  # of a set in which a lap begins
_RECORDS: dict[str, Any] = {"arm": ArmParameters, "points": GivenPath, "start": StartBox}  # of a claim, where not None
_ROUNDING = 1 + 1e-9  # factor by which a recomputed value may differ


@dataclasses.dataclass(frozen=True)
class _Part:
    """A segment of the tube in the file."""

    duration: float
    modes: list[int]
    plans: list[str]
    angles: list[list[float]]
    end: list[float]
    tube: list[float]


@dataclasses.dataclass(frozen=True)
class _Begin:
    """The set of states in which a later lap begins, as in the file; for its fields, see the module."""

    centre: list[float]
    memory: list[float]
    waiting: list[float]
    constants: list[list[float]]
    columns: list[list[float]]

    @classmethod
    def of(cls, start: LapSet) -> Self:
        """Return the record of a `LapSet`."""
        parts = (*start[:3], start.constants.T, start.columns.T)
        return cls(*(part.tolist() for part in parts))

    def checked(self) -> LapSet:
        """Check the record and return its `LapSet`."""
        point = [
            finite_array(name, getattr(self, name), (len(getattr(self, name)),), largest=_LARGEST) for name in _POINT
        ]
        numbers = sum(map(len, point))
        constants, columns = (
            finite_array(
                name,
                getattr(self, name) or np.zeros((0, numbers)),
                (len(getattr(self, name)), numbers),
                largest=_LARGEST,
            )
            for name in ("constants", "columns")
        )
        if len(columns) < numbers:
            raise ValueError(f"a lap's initial set has {len(columns)} columns; needed: at least {numbers}")
        centre, memory, waiting = point
        return LapSet(centre, memory, waiting, constants.T, columns.T)


@dataclasses.dataclass(frozen=True)
class _LapDocument:
    """A lap after the first, as in the file; for its fields, see the module."""

    begin: _Begin
    tip: list[float]
    whole: list[float]
    steps: list[list[_Part]]


@dataclasses.dataclass(frozen=True)
class _Claimed:
    """The content shared by the files of a bound and of a bound by cells."""

    schema: str
    policy: str
    case: str
    arm: dict[str, Any] | None
    set_name: str
    plants: dict[str, Any]
    path: str
    points: dict[str, Any] | None
    duration: float
    start: dict[str, Any] | None
    laps: str
    bound: float

    @classmethod
    def of(cls, claim: TipClaim, **others: Any) -> Self:
        """Return the record of a claim; `others` are the fields that do not belong to the claim."""
        own = {name: getattr(claim, name) for name in ("policy", "case", "set_name", "path", "duration", "laps")}
        for name in _RECORDS:
            value = getattr(claim, name)
            own[name] = None if value is None else json.loads(json.dumps(dataclasses.asdict(value)))
        return cls(plants=claim.plants.to_dict(), **own, **others)

    def claim(self, samples: int) -> TipClaim:
        """Check the fields and return the claim, for a bound over `samples` control steps."""
        real("bound", self.bound, "m", low=0.0, high=_LARGEST)
        plants = record(self.plants, PlantSet)
        if self.set_name in SETS:  # any other label is a note of the file's maker, neither checked nor repeated
            check_set_name(self.set_name, plants)
        parts: dict[str, Any] = {
            name: None if (at := getattr(self, name)) is None else record(at, Robot if "joints" in at else kind)
            for name, kind in _RECORDS.items()
        }
        claim = TipClaim(
            self.policy, self.case, plants=plants, path=self.path, duration=self.duration, laps=self.laps, **parts
        )
        return dataclasses.replace(claim, steps=None if samples == claim.samples else samples)


@dataclasses.dataclass(frozen=True)
class _Document(_Claimed):
    """The content of the file of a bound."""

    files: dict[str, str]
    tip: list[float]
    whole: list[float]
    steps: list[list[_Part]]
    later: list[_LapDocument]


@dataclasses.dataclass(frozen=True)
class _CellsDocument(_Claimed):
    """The content of the file of a bound that is proven cell by cell."""

    samples: int
    cells: list[str]


@dataclasses.dataclass(frozen=True)
class BoundCheck:
    """The outcome of the check of a bound's file."""

    path: Path  # the file
    claim: TipClaim  # the claim of the file
    arm: AnyArm  # the arm in the middle of the set
    bound: float  # the claimed bound [m], or the recomputed one if rounding makes it larger
    reason: str  # why the claim is not proven; empty if it is
    seconds: float  # duration of the check
    # bound on the tip error at the end of each control step of the first lap [m], as the file states it; the largest
    # of all cells
    tip: np.ndarray
    cells: int | None = None  # number of cells, each of which has to be proven; None for a file of one tube

    @property
    def proven(self) -> bool:
        """Whether every period of each tube was confirmed, and the cells cover the set."""
        return not self.reason

    @property
    def sentence(self) -> str:
        """One sentence that states what is proven about the tip."""
        c, most = self.claim, at_most(1e3 * self.bound, 4)
        said = "claimed" if self.reason else "proven"
        motion = c.motion(len(self.tip))
        within = f"tip within {most} mm for set {c.named_set(self.arm)}, {said}"
        return f"{within} (elastic arm, {arm_in_words(self.arm)}; sampled control; {motion})"

    def reference(self) -> PathReference:
        """Return the motion for which the bound holds."""
        return self.claim.reference(self.arm)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        c = self.claim
        named = {"file": str(self.path), "policy": c.policy, "case": c.case, "set": c.named_set(self.arm)}
        found = {"proven": self.proven, "bound": self.bound, "reason": self.reason, "seconds": self.seconds}
        return named | found | ({} if self.cells is None else {"cells": self.cells})

    def to_text(self) -> str:
        """Return the outcome as text."""
        head = f"{escaped(str(self.path))}: {'PROVEN' if self.proven else 'NOT PROVEN'} ({self.seconds:.1f} s)"
        text = f"{head}\n  {plain(self.claim.policy)}: {self.sentence}"
        return text if self.proven else f"{text}\n  {escaped(self.reason)}"


def save_bound(bound: TipBound, path: Path) -> None:
    """Write the file of a proven bound, atomically."""
    c, path = instance("bound", bound, TipBound).claim, path_of("path", path)
    later = [
        _LapDocument(_Begin.of(lap.begin), lap.tip.tolist(), lap.whole.tolist(), _parts(lap.steps))
        for lap in bound.later
        if lap.begin is not None
    ]
    document = _Document.of(
        c, schema=_SCHEMA, bound=bound.largest, files=resolve(c.policy).files(), tip=bound.tip.tolist(),
        whole=bound.whole.tolist(), steps=_parts(bound.steps), later=later,
    )  # fmt: skip
    write_atomically(path, json.dumps(dataclasses.asdict(document)) + "\n")


def _parts(steps: Sequence[TubeStep]) -> list[list[_Part]]:
    return [
        [
            _Part(
                segment.duration, [int(m) for m in segment.modes], [p.value for p in closed.plans],
                segment.angles.tolist(), segment.end.tolist(), closed.tube.tolist(),
            )
            for segment, closed in zip(step.segments, step.closed, strict=True)
        ]
        for step in steps
    ]  # fmt: skip


class CellBound(NamedTuple):
    """A proven bound on the tip error for all plants of a cell, which is a part of a set."""

    plants: PlantSet  # the cell
    bound: float  # bound on the tip error [m]
    samples: int  # number of bounded samples of the motion
    path: Path | None  # file of the bound; None if no file was written


def save_cells(claim: TipClaim, found: Sequence[CellBound], path: Path) -> None:
    """Write the file of a bound by cells atomically: `claim`, and the names of the cells' files in the same folder."""
    names = [cell.path.name for cell in found if cell.path is not None]
    bound, samples = max(cell.bound for cell in found), found[0].samples
    document = _CellsDocument.of(claim, schema=_CELLS_SCHEMA, bound=bound, samples=samples, cells=names)
    write_atomically(path, json.dumps(dataclasses.asdict(document), indent=1) + "\n")


def is_bound(path: Path) -> bool:
    """Return whether a file begins with a schema of tip bounds, of any version; OSError if it cannot be read."""
    with open_regular(path) as file:
        begin = file.read(64)
    return any(schema.rpartition("/")[0].encode() in begin for schema in (_SCHEMA, _CELLS_SCHEMA))


def check_bound(path: Path) -> BoundCheck:
    """Check a file again, without any search: every period of each claimed tube, and the cover of the set by cells.

    ValueError if there is no such file, or it is damaged, or its policy has changed; OSError if it cannot be read.
    """
    content = read_json(path)
    by_cells = isinstance(content, dict) and str(content.get("schema")).startswith(_CELLS_SCHEMA.rpartition("/")[0])
    try:
        check_schema(content, _CELLS_SCHEMA if by_cells else _SCHEMA)
    except ValueError as error:
        raise DocumentError(f"{path}: {error}; find the bound again with fuzzyarm prove") from None
    return (_check_cells if by_cells else _check_tube)(path, content)


def _claimed(part: _Part, at: StateLayout) -> tuple[Segment, TubeClaim]:
    modes = tuple(Mode(m) for m in part.modes)
    plans = tuple(Plan(p) for p in part.plans)
    if len(modes) != at.joints or len(plans) != at.joints:
        raise ValueError(f"a segment has {len(modes)} modes and {len(plans)} plans; needed: {at.joints} of each")
    angles = finite_array("angles", part.angles, (2 * at.joints, DEGREE + 1), largest=_LARGEST)
    end = finite_array("end", part.end, (at.states,), largest=_LARGEST)
    tube = finite_array("tube", part.tube, (at.row_count,), largest=_LARGEST)
    duration = real("duration", part.duration, "s", low=math.ulp(PERIOD), high=PERIOD)
    return Segment(angles, modes, duration, end), TubeClaim(tube, plans)


def _check_tube(path: Path, content: Any) -> BoundCheck:
    try:
        document = record(check_schema(content, _SCHEMA), _Document)
        claim = document.claim(len(document.tip))
        bounds = [_claimed_bounds(document), *map(_claimed_bounds, document.later)]
        if resolve(document.policy).files() != document.files:
            raise ValueError(f"policy {document.policy} was changed after the proof; run fuzzyarm prove again")
        policy = load_policy(without_guest(claim.policy)[0], control_period=PERIOD, robot=claim.arm)
        physics = equations_of(policy.parameters)
        at, laps = layout(physics.joints, physics.axes), list[_Document | _LapDocument]((document, *document.later))
        begins = [None, *(lap.begin.checked() for lap in document.later)]
        claims = [
            LapClaim([[_claimed(part, at) for part in step] for step in lap.steps], begin)
            for lap, begin in zip(laps, begins, strict=True)
        ]
    except (TypeError, ValueError) as error:
        raise DocumentError(f"{path}: {error}") from None
    arm = policy.parameters
    begin, reason, bound = time.perf_counter(), "", document.bound
    try:
        found = find_bound(claim, claims=claims, policy=policy)
        bound = max(bound, found.largest)
        again = [np.stack([lap.tip, lap.whole]) for lap in found.all_laps]
        if any(a.shape != b.shape or not (a <= b).all() for a, b in zip(again, bounds, strict=True)):
            reason = "a bound on the tip error is larger than the file says"
        elif not document.bound * _ROUNDING >= found.largest:
            reason = f"the tip error may reach {at_most(1e3 * found.largest, 4)} mm"
    except NoBound as error:
        reason = str(error)
    except IndexError:
        reason = "the file ends before the motion does"
    seconds = time.perf_counter() - begin
    return BoundCheck(path, claim, arm, document.bound if reason else bound, reason, seconds, bounds[0][0])


def _claimed_bounds(lap: _Document | _LapDocument) -> np.ndarray:
    """Return a lap's claimed bounds on the tip error at samples and during steps (2, samples) [m], with a margin."""
    return finite_array("tip, whole", [lap.tip, lap.whole], (2, len(lap.tip)), largest=_LARGEST) * _ROUNDING


def _check_cells(path: Path, content: Any) -> BoundCheck:
    try:
        document = record(check_schema(content, _CELLS_SCHEMA), _CellsDocument)
        claim = document.claim(document.samples)
        if not document.cells or any(not name or Path(name).name != name for name in document.cells):
            raise ValueError("cells must list one or more file names, without a folder; they must be beside this file")
    except (TypeError, ValueError) as error:
        raise DocumentError(f"{path}: {error}") from None
    begin = time.perf_counter()
    parts = [path.with_name(name) for name in document.cells]
    found = [_check_tube(part, read_json(part)) for part in parts]
    reason = _why_not(claim, document.bound, found)
    bound = document.bound if reason else max(document.bound, *(cell.bound for cell in found))
    tip = np.max([cell.tip[: min(len(cell.tip) for cell in found)] for cell in found], axis=0)
    return BoundCheck(path, claim, found[0].arm, bound, reason, time.perf_counter() - begin, tip, len(found))


def _why_not(claim: TipClaim, bound: float, found: Sequence[BoundCheck]) -> str:
    """Return why the checks of all cells, `found`, do not prove the claim with this bound [m]; empty if they do."""
    ranges: dict[str, Any] = {name: getattr(claim.plants, name) for name in RANGES}
    for cell in found:
        whole = dataclasses.replace(
            cell.claim, plants=dataclasses.replace(cell.claim.plants, **ranges), set_name=claim.set_name
        )
        if not cell.proven:
            return f"{cell.path.name}: {cell.reason}"
        if whole != claim or cell.arm != found[0].arm:
            return f"{cell.path.name} has a different claim from this file, or is for another arm"
        if cell.bound > bound * _ROUNDING:
            return f"{cell.path.name}: the tip error may reach {at_most(1e3 * cell.bound, 4)} mm"
    hole = claim.plants.hole([cell.claim.plants for cell in found])
    return "" if hole is None else f"no cell covers {hole.in_words(claim.plants)}"
