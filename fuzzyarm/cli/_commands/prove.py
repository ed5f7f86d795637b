"""`fuzzyarm prove`: prove a bound on the tip error of a policy on the elastic, sampled arm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from fuzzyarm.cli._usage import UsageError, output_file
from fuzzyarm.common.console import escaped, progress, say, say_json

if TYPE_CHECKING:
    from fuzzyarm.policies.tip_bound import TipClaim

__all__ = ["Options"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Prove a bound on the tip error at every instant of a motion, for every plant of a set.

    The proof includes elastic joints, sample and hold, torque limits and dry friction. If no bound is found, the exit
    code is 1, and one line states the reason.
    """

    policy: Annotated[str, Parameter(metavar="NAME")] = "fuzzy-4-tip"
    """Policy: fuzzy-4, computed-torque, ... with or without -tip, elastic-observer, ppo-residual or another learned
    policy, a controller file (.json, .json-tip), or a policy in a folder of fuzzyarm tune (DIR/fuzzy-4-tip)"""
    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Arm that the set is about: a robot by name (planar-3r), the TOML file of a robot or of a two-joint arm, or a
    folder of fuzzyarm tune (default: the arm of the policy's file, otherwise Table 1)"""
    case: Annotated[str, Parameter(metavar="NAME")] = "nominal"
    """Case: nominal, machining or payload"""
    set: Annotated[str, Parameter(metavar="NAME|FILE")] = "table-1"
    """Set of plants: table-1, any-friction, near, near-late, or a TOML file with ranges of factors"""
    path: Annotated[str, Parameter(metavar="NAME|FILE")] = "circle"
    """Path of the tip: circle, lemniscate, line or square, or a file of points in metres (.csv, .toml)"""
    duration: float | None = None
    """Duration of the motion [s] (default: that of fuzzyarm evaluate, 1.5 for the circle)"""
    steps: Annotated[int | None, Parameter(metavar="N")] = None
    """Bound the first N control steps of the motion (default: all)"""
    laps: Literal["one", "ever"] = "one"
    """Laps to bound: one lap of the motion, or every lap of a motion that is repeated for ever along a closed path"""
    start: Annotated[list[str] | None, Parameter(metavar="FILE|NUMBERS", negative="", consume_multiple=True)] = None
    """Box of initial states about the start: five half widths, of motor angles [rad], bending [rad], motor velocities
    [rad/s], bending velocities [rad/s] and the policy's memory, or a TOML or JSON file with angle, bending, velocity,
    bending_velocity and memory, each one number or a list (default: at rest on the path)"""
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """File of the bound to write (.json; default: none), which fuzzyarm verify checks again; with --cells, the file of
    each cell is written beside it"""
    cells: Annotated[list[tuple[str, int]] | None, Parameter(metavar="FIELD N", negative="")] = None
    """Divide the range of a field of the set into N parts; if each joint has a range, all (mass) or one (mass-2).
    May be repeated. Each cell has its own tube, and a cell without a tube is halved (default: one tube)"""
    jobs: int = 1
    """Number of processes that work on the cells"""
    json: bool = False
    """Print the result as JSON"""

    def run(self) -> int:
        """Print the bound, and write its file."""
        from fuzzyarm.policies.tip_bound import find_bound, problem_of
        from fuzzyarm.policies.tip_files import save_bound
        from fuzzyarm.proof.tip.enclosures import NoBound

        output_file(self.out, ".json")
        try:
            claim = _claim(self)
            if self.cells is not None:
                found, text = _by_cells(self, claim)
            else:
                with progress("proving", None if self.laps == "ever" else problem_of(claim).schedule.steps) as advance:
                    bound = find_bound(claim, advance)
                if self.out is not None:
                    save_bound(bound, self.out)
                found, text = bound.to_dict(), bound.to_text()
        except NoBound as error:
            named = {"policy": self.policy, "case": self.case, "set": self.set}
            found = named | {"proven": False, "bound": None, "reason": str(error)}
            if not self.json:
                say(escaped(str(error)), error=True)
                return 1
        if self.json:
            say_json(found)
        else:
            say(text)
        return 0 if found["proven"] else 1


def _claim(options: Options) -> TipClaim:
    """Return the claim about the tip error that the options state."""
    from fuzzyarm.envs.physics.equations import chosen_arm
    from fuzzyarm.envs.scenario.given_path import ENDINGS, GivenPath
    from fuzzyarm.policies.tip_bound import TipClaim, own_duration
    from fuzzyarm.proof.tip.laps import StartBox
    from fuzzyarm.proof.tip.plant import find_set

    plants = find_set(options.set)
    arm = None if options.robot is None else chosen_arm(options.robot, None)
    points = GivenPath.read(Path(options.path)) if Path(options.path).suffix in ENDINGS else None
    path = options.path if points is None else "circle"
    duration = options.duration
    if duration is None:
        duration = own_duration(options.policy, arm, path, points)
    start = None if options.start is None else StartBox.of(options.start)
    return TipClaim(
        options.policy, options.case, plants=plants, path=path, duration=duration, steps=options.steps,
        laps=options.laps, start=start, arm=arm, points=points,
    )  # fmt: skip


def _by_cells(options: Options, claim: TipClaim) -> tuple[dict[str, Any], str]:
    """Prove and return, as data and as text, a bound for each cell of the divided set; `NoBound` if a cell has none."""
    from fuzzyarm.common.arithmetic import at_most
    from fuzzyarm.common.checks import whole
    from fuzzyarm.envs.observation import JOINTS
    from fuzzyarm.policies.tip_bound import arm_in_words, plain, problem_of
    from fuzzyarm.policies.tip_cells import bounds_of_cells, cells
    from fuzzyarm.policies.tip_files import save_cells
    from fuzzyarm.proof.tip.plant import BY_JOINT

    divisions, jobs = options.cells or [], whole("--jobs", options.jobs, low=1, high=64)
    problem, found = problem_of(claim), []
    arm, joints = problem.parameters, problem.plant.physics.joints
    if joints != JOINTS and any(name.partition("-")[0] in BY_JOINT for name, _ in divisions):
        raise UsageError(f"--cells must be payload or force for a robot with {joints} joints; leave out the others")
    with progress("cells", sum(1 for _ in cells(claim.plants, divisions))) as advance:
        for parts in bounds_of_cells(claim, divisions, jobs, options.out):
            found += parts
            advance()
    most = max(cell.bound for cell in found)
    if options.out is not None:
        save_cells(claim, found, options.out)
    names = [name for name, _ in divisions]
    fields = list(dict.fromkeys(name.partition("-")[0] for name in names))
    motion = claim.motion(min(cell.samples for cell in found))
    rows = [{**{name: cell.plants.to_dict()[name] for name in fields}, "bound": cell.bound} for cell in found]
    named = {"policy": options.policy, "case": options.case, "set": claim.named_set(arm)}
    return named | {"proven": True, "bound": most, "cells": rows}, (
        f"{plain(options.policy)}, {len(found)} cells of {', '.join(names)}: the tip error is at most "
        f"{at_most(1e3 * most, 4)} mm for set {claim.named_set(arm)} ({arm_in_words(arm)})\n  {motion}: PROVEN"
    )
