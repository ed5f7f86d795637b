"""The command `fuzzyarm`: one thin function per sub-command, nothing computed here.

Exit codes: 0 fine, 1 a result that fails, 2 bad usage, 130 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from fuzzyarm import __version__


class UsageError(Exception):
    """Bad usage; the message is the one line the user sees."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        code: int = options.run(options)
        return code
    except BrokenPipeError:
        return 141  # what a shell reports for a reader that left, such as head
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"fuzzyarm {options.command}: {where}{error.strerror or error}", 2)
    except (UsageError, ValueError) as error:
        return _fail(f"fuzzyarm {options.command}: {error}", 2)
    except KeyboardInterrupt:
        return _fail(f"fuzzyarm {options.command}: interrupted; files already written are whole", 130)


def entry_point() -> None:
    """Run as the installed command."""
    sys.exit(main())


def _fail(message: str, code: int) -> int:
    print(" ".join(message.split()), file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    from fuzzyarm.eval.sweep.command import add_sweep_command

    parser = argparse.ArgumentParser(
        prog="fuzzyarm", description="Tracking control of a two-joint robot arm with elastic joints."
    )
    parser.add_argument("--version", action="version", version=f"fuzzyarm {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_evaluate(commands)
    _add_leaderboard(commands)
    _add_report(commands)
    _add_design(commands)
    _add_verify(commands)
    _add_bench(commands)
    _add_margins(commands)
    _add_train(commands)
    add_sweep_command(commands)
    _add_paper(commands)
    return parser


def _add_evaluate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "evaluate",
        help="run policies on the elastic arm and write a table and figures",
        description="Run policies on the elastic arm in the paper's cases; print a table, write JSON, CSV and figures.",
    )
    parser.add_argument(
        "--policy",
        action="append",
        metavar="NAME",
        help="fuzzy-32, -16, -8, -4, -2, -1, computed-torque or a controller file (.json), each with the ending -tip "
        "to bring the tip to the reference instead of the motors, elastic-observer, ppo-nominal, -robust, -residual or "
        "a learned policy's folder, or code of your own as package.module:factory; may be repeated (default: fuzzy-4, "
        "computed-torque, both with -tip, elastic-observer and the learned ones)",
    )
    parser.add_argument(
        "--case",
        action="append",
        metavar="NAME",
        help="nominal, machining or payload; may be repeated (default: all three)",
    )
    parser.add_argument("--seeds", type=int, metavar="N", help="episodes, seeded 0 to N-1 (default: 1)")
    parser.add_argument(
        "--encoder-noise",
        type=float,
        nargs=2,
        metavar=("RAD", "RAD_PER_S"),
        help="standard deviation on motor angles [rad] and velocities [rad/s] (default: 0 0)",
    )
    parser.add_argument("--robot", type=Path, metavar="FILE", help="TOML file of another arm (default: Table 1)")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for results and figures, made if needed (default: fuzzyarm-evaluation)",
    )
    parser.add_argument("--json", action="store_true", help="print the results as JSON instead of the table")
    parser.add_argument(
        "--check",
        type=Path,
        metavar="FILE",
        help="run what a results.json, or the folder that holds it, says and compare every number but times; write "
        "nothing; exit code 1 if one differs. Code of your own that the file names runs only if --policy names it too",
    )
    parser.set_defaults(run=_evaluate)


def _add_leaderboard(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "leaderboard",
        help="rank the policies of several evaluations",
        description="Rank the policies of results files by the geometric mean over the cases of the rms tip error. "
        "Refuses files of different conditions or versions.",
    )
    parser.add_argument(
        "files", nargs="+", type=Path, metavar="FILE", help="results.json, or folder that fuzzyarm evaluate --out wrote"
    )
    parser.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    parser.set_defaults(run=_leaderboard)


