"""The README's tables of evaluations, sweeps and speed, from stored results."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from learned_tables import training_cells
from readme_markdown import made_with, table

from fuzzyarm.common.arithmetic import at_most
from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES
from fuzzyarm.eval.episodes.metrics import columns, millimetres
from fuzzyarm.eval.evaluation.ranking import markdown, rank_policies
from fuzzyarm.eval.evaluation.result_table import table_rows
from fuzzyarm.eval.sweep.ranking import rank_sweeps

__all__ = [
    "accuracy_table",
    "leaderboard_table",
    "learned_tables",
    "markdown_table",
    "paper_line",
    "peer_line",
    "plants_leaderboard",
    "saturation_table",
    "soak_line",
    "speed_table",
    "sweep_table",
    "tip_table",
]


def paper_line(document: dict[str, Any]) -> str:
    """Return a paragraph that compares the circularity of `fuzzy-4` with the numbers of the paper."""
    rows = {row["case"]: row for row in document["results"] if row["policy"] == "fuzzy-4"}
    ranges = (
        f"[{rows[case]['circularity_motor_min_mm']:+.2f}, {rows[case]['circularity_motor_max_mm']:+.2f}] mm in Case {k}"
        for k, case in enumerate(PAPER_CASES, start=1)
    )
    return (
        "Beside the paper, which reports circularity errors of 1.3 mm (Case 1) and -2.3 to 4.4 mm (Case 2) for its "
        "4-rule controller without saying on which side: with the motor angles, as if the joints were rigid, `fuzzy-4` "
        f"has {', '.join(ranges)}. That tells how well the motors are led, not where the tip is."
    )


def overview_table(document: dict[str, Any], bounds: dict[str, Any]) -> str:
    """Return the README's table: rms and largest tip error of each policy in each case, and what is proven of it."""
    headings = ["tip error, rms / largest [mm]", *PAPER_CASES, "proven"]
    rows = [
        [
            policy,
            *(
                f"{_two_figures(row['tip_error_rms_mm'])} / {_two_figures(row['tip_error_max_mm'])}"
                for case in PAPER_CASES
                for row in document["results"]
                if (row["policy"], row["case"]) == (policy, case)
            ),
            words,
        ]
        for policy, words in _proven(document, bounds).items()
    ]
    return (
        f"{table(headings, rows)}\n\n{_OF_THE_TIP}\n\n`fuzzyarm evaluate`, `{bounds['command']}`; "
        f"{made_with(document, _tips(document, bounds))}"
    )


_NEARBY = ("near", "any-friction")
_OF_THE_TIP = (
    "[Proven](docs/theory/certificate.md), of the rigid arm: decay and L2 gain in a box; of the tip: a bound at every "
    "sample of the nominal case, on the elastic arm with sampled control, for every arm of a set. `near`: stiffness "
    "± 2 %, damping ± 10 %, masses ± 0.5 %, motor inertias ± 1 %, dry friction ± 20 %; any friction: any torque up to "
    "the static one; exact: the arm of Table 1 alone, known exactly."
)


def _proven(document: dict[str, Any], bounds: dict[str, Any]) -> dict[str, str]:
    """Return what is proven of each policy of an evaluation, of the rigid arm and of the tip, in a few words."""
    proven, tips = {}, _tips(document, bounds)
    for policy, certificate in document["certificates"].items():
        nearby = []
        for row in tips.get(policy, []):
            words = {"any-friction": "any friction", "table-1": "exact"}.get(row["set"], row["set"])
            nearby.append(f"{at_most(row['bound_mm'], 2)} mm ({words})")
        parts = ["rigid arm"] * (certificate is not None) + [f"tip within {', '.join(nearby)}"] * bool(nearby)
        proven[policy] = "; ".join(parts) or "no"
    return proven


