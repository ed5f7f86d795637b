"""`fuzzyarm identify`: find the arm's parameters from a log of the motors."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from fuzzyarm.cli._usage import UsageError, output_file
from fuzzyarm.common.console import Sheet, output, print_paragraphs, progress, say, say_json, status

if TYPE_CHECKING:
    from fuzzyarm.envs.physics.parameters import ArmParameters

__all__ = ["Options"]


@dataclass(frozen=True)
class Options:
    """Find the parameters of a two-joint arm in a log of its motors, with 95 % intervals.

    Least squares on the inverse dynamics give the rigid arm; the output error of the elastic arm refines it. Parameters
    that the log does not determine keep their values from --robot and are listed. With --suggest: write a motion to
    record first.
    """

    log: Annotated[Path | None, Parameter(name="", metavar="LOG")] = None
    """CSV file with the columns time, q_motor1, q_motor2, dq_motor1, dq_motor2, torque1, torque2 [s, rad, rad/s, N m];
    the velocities may be missing"""
    _: KW_ONLY
    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Two-joint arm to start from, a name or a TOML file: lengths, masses and limits are taken from it (default: Table
    1 of the paper)"""
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """TOML file of the arm to write (default: none)"""
    figure: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """Picture of the residuals to write (.png; default: none)"""
    suggest: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """Write a motion to record, in place of reading a log: time, angles, velocities, accelerations and the torques that
    they need (.csv)"""
    duration: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    """Duration of the motion to record, 4 to 120 s (default: 20)"""
    json: bool = False
    """Print the results as JSON instead of the table"""

    def run(self) -> int:
        """Identify an arm, or suggest a motion; print the results and write the files."""
        from fuzzyarm.envs.physics.equations import chosen_arm
        from fuzzyarm.envs.physics.parameters import ArmParameters

        if (self.log is None) == (self.suggest is None):
            raise UsageError("give either a LOG or --suggest FILE; see fuzzyarm identify --help")
        output_file(self.out, ".toml")
        output_file(self.figure, ".png", "--figure")
        output_file(self.suggest, ".csv", "--suggest")
        if self.suggest is not None:
            if self.out is not None or self.figure is not None:
                raise UsageError("--out and --figure need a LOG; leave them out with --suggest")
        elif self.duration is not None:
            raise UsageError("--duration is for --suggest only; a LOG has its own")
        arm = chosen_arm(self.robot, None)
        if not isinstance(arm, ArmParameters):
            raise UsageError(
                f"--robot {self.robot} is a robot of {len(arm)} joints given by frames; allowed: two-joint arms "
                "given as ArmParameters"
            )
        return _identify(self, arm, self.log) if self.log is not None else _suggest(self, arm)


def _suggest(options: Options, arm: ArmParameters) -> int:
    """Write a motion to record; print its largest values and the limits of the arm."""
    assert options.suggest is not None
    from fuzzyarm.common.files import write_atomically
    from fuzzyarm.identification.excitation import suggested

    with status("searching a motion"):
        motion = suggested(arm) if options.duration is None else suggested(arm, options.duration)
    use, condition = motion.largest(), motion.condition()
    write_atomically(options.suggest, motion.to_csv())
    limits = {"angle": arm.joint_limit, "velocity": arm.velocity_limit, "torque": arm.torque_limit}
    if options.json:
        largest = {name: part.tolist() for name, part in use.items()}
        say_json({"duration": motion.duration, "condition": condition, "largest": largest, "limits": limits})
        return 0
    say(f"a motion of {motion.duration:g} s from rest to rest; condition number {condition:.3g}")
    for (name, (first, second)), unit in zip(use.items(), ("rad", "rad/s", "N m"), strict=True):
        say(f"largest {name}: {first:.3g} and {second:.3g} of {limits[name][0]:g} and {limits[name][1]:g} {unit}")
    say(f"written to {options.suggest}")
    return 0


def _identify(options: Options, start: ArmParameters, path: Path) -> int:
    from fuzzyarm.identification.log import read_log
    from fuzzyarm.identification.result import identify

    log = read_log(path)
    with progress("steps", None) as advance:
        found = identify(log, start, advance)
    if options.out is not None:
        found.arm.write_toml(options.out)
    if options.figure is not None:
        found.write_residuals(options.figure)
    if options.json:
        say_json(found.to_dict())
        return 0
    cells, console = [], output()
    for row in found.rows():
        width = f"{row['high'] - row['value']:.2g}" if row["told"] else "not told"
        cells.append((row["name"], row["unit"], f"{row['start']:.6g}", f"{row['value']:.6g}", width))
    Sheet(["parameter", "unit", "start", "found", "95 % interval, +-"], cells, left=(0, 1)).print(console)
    noise = found.fit.noise.tolist()
    left = "angles {:.2g} and {:.2g} rad".format(*noise)
    if len(noise) > 2:
        left += ", velocities {2:.2g} and {3:.2g} rad/s".format(*noise)
    fit = (
        f"{found.samples} samples, {found.period * 1e3:g} ms apart. The fit leaves, rms: {left}. "
        f"Condition number of the information: {found.fit.condition:.3g}."
    )
    print_paragraphs(console, [fit, *found.remarks()])
    for written in (options.out, options.figure):
        if written is not None:
            say(f"written to {written}")
    return 0