def _add_report(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "report",
        help="make one HTML page of an evaluation, with a replay",
        description="Make one self-contained HTML page of an evaluation: tables, curves, a replay of the arms, and "
        "the certified bounds beside the worst observed. It fetches nothing.",
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder that fuzzyarm evaluate --out wrote")
    parser.add_argument("--out", type=Path, metavar="FILE", help="page to write (.html; default: DIR/report.html)")
    parser.set_defaults(run=_report)


def _add_design(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "design",
        help="design a fuzzy controller by linear matrix inequalities",
        description="Design a fuzzy controller in the consistent-reference form and check it from its stored gains.",
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--rules", type=int, default=4, metavar="N", help="32, 16, 8, 4, 2 or 1 rules (default: 4)")
    which.add_argument("--keep", metavar="Z,Z", help="premises to keep, such as z1,z3; the others become uncertainty")
    parser.add_argument(
        "--theorem",
        choices=("consistent", "paper"),
        default="consistent",
        help="consistent-reference form, or Theorem 1 or 2 of the paper with the reference model in the loop "
        "(default: consistent)",
    )
    parser.add_argument(
        "--alpha", default="20", metavar="RATE", help='decay rate [1/s], or "max" for the largest (default: 20)'
    )
    parser.add_argument(
        "--gamma",
        metavar="GAIN",
        help='bound of the L2 gain, in the consistent form in rad/(N m), or "min" for the smallest '
        "(default: 2e-4, with --theorem paper 1000)",
    )
    parser.add_argument(
        "--gain-bound",
        type=float,
        metavar="BOUND",
        help="bound of the feedback [N m/rad], on joint 1's position gain, on the others in proportion to their units "
        "(default: as small as the rest allows)",
    )
    parser.add_argument(
        "--fastest-pole",
        type=float,
        metavar="RATE",
        help="bound of the decay rate from above [1/s]: the rigid loop frozen at any state of the box has no pole with "
        "a real part below -RATE (default: no bound)",
    )
    parser.add_argument(
        "--common-multiplier",
        action="store_true",
        help="one multiplier for all dropped premises of A, as Theorem 2 prints it (default: one for each)",
    )
    parser.add_argument(
        "--integral", action=argparse.BooleanOptionalAction, default=True, help="integral action (default: on)"
    )
    parser.add_argument("--robot", type=Path, metavar="FILE", help="TOML file of another arm (default: Table 1)")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="controller file to write (.json)")
    parser.set_defaults(run=_design)


def _add_verify(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "verify",
        help="prove controller files anew in exact arithmetic",
        description="Form every matrix inequality of controller files from the stored gains and prove it in exact "
        "rational arithmetic. Exit code 0 only if all are proven.",
    )
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="controller file (.json)")
    parser.add_argument("--json", action="store_true", help="print the claims as JSON")
    parser.set_defaults(run=_verify)


