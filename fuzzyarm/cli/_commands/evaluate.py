"""`fuzzyarm evaluate`: run policies in the paper's cases, or repeat an evaluation and compare its numbers."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from fuzzyarm.cli._options import given, named_as_option, option_name
from fuzzyarm.cli._usage import UsageError, claimed_folder
from fuzzyarm.common.console import output, print_paragraphs, progress, say, say_json

if TYPE_CHECKING:
    from fuzzyarm.eval.evaluation.run import EvaluationConfig

__all__ = ["Options"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Run policies on the elastic arm in the paper's cases; print a table, write JSON, CSV and figures."""

    policies: Annotated[tuple[str, ...] | None, Parameter(metavar="NAME...")] = None
    """Policy: fuzzy-32, -16, -8, -4, -2, -1, paper-4, computed-torque or a controller file (.json), each also with the
    ending -tip, which brings the tip instead of the motors to the reference; paper-4-printed; elastic-observer,
    adaptive-observer, learned-observer; ppo-nominal, -robust, -residual or a learned policy's folder; or your own code
    as package.module:factory. May be repeated (default: fuzzy-4 and computed-torque, both with and without -tip, the
    three observers, ppo-robust and ppo-residual; for another arm computed-torque, with and without -tip, and
    elastic-observer)"""
    cases: Annotated[tuple[str, ...] | None, Parameter(metavar="NAME...")] = None
    """A named case, such as nominal, machining or payload. May be repeated (default: these three)"""
    seeds: Annotated[int | None, Parameter(metavar="N")] = None
    """Episodes of each policy in each case, seeded 0 to N-1 (1 or more; default: 1)"""
    encoder_noise: Annotated[tuple[float, float] | None, Parameter(metavar="RAD RAD_PER_S")] = None
    """Standard deviation of the noise on motor angles [rad] and velocities [rad/s] (default: 0 0)"""
    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Another robot: cicese, manutec-r3, planar-3r, ur5, panda, or the TOML file of a robot or of a two-joint arm
    (default: the paper's arm). Its path and loads are scaled; see the documentation"""
    path: Annotated[str, Parameter(metavar="NAME|FILE")] = "circle"
    """Path of the tip: circle, lemniscate, line or square, placed and sized for the arm, or a file of points in metres
    (.csv, .toml)"""
    force: Annotated[tuple[float, float] | None, Parameter(metavar="LOW HIGH")] = None
    """Smallest and largest machining force [N] (default: the paper's 138 218, scaled to the arm)"""
    payload: Annotated[float | None, Parameter(metavar="KG")] = None
    """Carried mass of the payload case [kg] (default: the paper's 5, scaled to the arm)"""
    passes: Annotated[int | None, Parameter(metavar="N")] = None
    """Number of episodes along the same path, one after the other; the results are those of the last one. Between
    episodes, adaptive-observer learns, policies with the ending -tip use classical iterative learning control, and your
    own code learns if it has a method repeated (1 to 1000; default: 1)"""
    control_period: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    """Time between two torques [s] (default: 0.001)"""
    declared: bool = False
    """Also print what each policy declares: its objective, what it was tuned on, what it knows about the arm, what it
    observes and remembers, and what is proven about it on the rigid arm"""
    out: Annotated[Path | None, Parameter(metavar="DIR")] = None
    """Folder for results and figures, created if needed (default: fuzzyarm-evaluation)"""
    json: bool = False
    """Print the results as JSON instead of the table; the JSON always includes what the policies declare"""
    check: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """Repeat the evaluation of a results.json, or of the folder that contains it, and compare every number except
    times. Nothing is written; the exit code is 1 if a number differs. Your own code that the file names runs only if
    --policy names it too. If a policy's file has moved, give its new path with --policy"""

    def run(self) -> int:
        """Evaluate; return 1 if an episode ended early or a number differs from the file `check`, else 0."""
        if self.check is not None:
            return _repeat(self, self.check)
        from fuzzyarm.eval.declarations import print_declared
        from fuzzyarm.eval.episodes.rollout_file import write_rollouts
        from fuzzyarm.eval.evaluation.figures import write_figures
        from fuzzyarm.eval.evaluation.result_table import certificate_lines, declared_rows, print_passes, print_results
        from fuzzyarm.eval.evaluation.run import evaluate, write_results

        config = _config(self)
        titles = config.titles
        out = self.out or Path("fuzzyarm-evaluation")
        with claimed_folder(out):
            with progress("episodes", len(config.policies) * len(config.cases) * config.seeds) as advance:
                evaluation = evaluate(config, advance)
            written = write_results(evaluation, out)
            with progress("figures", None) as advance:
                written += write_figures(evaluation.rollouts, out, advance, titles)
            written.append(write_rollouts(evaluation.rollouts, out))  # last: this file completes the evaluation
        if self.json:
            say_json(evaluation.to_dict())
        else:
            console = output()
            print_results(evaluation, console)
            if config.passes > 1:
                print_passes(evaluation.rows, config.passes, console)
            if self.declared:
                headings, *rows = declared_rows(evaluation.declared, evaluation.certificates)
                print_declared(rows, headings, console)
            lines = certificate_lines(evaluation.certificates, evaluation.bounds)
            there = shlex.quote(str(out))
            print_paragraphs(
                console, ["\n".join(lines), f"{len(written)} files in {there}; next: fuzzyarm report {there}"]
            )
        for run in evaluation.rollouts:
            if not run.completed:
                say(f"{run.policy} in case {run.case} ended early, at {run.time[-1]:.3f} s: {run.reason}", error=True)
            if run.note:  # its estimate is wrong
                say(f"{run.policy} in case {run.case}, seed {run.seed}: {run.note}", error=True)
        for line in evaluation.remarks:
            say(line, error=True)
        return 0 if evaluation.complete else 1


def _config(options: Options) -> EvaluationConfig:
    from fuzzyarm.envs.physics.equations import chosen_arm
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.envs.scenario.given_path import ENDINGS, GivenPath
    from fuzzyarm.envs.scenario.paths import SHAPES
    from fuzzyarm.eval.evaluation.run import EvaluationConfig
    from fuzzyarm.policies import ANY_ROBOT, COMPARED, policies_of

    arm = None if options.robot is None else chosen_arm(options.robot, None)
    other = arm is not None and arm != ArmParameters()
    policies = options.policies or policies_of(options.robot)
    if other and not policies:
        left_out = ", ".join(name for name in COMPARED if name not in ANY_ROBOT)
        text = "to tune policies for another arm, use fuzzyarm tune"
        say(f"{left_out} were left out, because they are for the default arm only; {text}", error=True)
    from_file = Path(options.path).suffix in ENDINGS
    if not from_file and options.path not in SHAPES:
        raise UsageError(
            f"--path {options.path} is unknown; choose from: {', '.join(SHAPES)}, or give a file of points "
            f"({' or '.join(ENDINGS)})"
        )
    values = given(options, EvaluationConfig) | {
        "policies": policies or (ANY_ROBOT if other else None),
        "path": None if from_file else options.path,
        "points": GivenPath.read(Path(options.path)) if from_file else None,
        "robot": None,
        "parameters" if isinstance(arm, ArmParameters) else "robot": arm,
    }
    try:
        return EvaluationConfig(**{name: value for name, value in values.items() if value is not None})
    except ValueError as error:
        raise UsageError(named_as_option(str(error), EvaluationConfig)) from None


def _repeat(options: Options, recorded: Path) -> int:
    """Repeat a recorded evaluation; return 1 if a number differs, else 0. Only the option `policies` is allowed."""
    from fuzzyarm.eval.evaluation.recheck import print_comparison, recheck_results
    from fuzzyarm.eval.evaluation.results_file import read_results

    for field in fields(options):
        if field.name not in ("check", "policies") and getattr(options, field.name) != field.default:
            option = option_name(field.name)
            raise UsageError(f"--check FILE repeats an evaluation as it was and writes nothing: leave out --{option}")
    results = read_results(recorded)
    with progress("episodes", len(results.rows)) as advance:
        found = recheck_results(results, options.policies or (), advance)
    print_comparison(found, output())
    return 1 if found.differences else 0
