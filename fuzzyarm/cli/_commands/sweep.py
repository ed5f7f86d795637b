"""`fuzzyarm sweep`: run policies on thousands of different plants."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from fuzzyarm.cli._options import given, with_fields_of
from fuzzyarm.cli._usage import claimed_folder, stopped
from fuzzyarm.common.console import output, print_paragraphs, progress, say, say_json
from fuzzyarm.eval.engine import Engine, WorkersLost
from fuzzyarm.eval.sweep.config import SweepConfig

if TYPE_CHECKING:
    from fuzzyarm.eval.sweep.run import Sweep

__all__ = ["Options"]


@with_fields_of(SweepConfig, without=("parameters", "robot"))
@with_fields_of(Engine)
@dataclass(frozen=True, kw_only=True)
class Options:
    """Run policies on many plants, drawn from a distribution or on a grid over two quantities.

    Writes success rates, quantiles of the tip error with confidence intervals, heat maps and the worst plants to a
    folder, chunk by chunk; --resume continues after an interruption. Quantities: mass, motor_inertia, stiffness,
    damping, dry_friction, viscous_friction (factors), payload [kg], force (factor), noise (factor of 1e-5 rad and 1e-3
    rad/s), delay [control periods of 1 ms]. With --grid, nothing else varies by default, and a cell has one plant.
    """

    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Robot around which plants are drawn and for which policies are loaded: cicese, manutec-r3, planar-3r, ur5, panda,
    or the TOML file of a robot or of a two-joint arm (default: Table 1 of the paper). The default policies of such a
    robot are computed-torque, with and without -tip, and elastic-observer; loads are scaled to it"""
    out: Annotated[Path, Parameter(metavar="DIR")] = Path("fuzzyarm-sweep")
    """Folder of the sweep"""
    resume: bool = False
    """Continue the sweep in the folder; its options need not be repeated, except --policy for your own code, which
    never runs only because a file names it; --bound, --worst and --map may change"""
    replay: Annotated[tuple[str, str, int] | None, Parameter(metavar="POLICY CASE PLANT")] = None
    """Run one plant of the folder's sweep again and write its signals and figures"""
    json: bool = False
    """Print the summary as JSON instead of the table"""

    def run(self) -> int:
        """Run or resume a sweep, or replay a plant; return 1 if workers died repeatedly."""
        from fuzzyarm.eval.sweep.run import Sweep

        engine, values = Engine(**given(self, Engine)), _given(self)
        if self.replay is not None:
            policy, case, plant = self.replay
            rollout, folder = Sweep.resume(self.out, values).replay_plant(policy, case, plant)
            end = "completed" if rollout.completed else f"ended early, at {rollout.time[-1]:.3f} s: {rollout.reason}"
            largest = 1e3 * rollout.tip_error.max()
            say(f"plant {plant} (seed {rollout.seed}), {policy}, {case}: {end}; tip error up to {largest:.6g} mm")
            say(f"signals and figures written to {folder}")
            return 0
        config = None if self.resume else SweepConfig.of(values)
        with claimed_folder(self.out, make=not self.resume):
            sweep = Sweep.resume(self.out, values) if config is None else Sweep.begin(self.out, config)
            return _complete(self, sweep, engine)


def _complete(options: Options, sweep: Sweep, engine: Engine) -> int:
    """Run the missing chunks, print the summary, return the exit code; a new sweep that fails at once is removed."""
    from fuzzyarm.eval.sweep.summary import print_sweep

    try:
        with progress("plants", sweep.config.total) as advance:
            done = sweep.config.total - sum(len(sweep.config.members(number)) for number in sweep.missing())
            advance(completed=done)
            for plants in sweep.run(engine, lambda text: say(f"fuzzyarm sweep: {text}", error=True)):
                done += plants
                advance(completed=done)
        with progress("figures", None) as advance:
            document, paths = sweep.summarise(advance)
        if options.json:
            say_json(document)
        else:
            console = output()
            print_sweep(document, console)
            print_paragraphs(console, [f"{len(paths)} files in {sweep.folder}"])
    except (KeyboardInterrupt, WorkersLost) as error:
        return stopped("sweep", options.out, error)
    except (OSError, ValueError):
        if not options.resume:
            sweep.take_back()
        raise
    return 0


def _given(options: Options) -> dict[str, Any]:
    from fuzzyarm.envs.physics.equations import chosen_arm
    from fuzzyarm.envs.physics.robot import Robot
    from fuzzyarm.policies import policies_of

    values = {name: value for name, value in given(options, SweepConfig).items() if name != "robot"}
    if options.robot is None:
        return values
    arm, tuned = chosen_arm(options.robot, None), policies_of(options.robot)
    if tuned is not None:
        values.setdefault("policies", tuned)
    return values | {"robot" if isinstance(arm, Robot) else "parameters": arm}
