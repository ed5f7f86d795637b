"""`fuzzyarm identify`: find the arm's parameters from a log of the motors."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from fuzzyarm.cli._usage import UsageError, output_file
from fuzzyarm.common.console import Sheet, output, print_paragraphs, progress, say, say_json, status

if TYPE_CHECKING:
    from fuzzyarm.envs.physics.equations import AnyArm
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.identification.conventions import Diagnosis
    from fuzzyarm.identification.log import Log
    from fuzzyarm.identification.result import Identified

__all__ = ["Options"]
_APPLY = "To use the likeliest interpretation, add --apply"


@dataclass(frozen=True)
class Options:
    """Find the parameters of an arm in logs of its motors, with 95 % intervals from several logs.

    Least squares on the inverse dynamics give the rigid arm; for two joints, the output error method refines it.
    Held-out logs decide whether springs are identified. Parameters that the logs do not determine keep their values
    from --robot and are listed. The exit code is 1 if one of them is inertial, or if the arm explains little of the
    logs. With --suggest: write a motion to record first.
    """

    log: Annotated[tuple[Path, ...], Parameter(name="", metavar="LOG...")] = ()
    """Logs of one arm, recorded in the same way: time, angles, torques and perhaps velocities of its joints, as text
    with columns (CSV and similar), NumPy's .npz or .npy, MATLAB's .mat, or joint states of a ROS 2 bag (.mcap, .db3 or
    folder)"""
    _: KW_ONLY
    columns: Annotated[str | None, Parameter(metavar="ROLE=NAME,...")] = None
    """Columns whose names are not recognised: time=stamp,q1=shoulder,tau1=load1,... or by number (q1=2); dq1 is a
    velocity, topic is the topic of a bag (default: by their names)"""
    units: Annotated[str | None, Parameter(metavar="KIND=UNIT,...")] = None
    """Units of time, q, dq and tau, or of those of one joint, by name or by size in SI units: q=deg,tau2=0.12 (default:
    those in the heading, else s, rad, rad/s, N m)"""
    gear: Annotated[tuple[float, ...], Parameter(metavar="RATIO", negative="")] = ()
    """Gear reduction if the log was recorded on the motors' side: one for all joints, or repeated for each (default:
    the log was recorded on the joints' side)"""
    delay: Annotated[float, Parameter(metavar="SECONDS")] = 0.0
    """Time by which torques in the log are later than the angles that belong to them"""
    apply: Annotated[bool, Parameter(negative="")] = False
    """Read the logs with the conventions that seem likely: units, signs, zeros and order of the joints"""
    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Initial arm, a name or a TOML file: provides lengths or frames, limits and, for two joints, masses (default:
    Table 1 of the paper)"""
    stribeck: Annotated[bool, Parameter(negative="")] = False
    """Also search for friction that is larger at rest; it counts only if the error on held-out logs falls"""
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """TOML file of the arm to write (default: none)"""
    figure: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """Figure of measured and simulated angles to write (.png; default: none)"""
    suggest: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """Write a motion to record, instead of reading a log: time, angles, velocities, accelerations and the torques that
    they need (.csv)"""
    duration: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    """Duration of the motion to record, 4 to 120 s (default: 20)"""
    json: bool = False
    """Print the results as JSON instead of the table"""

    def run(self) -> int:
        """Identify an arm, or suggest a motion; print the results and write the files."""
        from fuzzyarm.envs.physics.equations import chosen_arm
        from fuzzyarm.envs.physics.parameters import ArmParameters

        if bool(self.log) == (self.suggest is not None):
            raise UsageError("give either a LOG or --suggest FILE; see fuzzyarm identify --help")
        output_file(self.out, ".toml")
        output_file(self.figure, ".png", "--figure")
        output_file(self.suggest, ".csv", "--suggest")
        if self.suggest is not None:
            if self.out is not None or self.figure is not None:
                raise UsageError("--out and --figure need a LOG; leave them out with --suggest")
        elif self.duration is not None:
            raise UsageError("--duration is for --suggest only; leave it out with a LOG")
        arm = chosen_arm(self.robot, None)
        if self.suggest is None:
            return _identify(self, arm)
        if not isinstance(arm, ArmParameters):
            raise UsageError(
                f"--robot {self.robot} is described by joint frames; --suggest supports only the two-joint arm "
                "of Table 1 and TOML files with the fields of that arm, such as length and mass"
            )
        return _suggest(self, arm)


def _suggest(options: Options, arm: ArmParameters) -> int:
    """Write a motion for the user to run and log; print its largest values beside the limits of the arm; return 0."""
    assert options.suggest is not None
    from fuzzyarm.common.files import write_atomically
    from fuzzyarm.identification.excitation import suggested

    with status("searching for a motion"):
        motion = suggested(arm) if options.duration is None else suggested(arm, options.duration)
    use, condition = motion.largest(), motion.condition()
    write_atomically(options.suggest, motion.to_csv())
    limits = {"angle": arm.joint_limit, "velocity": arm.velocity_limit, "torque": arm.torque_limit}
    if options.json:
        largest = {name: part.tolist() for name, part in use.items()}
        say_json({"duration": motion.duration, "condition": condition, "largest": largest, "limits": limits})
        return 0
    say(f"motion of {motion.duration:g} s, from rest to rest; condition number of its regressor: {condition:.3g}")
    for (name, (first, second)), unit in zip(use.items(), ("rad", "rad/s", "N m"), strict=True):
        limit = limits[name]
        say(f"largest {name}: {first:.3g} and {second:.3g} {unit}; limits: {limit[0]:g} and {limit[1]:g} {unit}")
    say(f"written to {options.suggest}")
    return 0


def _pairs(option: str, text: str | None) -> dict[str, str]:
    """Return the values by key of an option KEY=VALUE,KEY=VALUE; UsageError for any other text or a repeated KEY."""
    pairs = [pair.partition("=") for pair in text.split(",")] if text is not None else []
    found = {key.strip(): value.strip() for key, _, value in pairs}
    if len(found) < len(pairs) or not all(key and value for key, value in found.items()):
        raise UsageError(f"{option} {text} must have the form KEY=VALUE,KEY=VALUE,..., with each KEY only once")
    return found


def _logs(options: Options) -> list[Log]:
    """Return the logs of all files; a file with gaps gives one log for each part."""
    from fuzzyarm.identification.reading import read_log

    places = [path.resolve() for path in options.log]
    if twice := [path for k, path in enumerate(options.log) if places[k] in places[:k]]:
        raise UsageError(f"{twice[0]} is given twice; give each LOG once")
    columns, units = _pairs("--columns", options.columns), _pairs("--units", options.units)
    logs: list[Log] = []
    for path in options.log:
        logs += read_log(path, columns=columns, units=units, gear=options.gear, delay=options.delay)
        joints, first = logs[-1].angle.shape[1], logs[0].angle.shape[1]
        if joints != first:
            raise ValueError(f"{path} has {joints} joints, but {options.log[0]} has {first}; give logs of the same arm")
    return logs


def _identify(options: Options, start: AnyArm) -> int:
    """Identify an arm from logs, with `start` as first guess; print remarks and results, and return the exit code."""
    from fuzzyarm.common.files import write_atomically
    from fuzzyarm.envs.physics.equations import robot_of
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.identification.result import identify

    logs = _logs(options)
    said = [f"{log.name}: {remark}" for log in logs for remark in log.remarks]
    doubt, conventions = None, {}
    joints, needed = logs[0].angle.shape[1], len(robot_of(start))
    if joints != needed:
        raise ValueError(
            f"{options.log[0]} has {joints} joints, but the initial arm has {needed}. Choose joints with --columns "
            "q1=NAME,q2=NAME,tau1=NAME,tau2=NAME, or another initial arm with --robot"
        )
    if isinstance(start, ArmParameters):
        from fuzzyarm.identification.conventions import diagnosed

        with status("comparing conventions"):
            doubt = diagnosed(logs, start, options.gear)
        conventions = {"conventions": _document(doubt, options.apply)}
        if doubt.doubtful:
            used = "The likeliest interpretation is used" if options.apply else _APPLY
            said.append(f"conventions: {doubt.sentence()}. {used}")
        elif options.apply:
            said.append(f"conventions: none is doubtful (misfit {doubt.misfit:.2g}); there is nothing to apply")
        if options.apply:
            logs = [doubt.reading.applied(log) for log in logs]
    elif options.apply or options.stribeck:
        raise UsageError("--apply and --stribeck do not support robots with joint frames; leave them out")
    try:
        with progress("steps", None) as advance:
            found = identify(logs, start, advance, stribeck=options.stribeck)
    except ValueError as error:
        if doubt is None or not doubt.doubtful or options.apply:
            raise
        raise ValueError(f"{error}. Perhaps the logs use other conventions: {doubt.sentence()}. {_APPLY}") from None
    if options.out is not None:
        write_atomically(options.out, found.to_toml())
    if options.figure is not None:
        found.write_figure(options.figure)
    if options.json:
        say_json({"reading": said} | conventions | found.to_dict())
    else:
        for line in said:
            say(line)
        _print(found)
        for written in (options.out, options.figure):
            if written is not None:
                say(f"written to {written}")
    return 130 if found.interrupted else int(found.doubtful or bool(found.untold()))


def _print(found: Identified) -> None:
    """Print the parameters, the errors on held-out logs and the remarks."""
    cells, console = [], output()
    for row in found.rows():
        known = row["low"] is not None
        width = f"{row['low']:.4g} to {row['high']:.4g}" if known else "unknown" if row["told"] else "not determined"
        cells.append((row["name"], row["unit"], f"{row['start']:.6g}", f"{row['value']:.6g}", width))
    Sheet(["parameter", "unit", "start", "found", "95 % interval"], cells, left=(0, 1)).print(console)
    errors = [(name, *(f"{error:.3g}" for error in held)) for name, held in found.held_out.items()]
    if errors:
        joints = [f"joint {k}" for k in range(1, len(errors[0]))]
        Sheet([f"held-out error [{found.held_out_unit}]", *joints], errors, left=(0,)).print(console)
    print_paragraphs(console, found.remarks())


def _document(doubt: Diagnosis, applied: bool) -> dict[str, object]:
    rivals = [{"conventions": list(one.words), "misfit": misfit} for one, misfit in doubt.rivals]
    likely = {"likely": list(doubt.reading.words), "misfit_so": doubt.after, "rivals": rivals * doubt.doubtful}
    return {"misfit": doubt.misfit, "applied": applied and doubt.doubtful} | likely