def _tips(document: dict[str, Any], bounds: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Return the bounds of the tip that are shown for each policy of an evaluation.

    These are those for arms near that of Table 1 and for the widest range of payloads; where there are none, that for
    this arm alone, which is said.
    """
    circle = {"case": "nominal", "path": "circle", "duration": 1.5, "proven": True}
    tips: dict[str, dict[str, dict[str, Any]]] = {}
    rows = [row for row in bounds["rows"] if {key: row[key] for key in circle} == circle]
    for row in sorted(rows, key=lambda row: row["plants"]["payload"][1]):
        kind = "payload" if row["set"].startswith("payload") else row["set"]
        tips.setdefault(row["policy"], {})[kind] = row
    return {
        policy: [found[kind] for kind in (*_NEARBY, "payload") if kind in found] or [*found.values()][:1]
        for policy, found in tips.items()
        if policy in document["certificates"]
    }


def speed_lines(bench: dict[str, Any]) -> str:
    """Return the README's three speeds, each with the peers of the same run."""
    shown = {
        "one environment": ("One arm", {"Pendulum": "Gymnasium's Pendulum", "Reacher": "its Reacher"}),
        "64 lanes": ("64 arms", {"Pendulum": "EnvPool's Pendulum"}),
        "1024 lanes": ("1024 arms", {"MuJoCo arm": "the same arm in MuJoCo at equal tip accuracy"}),
    }
    lines = []
    for row in bench["rows"]:
        if row["group"] in shown and row["ratios"]:
            name, peers = shown[row["group"]]
            times = [f"{row['ratios'][key]['median']:.3g} times as fast as {peer}" for key, peer in peers.items()]
            speed = 1e-3 * row["steps_per_s"]["median"]
            lines.append(f"- {name}: {speed:,.0f} thousand control steps a second, {' and '.join(times)}.")
    return "\n".join([*lines, "", f"`{bench['command']}`; {made_with(bench)}"])


def _two_figures(value: float) -> str:
    return millimetres(value, lambda length: f"{length:#.2g}".rstrip("."))


def tip_table(document: dict[str, Any]) -> str:
    """Return the table of tip errors of the laws with and without compensation of the bending."""
    cases = {"nominal": "Case 1", "machining": "Case 2", "payload": "Case 3"}
    keys = (*cases, "stiffness_wrong")
    wrong = f"Case 1, stiffness {100 * document['wrong']:.0f} % off"
    headings = ["law", "variant", *(f"{name}: max / rms [mm]" for name in (*cases.values(), wrong))]
    rows = [
        [row["law"], row["variant"]]
        + [f"{millimetres(row[key]['max_mm'])} / {millimetres(row[key]['rms_mm'])}" for key in keys]
        for row in document["rows"]
    ]
    return f"{table(headings, rows, left=2)}\n\n`{document['command']}`; {made_with(document)}"


def markdown_table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the table as Markdown."""
    headings = ["case", "policy", *columns()]
    return table(headings, [(case, policy, *cells) for case, policy, cells in table_rows(rows)], left=2)


def saturation_table(document: dict[str, Any]) -> str:
    """Return the table of pushes beyond the torque limits, with the integral held there and not."""
    headings = ["law", "push [N]", "integral", "at a limit [ms]", "max [mm]", "rms after the push [mm]", "episode"]
    rows = [
        [
            row["law"],
            f"{row['force']:.0f}",
            "held" if row["held"] else "not held",
            f"{row['at_limit_ms']}",
            f"{row['max_mm']:#.3g}",
            "" if row["rms_after_mm"] is None else f"{row['rms_after_mm']:#.3g}",
            "completed" if row["completed"] else "leaves the domain",
        ]
        for row in document["rows"]
    ]
    return f"{table(headings, rows)}\n\n`{document['command']}`; {made_with(document)}"


def learned_tables(document: dict[str, Any]) -> str:
    """Return a table of the largest errors, one of the rms errors, and one of the trainings."""
    titles = {task["name"]: task["title"].removeprefix("Case 1, ").partition(":")[0] for task in document["tasks"]}
    policies = list(dict.fromkeys(row["policy"] for row in document["rows"]))
    cells = {(row["policy"], row["task"]): row for row in document["rows"]}
    parts = []
    for key, heading in (("tip_error_max_mm", "largest tip error [mm]"), ("tip_error_rms_mm", "rms tip error [mm]")):
        rows = [[name, *(_learned_cell(cells[name, task], key) for task in titles)] for name in policies]
        parts.append(table([heading, *titles.values()], rows))
    method = document["method"]
    parts.append(
        "Beside the cases other circles and an eight, without load. Of learned policies the interquartile mean over "
        f"the seeds with its {100 * method['interval']['level']:.0f} % bootstrap interval, without those that failed: "
        f"{method['failed']['rule'].partition(';')[0]}. `{document['command']}`; {made_with(document)}"
    )
    parts.append(table(*training_cells(document)))
    return "\n\n".join(parts)


def _learned_cell(row: dict[str, Any], key: str) -> str:
    """Return an error [mm] with its interval if it has one, and how many seeds failed if any did."""
    failed = f"{row['failed']} of {row['episodes']} failed" if row["failed"] else ""
    if row[key] is None:
        return failed
    mean, low, high = ("" if value is None else _two_figures(value) for value in row[key].values())
    interval = f" ({low} to {high})" if low else ""
    return f"{mean}{interval}{', ' if failed else ''}{failed}"


def leaderboard_table(results: Path, bounds: dict[str, Any]) -> str:
    """Return the output of `fuzzyarm leaderboard --markdown` for a results file, what is proven in its last column."""
    document = json.loads(results.read_text(encoding="utf-8"))
    proven = _proven(document, bounds)
    words, lines = {"policy": "proven", "---": "---", **proven}, []
    for line in markdown(rank_policies([results])).splitlines():
        cells = line.split(" | ")
        note = re.sub("Proven: .* All:", "All:", line)  # of the bounds that are stored, and not of files of --bound
        lines.append(f"{' | '.join(cells[:-2])} | {words[cells[1]]} |" if line.startswith("|") else note)
    made = f"`{document['command']}`, `{bounds['command']}`; {made_with(document, _tips(document, bounds))}"
    return "\n".join([*lines, "", _OF_THE_TIP.replace("docs/", "../"), "", made])


def plants_leaderboard(results: Path) -> str:
    """Return the output of `fuzzyarm leaderboard --markdown` for a sweep's file, without the column of sources."""
    lines = markdown(rank_sweeps([results])).splitlines()
    text = "\n".join(f"{line.rpartition(' | ')[0]} |" if line.startswith("|") else line for line in lines)
    document = json.loads(results.read_text(encoding="utf-8"))
    return f"{text}\n\n`{document['command']}`; {made_with(document)}"


def sweep_table(document: dict[str, Any]) -> str:
    """Return success and quantiles of the largest tip error, a row per policy and case."""
    headings = ["case", "policy", f"below {document['config']['bound']:g} mm [%]"]
    headings += [f"largest tip error, {q} % of plants [mm]" for q in (50, 99)]
    rows = [
        [
            CASES[row["case"]].title,
            row["policy"],
            _interval(row["success"], lambda value: f"{100 * value:.2f}"),
            *(_interval(row["max_mm"][key], lambda value: f"{value:#.3g}") for key in ("0.5", "0.99")),
        ]
        for case in CASES
        for row in document["rows"]
        if row["case"] == case
    ]
    return f"{table(headings, rows, left=2)}\n\nIntervals of 95 %. `{document['command']}`; {made_with(document)}"


def _interval(found: dict[str, float | None], text: Callable[[float], str]) -> str:
    """Return a value with its interval; words where there is no number."""
    value, low, high = (None if number is None else text(number) for number in found.values())
    if value is None:
        return "ended early"
    return value if low is None or high is None else f"{value} ({low} to {high})"


def speed_table(bench: dict[str, Any]) -> str:
    """Return the table of steps per second, and how it was measured."""
    headings = ["", "lanes", "threads", "numbers", "thousand steps/s", "tip error [µm]", "times as fast as"]
    rows = []
    for row in bench["rows"]:
        speed, error = row["steps_per_s"], row["tip_error_um"]
        peers = [f"{peer} {ratio['median']:.3g}" for peer, ratio in row["ratios"].items()]
        cells = [row["name"], str(row["lanes"]), str(row["threads"]), row["dtype"]]
        measured = "not measured" if speed is None else f"{1e-3 * speed['median']:.0f}"
        rows.append([*cells, measured, "" if error is None else f"{error:.2g}", ", ".join(peers)])
    method = bench["method"]
    missing = sorted({f"{row['name']}: {row['reason']}" for row in bench["rows"] if row["reason"]})
    return (
        f"{table(headings, rows)}\n\nMedians of {method['rounds']} rounds of {method['seconds']:g} s in which "
        f"everyone takes turns. {' '.join(f'Not measured: {line}.' for line in missing)} A further lane takes "
        f"{bench['memory_per_lane']['bytes']:.0f} bytes. `{bench['command']}`; {made_with(bench)}"
    )


def peer_line(mujoco: dict[str, Any]) -> str:
    """Return a sentence on the agreement of the two simulations where their friction models are the same."""
    frictionless, coulomb = mujoco["frictionless"], mujoco["Coulomb"]
    finest = min(row["tip_error_um"] for row in frictionless["mujoco"])
    return (
        "Against the event integrator, without friction / with Coulomb friction alone, our tip error is "
        f"{frictionless['our_tip_error_um']:.2f} / {coulomb['our_tip_error_um']:.2f} µm, and MuJoCo's goes down to "
        f"{finest:.1g} / {min(row['tip_error_um'] for row in coulomb['mujoco']):.2g} µm as its step shrinks "
        f"(`{mujoco['command']}`; {made_with(mujoco).removesuffix('.')})."
    )


def soak_line(soak: dict[str, Any]) -> str:
    """Return a sentence on the results of the soak test."""
    parts = []
    for row in soak["rows"]:
        memory = [value for value in row["resident_MB"] if value is not None]
        growth = memory[-1] - memory[len(memory) // 4] if memory else float("nan")
        parts.append(
            f"{row['actions']}: {row['env_steps']:.3g} env-steps, {row['episodes']} episodes, {row['seconds']:.0f} s, "
            f"memory {growth:+.1f} MB over the last three quarters"
        )
    return (
        f"Soak, without a number that is not finite: {'; '.join(parts)} (`python benchmarks/soak.py`; "
        f"{made_with(soak).removesuffix('.')})."
    )


def accuracy_table(document: dict[str, Any]) -> str:
    """Return the table of the largest tip error by case and sub-step."""
    differences = document["max_tip_difference_um"]
    steps = list(next(iter(differences.values())))
    headings = ["case", *(f"h = {1e3 * float(h):g} ms [µm]" for h in steps)]
    rows = [[case, *(f"{row[h]:.3f}" for h in steps)] for case, row in differences.items()]
    return f"{table(headings, rows)}\n\nThe default is h = 0.2 ms. `{document['command']}`; {made_with(document)}"
