"""The HTML page of an evaluation: one file that fetches nothing and in which all text is escaped.

``page.html`` holds the structure and ``page.css`` the style; the scripts, which are joined into one, run the replay. A
content security policy names the digests of script and style, so that a browser runs and loads nothing else. A sentence
at the top says which policies won overall and in each case, by the rule of the leaderboard.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from fuzzyarm import __version__
from fuzzyarm.common.checks import path_of
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.episodes.metrics import LOST, millimetres
from fuzzyarm.eval.evaluation.ranking import Standing, standings_of
from fuzzyarm.eval.evaluation.results_file import read_evaluation
from fuzzyarm.eval.evaluation.run import Evaluation
from fuzzyarm.eval.report import certificates
from fuzzyarm.eval.report.beliefs import belief_section
from fuzzyarm.eval.report.payload import replay_data
from fuzzyarm.eval.report.summary import declared_table, digits, error_charts, finished, metrics_table
from fuzzyarm.policies import resolve

__all__ = ["write_report"]


_NAMED = 3  # policies that a list names; of the others it gives the number


def _headline(standings: Sequence[Standing], titles: Mapping[str, str]) -> str:
    """Return the sentence at the top as HTML; `titles` are those of the cases by name.

    A value is that of the leaderboard: the score overall, the rms tip error in a case. Policies whose values read the
    same win together. A policy that lost the path in a case cannot win it, nor overall; one policy alone wins nothing.
    """
    scores = {standing.policy: standing.score.mean for standing in standings if standing.score is not None}
    cases = list(standings[0].rms)
    wins: dict[tuple[str, ...], list[str]] = {}  # what each group of winners won
    nobody = []
    if len(cases) > 1 and scores:
        wins[_winners(scores)] = [f"overall with a score of {_length(min(scores.values()))}"]
    for case in cases:
        held = {standing.policy: error for standing in standings if (error := standing.rms[case]) is not None}
        title = escape(re.sub(r"^([^:]+): (.+)$", r"\1 (\2)", titles[case]))
        if held:
            won = f"in {title} with {_length(min(held.values()))}\u00a0rms"
            wins.setdefault(_winners(held), []).append(won)
        else:
            nobody.append(title)
    verb = "runs alone," if len(standings) == 1 else "wins"
    parts = [f"{_names(names)} {verb if len(names) == 1 else 'tie'} {_series(where)}" for names, where in wins.items()]
    if nobody:
        parts.append(f"nobody held the path in {_series(nobody)}")
    return "; ".join([*parts, *_lost(standings), *_overlap(standings)]) + "."


def _rule(standings: Sequence[Standing]) -> str:
    """Return the rule by which a policy wins, in words."""
    several = standings[0].episodes > len(standings[0].rms)
    seeds = "; interquartile means over the seeds" if several else ""
    score = "" if len(standings[0].rms) == 1 else " Score: the largest tip error of all cases, as in the leaderboard."
    return (
        f"A case is won by the smallest rms tip error{seeds}.{score} A policy that ended early or was more than "
        f"{LOST:g} mm off lost the path and is not ranked."
    )


def _winners(values: Mapping[str, float]) -> tuple[str, ...]:
    """Return the policies whose value, as printed, equals the smallest one."""
    smallest = _length(min(values.values()))
    return tuple(policy for policy, value in values.items() if _length(value) == smallest)


def _lost(standings: Sequence[Standing]) -> list[str]:
    """Return a clause on the policies that lost the path and in how many episodes, the most frequent loser last."""
    lost = sorted((standing for standing in standings if standing.lost), key=lambda standing: standing.lost)
    overall = " overall" if len(standings[0].rms) > 1 else ""
    often = [f"in {one.lost} of {_counted(one.episodes, 'episode')}" for one in lost]
    if len(lost) < 2:
        return [f"{_names([lost[0].policy])} lost the path {often[0]} and is not ranked{overall}"] if lost else []
    named = [f"{_names([one.policy])} ({where})" for one, where in zip(lost[:_NAMED], often, strict=False)]
    if len(lost) > _NAMED:
        named.append(_counted(len(lost) - _NAMED, "other"))
    return [f"{_series(named)} lost the path and are not ranked{overall}"]


def _overlap(standings: Sequence[Standing]) -> list[str]:
    """Return a clause on the policies whose intervals overlap that of the best one."""
    scores = [(standing.policy, standing.score) for standing in standings if standing.score is not None]
    if len(scores) < 2:
        return []
    (first, best), *others = sorted(scores, key=lambda pair: pair[1].mean)
    high = -math.inf if best.high is None else best.high
    alike = [policy for policy, score in others if score.low is not None and score.low <= high]
    return [f"the 95 % interval of the score of {_names([first])} overlaps that of {_names(alike)}"] if alike else []


def _length(error: float) -> str:
    return f"{escape(millimetres(error, digits))}\u00a0mm"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _names(policies: Sequence[str]) -> str:
    names = [f"<strong>{escape(policy)}</strong>" for policy in policies]
    return _series(names if len(names) <= _NAMED + 1 else [*names[:_NAMED], _counted(len(names) - _NAMED, "other")])


def _series(parts: Sequence[str]) -> str:
    """Return "a", "a and b" or "a, b and c"."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


