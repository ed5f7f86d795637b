"""The HTML page of an evaluation: one file that fetches nothing and in which all text is escaped.

``page.html`` defines the structure, ``page.css`` the style; the scripts, which are joined into one, run the replay. A
content security policy names the digests of script and style, so that a browser runs and loads nothing else.
"""

import base64
import hashlib
import json
import re
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from fuzzyarm import __version__
from fuzzyarm.common.checks import path_of
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.episodes.metrics import LOST
from fuzzyarm.eval.evaluation.ranking import Standing, standings_of
from fuzzyarm.eval.evaluation.results_file import read_evaluation
from fuzzyarm.eval.evaluation.run import Evaluation, EvaluationConfig
from fuzzyarm.eval.report._belief_charts import belief_section
from fuzzyarm.eval.report._payload import replay_data
from fuzzyarm.eval.report._summary import declared_table, error_charts, metrics_table
from fuzzyarm.eval.report.certificates import checked_bounds, statements, tube_section
from fuzzyarm.proof.certificate import NOT_COVERED

__all__ = ["write_report"]


_SCRIPTS = ("data.js", "canvas.js", "plane.js", "space.js", "arms.js", "curves.js", "plots.js", "page.js")
_TICKED = 4  # number of policies, the best ones, that the page shows at first


def write_report(folder: str | Path, out: str | Path, bounds: Sequence[str | Path] = ()) -> None:
    """Write the report of the evaluation in `folder` to `out`, atomically, with the tubes from the files `bounds`.

    Raises:
        ValueError: the folder has no evaluation, or files that are damaged or from several evaluations, or a bound is
            not proven or belongs to no episode of the evaluation; nothing is written.
        OSError: a file cannot be read or written.
    """
    out, stored = path_of("out", out), read_evaluation(path_of("folder", folder))
    tubes = tube_section(checked_bounds([Path(one) for one in bounds]), stored.rollouts)
    write_atomically(out, _render_page(stored, tubes))


def _render_page(stored: Evaluation, tubes: str = "") -> str:
    structure, style, script = _part("page.html"), _part("page.css"), "\n".join(map(_part, _SCRIPTS))
    config, ranked = stored.config, sorted(standings_of(stored), key=lambda one: one.order)
    data = replay_data(stored) | {"ticked": [one.policy for one in ranked[:_TICKED]]}
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return Template(structure).substitute(
        policy=_security_policy(style, script),
        title="Robot-arm tracking, policies compared",
        style=style,
        headline=escape(_headline(ranked, config)),
        lost=f"{LOST:g}",
        glance=error_charts(stored.rows, config.titles),
        table=metrics_table(stored.rows, config.titles),
        declared=declared_table(stored.declared, stored.certificates),
        beliefs=belief_section(stored.rollouts, {name: config.case(name, None) for name in config.cases}),
        not_covered=escape(NOT_COVERED),
        statements=statements(stored.certificates, stored.bounds),
        **{name: escape(note) for name, note in _notes(stored, data["stride"]).items()},
        tubes=tubes,
        made="".join(f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in _made(stored).items()),
        data=re.sub("[<>&]", lambda c: f"\\u{ord(c[0]):04x}", text),  # so that no text ends the script element
        script=script,
    )


def _headline(ranked: Sequence[Standing], config: EvaluationConfig) -> str:
    """Return text on the best policies, those that lost the path, and the rule of ranking; `ranked` is best first."""
    best = [one.policy for one in ranked if one.score and one.order == ranked[0].order]
    lost = [one.policy for one in ranked if one.score is None]
    if not best:
        return f"Every policy lost the path: {_named(lost)}."
    worst = " in the worst case" if len(config.cases) > 1 else ""
    verb = "has" if len(best) == 1 else "have"
    said = f"{_named(best)} {verb} the smallest error{worst}: {ranked[0].cells[0]} mm at the tip"
    average = " (interquartile mean over the seeds with its 95 % interval)" if config.seeds > 1 else ""
    return (
        f"{said}{f'; {_named(lost)} lost the path' if lost else ''}. "
        f"Policies are ranked by their largest tip error over all cases{average}."
    )


def _named(policies: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(policies[:-1]), policies[-1]]))


def _part(name: str) -> str:
    return resources.files("fuzzyarm.eval.report").joinpath(name).read_text(encoding="utf-8")


def _security_policy(style: str, script: str) -> str:
    """Return a content security policy that allows this style, this script and the empty icon, and nothing else."""
    of_style, of_script = (base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in (style, script))
    return (
        f"default-src 'none'; style-src 'sha256-{of_style}'; script-src 'sha256-{of_script}'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def _notes(stored: Evaluation, stride: int) -> dict[str, str]:
    """Return the line below the title and the notes below replay, charts and table, by placeholder in ``page.html``.

    The page shows every `stride`-th sample and the last of each episode.
    """
    config, made, several = stored.config, stored.made_with, stored.config.seeds > 1
    samples = "every sample" if stride == 1 else f"one sample in {stride} and the last of each episode"
    return {
        "meta": f"{made['date'][:16].replace('T', ' ')} UTC · FuzzyArm {made['versions']['fuzzyarm']} · "
        f"seeds: {config.seeds} · control period {1e3 * config.control_period:g} ms · "
        f"policies: {len(config.policies)}, cases: {len(config.cases)}",
        "sampling": f"Replay and curves show {samples} of seed 0 in single precision"
        + (", on a band from the smallest to the largest tip error of any seed" if several else "")
        + "; charts and table use the full data.",
        "glance_note": "" if stored.complete else " of the policies that finished; × ended early",
        "table_note": f"Medians over {config.seeds} seeds, with ranges." if several else "",
    }


def _made(stored: Evaluation) -> dict[str, str]:
    """Return the provenance of the evaluation and of this page, by heading."""
    made, machine = stored.made_with, stored.made_with["machine"]
    return {
        "command": str(stored.config.command(placeholders=True)),
        "date": made["date"],
        "arm": stored.config.arm_in_words,
        "versions": ", ".join(f"{name} {version}" for name, version in made["versions"].items()),
        "commit": str(made["commit"] or "none"),
        "machine": f"{machine['cpu']}, {machine['cores']} cores, {machine['system']}",
        "report": f"fuzzyarm report, FuzzyArm {__version__}; this page loads nothing from the network",
    }
