"""Tuning of an arm into a folder, step by step; finished steps are kept, and an interrupted run can be resumed.

    robot.toml        the arm
    steps/NAME.json   what each step found, see `Finding`
    fuzzy-4.json      the controller file
    laws.json         parameters of the other laws, see `policies.tuned`: with it the folder can be used
    margins.json      what `fuzzyarm margins --robot FOLDER --json` prints
    README.md         the decisions, for readers

Every file is written whole or not at all, and ``laws.json`` after the files that it names. No step depends on time,
chance or the number of processes, so an interrupted and resumed run has the result of an uninterrupted one.
"""

import contextlib
import dataclasses
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import path_of, truth
from fuzzyarm.common.console import escaped
from fuzzyarm.common.documents import read_toml
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.equations import IN_FOLDER, AnyArm, chosen_arm, corners_of, robot_of
from fuzzyarm.envs.physics.ranges import Ranges
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import shipped_robots
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.provenance import current_provenance, json_text
from fuzzyarm.eval.stability.margins import MarginsConfig, measure_margins
from fuzzyarm.eval.tuning._finding import PERIOD, STEPS, Finding, read_finding, write_finding
from fuzzyarm.eval.tuning._fuzzy_gains import FUZZY
from fuzzyarm.eval.tuning._search import Context
from fuzzyarm.eval.tuning._steps import steps_for
from fuzzyarm.eval.tuning.readme import README, summary
from fuzzyarm.policies.registry import ADAPTIVE_OBSERVER, COMPUTED_TORQUE, ELASTIC_OBSERVER, TIP
from fuzzyarm.policies.tuned import NAME, SCHEMA, TunedLaws

__all__ = ["NothingFound", "Tuned", "begin", "ranges_of", "resumed_arm", "tune", "tune_arm"]

_MARGINS = "margins.json"
_INSTANTS = 501  # of the path, at which the motors must hold the weight

_Bar = Callable[[str, int], AbstractContextManager[Callable[..., None]]]  # see `common.console.progress`


class NothingFound(Exception):
    """No policy has stable gains; the message states the reason for each."""


@dataclasses.dataclass(frozen=True)
class Tuned:
    """The outcome of a tuning."""

    laws: TunedLaws  # of the folder
    findings: tuple[Finding, ...]  # of the steps, in their order
    margins: dict[str, Any]  # the document of `measure_margins`


def begin(arm: AnyArm, folder: Path, ranges: Ranges | None = None) -> None:
    """Begin a tuning: write the arm, and `ranges` of its parameters if there are any, into an empty folder.

    ValueError if the folder is not empty, or the motors cannot hold the weight of the arm.
    """
    if str(folder) in shipped_robots():
        raise ValueError(
            f"{folder} is also the name of a robot, and --robot would choose that robot; choose another name"
        )
    if not all(path.name.startswith(f".{IN_FOLDER}.") for path in folder.iterdir()):  # what a killed run may leave
        tuned = (folder / IN_FOLDER).is_file() and ((folder / STEPS).is_dir() or (folder / NAME).is_file())
        way = "add --resume to go on with its tuning, or choose another folder" if tuned else "choose another folder"
        raise ValueError(f"{escaped(str(folder))} exists and is not empty; {way}")
    _check_strength(arm)
    write_atomically(folder / IN_FOLDER, arm.to_toml() + (ranges or Ranges()).to_toml())


def ranges_of(robot: Any) -> Ranges:
    """Return the ranges of parameters in the file that ``robot`` names; empty if it names no file with ranges."""
    if not corners_of(robot):
        return Ranges()
    path = Path(robot) / IN_FOLDER
    return Ranges.taken(read_toml(path if path.is_file() else Path(robot)))


def _check_strength(arm: AnyArm) -> None:
    """Raise ValueError unless the motors can hold the weight of the arm anywhere on its default path."""
    robot, reference = robot_of(arm), default_reference(arm)
    q = reference.sample(np.linspace(0.0, reference.duration, _INSTANTS)).q
    weight, limit = inverse_dynamics(robot, q, np.zeros_like(q), np.zeros_like(q)), robot.drive("torque_limit")
    share = np.max(np.abs(weight) / limit, axis=0)
    joint = int(np.argmax(share))
    if share[joint] >= 1.0:
        raise ValueError(
            f"the arm cannot hold its own weight: joint {joint + 1} needs {share[joint] * limit[joint]:.4g} N m "
            f"against gravity on its path, but its torque_limit is {limit[joint]:g} N m; raise this limit, or lower "
            "the masses or lengths"
        )