_SCRIPTS = ("data.js", "canvas.js", "plane.js", "space.js", "arms.js", "curves.js", "plots.js", "page.js")


def write_report(folder: str | Path, out: str | Path, bounds: Sequence[str | Path] = ()) -> None:
    """Write the report of the evaluation in `folder` to `out`, atomically, with the tubes of files of tip bounds.

    Raises:
        ValueError: the folder holds no evaluation, or a damaged or mixed one, or a bound is not proven or not of an
            episode of the evaluation; nothing is written.
        OSError: a file cannot be read or written.
    """
    out, stored = path_of("out", out), read_evaluation(path_of("folder", folder))
    tubes = certificates.tube_section(certificates.checked_bounds([Path(one) for one in bounds]), stored.rollouts)
    write_atomically(out, _render_page(stored, certificates.observe_policies(stored.config, stored.bounds), tubes))


def _render_page(stored: Evaluation, observed: Mapping[str, certificates.Observed | str], tubes: str = "") -> str:
    """Return the HTML of the page; it shows what was `observed` beside the certified bounds, then `tubes`."""
    structure, style, script = _part("page.html"), _part("page.css"), "\n".join(map(_part, _SCRIPTS))
    config, data, early = stored.config, replay_data(stored), not finished(stored.rows)
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    standings = standings_of(stored)
    seeds = f"0 to {config.seeds - 1}" if config.seeds > 1 else "0"
    return Template(structure).substitute(
        policy=_security_policy(style, script),
        title="Robot-arm tracking, policies compared",
        style=style,
        headline=_headline(standings, config.titles),
        rule=escape(_rule(standings)),
        glance=error_charts(stored.rows, config.titles),
        table=metrics_table(stored.rows, config.titles),
        declared=declared_table(stored.declared, stored.certificates),
        beliefs=belief_section(stored.rollouts, {name: config.case(name, None) for name in config.cases}),
        **certificates.certificate_parts(stored, observed),
        **{name: escape(note) for name, note in _notes(stored, seeds, data["stride"], early).items()},
        tubes=tubes,
        made="".join(f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in _made(stored, seeds).items()),
        data=re.sub("[<>&]", lambda c: f"\\u{ord(c[0]):04x}", text),  # no text ends its script element
        script=script,
    )


def _part(name: str) -> str:
    return resources.files("fuzzyarm.eval.report").joinpath(name).read_text(encoding="utf-8")


def _security_policy(style: str, script: str) -> str:
    """Return a content security policy that allows this style, this script and the empty icon, and nothing else."""
    of_style, of_script = (base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in (style, script))
    return (
        f"default-src 'none'; style-src 'sha256-{of_style}'; script-src 'sha256-{of_script}'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def _notes(stored: Evaluation, seeds: str, stride: int, early: bool) -> dict[str, str]:
    """Return the line below the title and the notes below replay, charts and table, by their name in ``page.html``."""
    config, made, several = stored.config, stored.made_with, stored.config.seeds > 1
    samples = "every sample" if stride == 1 else f"one sample in {stride} and the last of each episode"
    stars = [
        "★ smallest of its column and case, left out where more than half share it; of a range the larger end counts."
    ]
    if early:
        stars.append("An episode that ended early cannot have a star, because its numbers are of a shorter motion.")
    if several:
        samples += " of seed 0"
        stars.append(f"Medians over {config.seeds} seeds, with ranges.")
    return {
        "meta": f"{made['date'][:16].replace('T', ' ')} UTC · FuzzyArm {made['versions']['fuzzyarm']} · "
        f"{'seeds' if several else 'seed'} {seeds} · control period {1e3 * config.control_period:g} ms · "
        f"policies: {len(config.policies)}, cases: {len(config.cases)}",
        "sampling": f"Replay and curves show {samples} in single precision; charts and table are of the full data.",
        "glance_note": " of the policies that finished; × ended early" if early else "",
        "table_note": " ".join(stars),
    }


def _made(stored: Evaluation, seeds: str) -> dict[str, str]:
    """Return the provenance of the evaluation and of this page, by heading."""
    config, made = stored.config, stored.made_with
    noise = "{:g} rad, {:g} rad/s".format(*config.encoder_noise) if any(config.encoder_noise) else "none"
    machine = made["machine"]
    return {
        "command": str(config.command(placeholders=True)),
        "date": made["date"],
        "policies": ", ".join(resolve(name).label for name in config.policies),
        "seeds": seeds,
        "encoder noise": noise,
        "arm": config.arm_in_words,
        "versions": ", ".join(f"{name} {version}" for name, version in made["versions"].items()),
        "commit": str(made["commit"] or "none"),
        "machine": f"{machine['cpu']}, {machine['cores']} cores, {machine['system']}",
        "report": f"fuzzyarm report, FuzzyArm {__version__}; this file fetches nothing",
    }