def _add_bench(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "bench",
        help="measure steps per second beside the peers that are installed",
        description="Measure environment steps per second, this project's environments and their peers in turns; "
        "print a table. About two minutes. The peers come with: pip install 'fuzzyarm[bench]', torch with [rl].",
    )
    parser.add_argument(
        "--seconds", type=float, default=0.5, metavar="S", help="wall time of each turn [s] (default: 0.5)"
    )
    parser.add_argument(
        "--rounds", type=int, default=5, metavar="N", help="turns of each entry, odd and at least 5 (default: 5)"
    )
    parser.add_argument(
        "--lanes",
        type=int,
        nargs="+",
        default=(64, 1024, 65536),
        metavar="N",
        help="sizes of the batches (default: 64 1024 65536; peers up to 4096, torch from there on)",
    )
    parser.add_argument(
        "--threads",
        type=int,
        default=os.cpu_count() or 1,
        metavar="N",
        help="threads a batch may use (default: one per core)",
    )
    parser.add_argument(
        "--lanes-sweep",
        action="store_true",
        help="measure batches of 1, 4, 16, ... 262144 lanes too and draw throughput.png; a few minutes, needs --out",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for bench.json and the figure (default: none)")
    parser.add_argument("--json", action="store_true", help="print the results as JSON instead of the table")
    parser.set_defaults(run=_bench)


def _add_margins(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "margins",
        help="measure how far policies are from instability on the sampled elastic arm",
        description="Linearise the loop of each policy with the sampled elastic arm along the paper's path; print its "
        "spectral radius, nominal and with another loop gain, delay, stiffness or payload, and its gain margins.",
    )
    parser.add_argument(
        "--policy",
        action="append",
        metavar="NAME",
        help="fuzzy-4, computed-torque, ... a controller file (.json), a learned policy's folder, or code of your own "
        "as package.module:factory, which must act on batches; may be repeated (default: all by name)",
    )
    parser.add_argument("--robot", type=Path, metavar="FILE", help="TOML file of another arm (default: Table 1)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="results file to write (.json; default: none)")
    parser.add_argument("--json", action="store_true", help="print the results as JSON instead of the table")
    parser.set_defaults(run=_margins)


def _add_train(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from fuzzyarm.rl_baselines.algorithms import ALGORITHMS

    parser = commands.add_parser("train", help="train a policy", description="Train a policy on the batched arms.")
    algorithms = parser.add_subparsers(dest="algorithm", required=True, metavar="ALGORITHM")
    for spec in ALGORITHMS.values():
        one = algorithms.add_parser(spec.name, help=spec.title, description=f"Train a policy with {spec.title}.")
        one.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the run, made if needed")
        one.add_argument("--resume", action="store_true", help="go on from the last checkpoint in --out")
        one.add_argument("--preset", choices=list(spec.presets), help="what the other flags start from")
        for field in dataclasses.fields(spec.config):
            flag = f"--{field.name.replace('_', '-')}"
            if isinstance(field.default, bool):
                one.add_argument(flag, action=argparse.BooleanOptionalAction, default=None)
            elif isinstance(field.default, tuple):
                one.add_argument(flag, nargs="*", type=type(field.default[0]))
            else:
                one.add_argument(flag, type=type(field.default))
        one.set_defaults(run=_train)


def _add_paper(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "paper",
        help="make the paper's figures and numbers anew and see that ours have not moved",
        description="Make Figs. 2-10 and Table 2 of the paper anew from the controllers with 32 and 4 rules, and a "
        "table of what the paper says and what we measure. Exit code 1 if a number has moved by more than its "
        "tolerance from the stored one. A quarter of a minute.",
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for paper.md, paper.json and the figures"
    )
    parser.add_argument(
        "--expected", type=Path, metavar="FILE", help="stored numbers to compare with (default: those of the package)"
    )
    parser.add_argument(
        "--renew", type=Path, metavar="FILE", help="write the measured numbers to FILE, for --expected; exit code 0"
    )
    parser.add_argument("--json", action="store_true", help="print the results as JSON instead of the tables")
    parser.set_defaults(run=_paper)


def _evaluate(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.eval.episodes.rollout_file import write_rollouts
    from fuzzyarm.eval.evaluation.figures import write_figures
    from fuzzyarm.eval.evaluation.result_table import print_table
    from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate, write_results

    if options.check is not None:
        return _check(options)
    given = {
        "policies": options.policy and tuple(options.policy),
        "cases": options.case and tuple(options.case),
        "seeds": options.seeds,
        "encoder_noise": options.encoder_noise and tuple(options.encoder_noise),
        "parameters": options.robot and ArmParameters.from_toml(options.robot),
    }
    config = EvaluationConfig(**{name: value for name, value in given.items() if value is not None})
    out = options.out or Path("fuzzyarm-evaluation")
    _make_folder(out)
    stderr = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=stderr, disable=not stderr.is_terminal, transient=True) as bar:
        episodes = bar.add_task("episodes", total=len(config.policies) * len(config.cases) * config.seeds)
        evaluation = evaluate(config, lambda: bar.advance(episodes))
        written = write_results(evaluation, out)
        drawing = bar.add_task("figures", total=None)
        written += write_figures(evaluation.rollouts, out, lambda: bar.advance(drawing))
        written.append(write_rollouts(evaluation.rollouts, out))  # last: with it the evaluation is whole
    if options.json:
        print(json.dumps(evaluation.to_dict(), indent=1))
    else:
        # Wide when piped: a plain table must not be folded.
        console = Console() if sys.stdout.isatty() else Console(width=200)
        print_table(evaluation.rows, console)
        for name, text in evaluation.certificates.items():
            words = f"\n{name}: {'no certificate' if text is None else 'certificate. ' + text}"
            console.print(words, highlight=False, markup=False, emoji=False)  # module:factory: would become a picture
        console.print(f"\n{len(written)} files in {out}", highlight=False)
    for run in evaluation.rollouts:
        if not run.completed:
            print(f"{run.policy} in case {run.case} ended at {run.time[-1]:.3f} s: {run.reason}", file=sys.stderr)
    return 0 if evaluation.complete else 1


def _check(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from fuzzyarm.eval.evaluation.recheck import check, print_check
    from fuzzyarm.eval.evaluation.results_file import read_results

    for name in ("case", "seeds", "encoder_noise", "robot", "out", "json"):
        if getattr(options, name) is not None and getattr(options, name) is not False:
            option = f"--{name.replace('_', '-')}"
            raise UsageError(f"--check runs what the file says and writes nothing: leave out {option}")
    results = read_results(options.check)
    stderr = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=stderr, disable=not stderr.is_terminal, transient=True) as bar:
        episodes = bar.add_task("episodes", total=len(results.rows))
        found = check(results, options.policy or (), lambda: bar.advance(episodes))
    print_check(found, Console() if sys.stdout.isatty() else Console(width=200))
    return 1 if found.differences else 0


def _leaderboard(options: argparse.Namespace) -> int:
    from rich.console import Console

    from fuzzyarm.eval.evaluation.ranking import leaderboard, markdown, print_leaderboard

    board = leaderboard(options.files)
    if options.markdown:
        print(markdown(board))
    else:
        # Wide when piped: a plain table must not be folded.
        print_leaderboard(board, Console() if sys.stdout.isatty() else Console(width=400))
    return 0


def _report(options: argparse.Namespace) -> int:
    from rich.console import Console

    from fuzzyarm.eval.report.page import write_report

    out = options.out or options.folder / "report.html"
    if out.suffix != ".html":
        raise UsageError(f"--out {out} must end in .html")
    if not out.parent.is_dir() and options.out:
        raise UsageError(f"--out {out}: the folder {out.parent} does not exist")
    stderr = Console(stderr=True)
    with stderr.status("observing the certified loops") if stderr.is_terminal else contextlib.nullcontext():
        write_report(options.folder, out)
    print(f"written to {out}")
    return 0


def _design(options: argparse.Namespace) -> int:
    from rich.console import Console

    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
    from fuzzyarm.synthesis.design import DesignFailed, Specification, describe, design

    if options.keep is None and options.rules not in NAMED_RULES:
        raise UsageError(f"--rules {options.rules} is unknown; choose from: {', '.join(map(str, NAMED_RULES))}")
    kept = NAMED_RULES[options.rules]
    if options.keep is not None:
        kept = tuple(name for name in options.keep.split(",") if name)
    if options.out.suffix != ".json":
        raise UsageError(f"--out {options.out} must end in .json")
    if not options.out.parent.is_dir():
        raise UsageError(f"--out {options.out}: the folder {options.out.parent} does not exist")
    gamma = options.gamma or ("2e-4" if options.theorem == "consistent" else "1000")
    specification = Specification(
        kept=kept,
        form=options.theorem,
        alpha=_number_or("--alpha", options.alpha, "max"),
        gamma=_number_or("--gamma", gamma, "min"),
        gain_bound=options.gain_bound,
        integral=options.integral,
        common_multiplier=options.common_multiplier,
        fastest_pole=options.fastest_pole,
    )
    parameters = ArmParameters.from_toml(options.robot) if options.robot else ArmParameters()
    stderr = Console(stderr=True)
    try:
        with stderr.status("solving and proving") if stderr.is_terminal else contextlib.nullcontext():
            result = design(specification, parameters)
    except DesignFailed as error:
        return _fail(f"fuzzyarm design: {error}; nothing was written", 1)
    result.controller.save(options.out)
    print(describe(result))
    print(f"\nwritten to {options.out}")
    return 0


def _number_or(name: str, text: str, word: str) -> float | None:
    """Return a number, or None for the word that asks for the best one."""
    if text == word:
        return None
    try:
        return float(text)
    except ValueError:
        raise UsageError(f'{name} {text} must be a number or "{word}"') from None


def _verify(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import track

    from fuzzyarm.eval.certified.verification import verify_file

    stderr = Console(stderr=True)
    silent = not stderr.is_terminal or len(options.files) == 1
    reports = [
        verify_file(path) for path in track(options.files, "verifying", console=stderr, disable=silent, transient=True)
    ]
    if options.json:
        print(json.dumps([report.to_dict() for report in reports], indent=1))
    else:
        print("\n\n".join(report.to_text() for report in reports))
    return 0 if all(report.certificate.proven for report in reports) else 1


def _bench(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from fuzzyarm.eval.bench.run import BenchConfig, bench, write_document
    from fuzzyarm.eval.bench.speed_table import print_speeds

    config = BenchConfig(
        seconds=options.seconds,
        rounds=options.rounds,
        lanes=tuple(options.lanes),
        threads=options.threads,
        sweep=options.lanes_sweep,
    )
    if config.sweep and options.out is None:
        raise UsageError("--lanes-sweep draws throughput.png: say where with --out DIR")
    if options.out is not None:
        _make_folder(options.out)
    stderr = Console(stderr=True)
    columns = (BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    # Drawn between the turns: nothing else runs while one is timed.
    silent = not stderr.is_terminal
    with Progress(*columns, console=stderr, disable=silent, transient=True, auto_refresh=False) as bar:
        turns = bar.add_task("", total=config.turns())
        document = bench(config, lambda text: bar.update(turns, advance=1, description=text, refresh=True))
    written = write_document(document, options.out) if options.out is not None else []
    if options.json:
        print(json.dumps(document, indent=1))
    else:
        print_speeds(document, Console() if sys.stdout.isatty() else Console(width=220))
        if written:
            print(f"\n{', '.join(path.name for path in written)} in {options.out}")
    return 0


def _margins(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from fuzzyarm.common.files import write_atomically
    from fuzzyarm.eval.stability.margins import MarginsConfig, margins, print_margins
    from fuzzyarm.policies import NAMES

    if options.out is not None:
        if options.out.suffix != ".json" or options.out.is_dir():
            raise UsageError(f"--out {options.out} must be a file ending in .json")
        if not options.out.parent.is_dir():
            raise UsageError(f"--out {options.out}: the folder {options.out.parent} does not exist")
        _make_folder(options.out.parent)  # it is there; this sees that it can be written to
    config = MarginsConfig(policies=tuple(options.policy or NAMES), robot=options.robot)
    stderr = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=stderr, disable=not stderr.is_terminal, transient=True) as bar:
        policies = bar.add_task("policies", total=len(config.policies))
        document = margins(config, lambda: bar.advance(policies))
    text = json.dumps(document, indent=1)
    if options.out is not None:
        write_atomically(options.out, text + "\n")
    if options.json:
        print(text)
    else:
        # Wide when piped: a plain table must not be folded.
        print_margins(document, Console() if sys.stdout.isatty() else Console(width=400))
        if options.out is not None:
            print(f"\nwritten to {options.out}")
    return 0


def _train(options: argparse.Namespace) -> int:
    from fuzzyarm.rl_baselines.algorithms import find_algorithm
    from fuzzyarm.rl_baselines.progress import train_with_progress

    spec = find_algorithm(options.algorithm)
    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(spec.config)}
    given = {
        name: tuple(value) if isinstance(value, list) else value for name, value in given.items() if value is not None
    }
    if options.resume:
        flags = [f"--{name.replace('_', '-')}" for name in (*(["preset"] if options.preset else []), *given)]
        if flags:
            raise ValueError(f"--resume goes on as the run was configured; leave out {', '.join(flags)}")
        train_with_progress(None, options.out)
    else:
        preset = options.preset or next(iter(spec.presets))
        config = dataclasses.replace(spec.presets[preset], **given)
        _make_folder(options.out)
        train_with_progress(config, options.out)
    print(f"written to {options.out / 'policy'}")
    return 0


def _paper(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from fuzzyarm.eval.paper.drift import EXPECTED, load_expected, store_expected
    from fuzzyarm.eval.paper.evidence import STEPS, gather
    from fuzzyarm.eval.paper.figures import write_figures
    from fuzzyarm.eval.paper.report import compare, print_report, renewed, write_report

    if options.renew and options.expected:
        raise UsageError("--renew writes new stored numbers, --expected compares with old ones; give one of the two")
    stored = {} if options.renew else load_expected(options.expected or EXPECTED)
    _make_folder(options.out)
    stderr = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=stderr, disable=not stderr.is_terminal, transient=True) as bar:
        runs = bar.add_task("runs and proofs", total=STEPS)
        evidence = gather(lambda: bar.advance(runs))
        comparison = compare(evidence, stored)
        if options.renew:
            comparison = renewed(comparison)
            store_expected(comparison.measured, comparison.made_with, options.renew)
        drawing = bar.add_task("figures", total=None)
        figures = write_figures(evidence, options.out, lambda: bar.advance(drawing))
    written = [*figures, *write_report(comparison, figures, options.out)]
    if options.json:
        print(json.dumps(comparison.to_dict(), indent=1))
    else:
        # Wide when piped: a plain table must not be folded.
        print_report(comparison, Console() if sys.stdout.isatty() else Console(width=400))
        print(f"\n{len(written)} files in {options.out}")
    for moved in comparison.drifted:
        print(f"fuzzyarm paper: {moved}", file=sys.stderr)
    return 1 if comparison.drifted else 0


def _make_folder(folder: Path) -> None:
    """Make the folder and see that it can be written to, before anything runs."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"cannot write to {folder}: {error.strerror or error}") from None