def resumed_arm(folder: Path, arm: AnyArm | None) -> AnyArm:
    """Return the arm of a folder whose tuning is resumed.

    ValueError if the folder contains no arm, or another one than `arm`. If `arm` is None, any arm is accepted.
    """
    if not (folder / IN_FOLDER).is_file():
        raise ValueError(f"{folder} contains no tuning to resume; leave out --resume")
    own = chosen_arm(str(folder / IN_FOLDER), None)
    if arm is not None and robot_of(arm).digest != robot_of(own).digest:
        raise ValueError(f"{folder} contains laws for another arm; leave out --robot, or choose another folder")
    return own


def tune_arm(robot: Any, folder: str | os.PathLike[str], *, resume: bool = False, jobs: int | None = None) -> Tuned:
    """Find the parameters of every model-based policy for an arm, as `fuzzyarm tune` does.

    Args:
        robot: an argument of `chosen_arm`; None: Table 1, or with `resume` the arm of the folder.
        folder: folder to write, made if needed.
        resume: whether to go on with the tuning in the folder.
        jobs: number of processes; None: one per core.

    Raises:
        NothingFound: no policy has stable gains.
        ValueError: the folder is not empty, of another arm or damaged; or the arm cannot follow its path.
        OSError: a file cannot be read or written.
    """
    folder, resume = path_of("folder", folder), truth("resume", resume)
    if resume:
        arm = resumed_arm(folder, None if robot is None else chosen_arm(robot, None))
    else:
        arm = chosen_arm(robot, None)
        folder.mkdir(parents=True, exist_ok=True)
        begin(arm, folder, ranges_of(robot))
    return tune(arm, folder, engine=Engine(jobs=jobs))


def tune(
    arm: AnyArm,
    folder: Path,
    *,
    engine: Engine,
    bar: _Bar = lambda text, total: contextlib.nullcontext(lambda **named: None),
    finished: Callable[[Finding], None] = lambda finding: None,
) -> Tuned:
    """Run the missing steps for an arm in a folder that `begin` prepared, and write its other files; see `tune_arm`.

    `bar` shows the progress of a step, see `common.console.progress`; `finished` is called with each finding.
    """
    findings: dict[str, Finding] = {}
    for step in steps_for(arm):
        finding = read_finding(folder, step.policy, robot_of(arm).digest)
        file = f"{FUZZY}.json" if finding and finding.chosen and step.policy == FUZZY else "."
        if finding is None or not (folder / file).exists():
            with bar(step.policy, step.total) as advance:
                finding = step.find(Context(arm, folder, engine, advance, findings))
            write_finding(folder, finding)
        findings[step.policy] = finding
        finished(finding)
    if all(finding.chosen is None for finding in findings.values()):
        reasons = "; ".join(f"{name}: {one.notes[-1].rstrip('.')}" for name, one in findings.items() if one.notes)
        raise NothingFound(
            f"no policy has stable gains for this arm ({reasons}); run fuzzyarm design with the same --robot to see "
            "the limiting parameter, or with a shorter --control-period for a faster loop"
        )
    laws = _laws_of(arm, findings)
    write_atomically(folder / NAME, laws.to_json())
    with bar("margins", len(laws.policies)) as advance:
        margins = measure_margins(MarginsConfig(robot=str(folder)), advance)
    write_atomically(folder / _MARGINS, json_text(margins))
    tuned = Tuned(laws, tuple(findings.values()), margins)
    write_atomically(folder / README, summary(arm, folder.name, tuned.findings, margins))
    return tuned


def _laws_of(arm: AnyArm, findings: dict[str, Finding]) -> TunedLaws:
    """Return the content of ``laws.json``."""
    chosen = {name: finding.chosen for name, finding in findings.items() if finding.chosen is not None}
    with_tip = (FUZZY, COMPUTED_TORQUE)
    names = [*with_tip, *(name + TIP for name in with_tip), ELASTIC_OBSERVER, ADAPTIVE_OBSERVER]
    return TunedLaws(
        schema=SCHEMA,
        arm_sha256=robot_of(arm).digest,
        control_period=PERIOD,
        policies=tuple(name for name in names if name.removesuffix(TIP) in chosen),
        bandwidth=chosen.get(COMPUTED_TORQUE, {}).get("bandwidth"),
        observer=chosen.get(ELASTIC_OBSERVER),  # type: ignore[arg-type]
        adaptive=chosen.get(ADAPTIVE_OBSERVER),  # type: ignore[arg-type]
        made_with=current_provenance()["versions"],
    )
