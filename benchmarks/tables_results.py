"""Tables of evaluations, sweeps and learned policies, and the README's sections."""

from __future__ import annotations

import re
import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from measuring import RESULTS
from tables import Section, Table, made_with, markdown, title_of

from fuzzyarm.common.arithmetic import at_most
from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES
from fuzzyarm.eval.episodes.metrics import columns, millimetres
from fuzzyarm.eval.evaluation import ranking
from fuzzyarm.eval.evaluation.result_table import table_rows
from fuzzyarm.eval.sweep.ranking import rank_sweeps

__all__ = ["EVALUATIONS", "README", "on_the_circle", "tips"]

_OF_THE_TIP = (
    "[Proven](docs/theory/certificate.md), of the rigid arm: decay and L2 gain in a box; of the tip: a bound at every "
    "instant of the nominal case, on the elastic arm with sampled control, for every arm of a set. `near`: stiffness "
    "± 2 %, damping ± 10 %, masses ± 0.5 %, motor inertias ± 1 %, dry friction ± 20 %; any friction: any torque up to "
    "the static one; exact: the arm of Table 1 alone, known exactly."
)


def _evaluated(document: dict[str, Any]) -> str:
    """Return every metric of every policy and case."""
    rows = [(CASES[case].title, policy, *cells) for case, policy, cells in table_rows(document["results"])]
    return markdown(["case", "policy", *columns()], rows, left=2)


def _paper(document: dict[str, Any]) -> str:
    """Return a paragraph that compares the circularity of `fuzzy-4` with the numbers of the paper."""
    rows = {row["case"]: row for row in document["results"] if row["policy"] == "fuzzy-4"}
    form = "[{circularity_motor_min_mm:+.2f}, {circularity_motor_max_mm:+.2f}] mm in Case "
    ranges = (f"{form.format(**rows[case])}{k}" for k, case in enumerate(PAPER_CASES, start=1))
    return (
        f"`fuzzyarm evaluate`, 1 kHz, seed 0 (nothing is random in these cases); {made_with(document)}\n\n"
        "The paper reports circularity errors of 1.3 mm (Case 1) and -2.3 to 4.4 mm (Case 2) for its 4-rule "
        "controller, but not whether they are those of the motors or of the links. Computed from the motor angles, "
        "as if the joints "
        f"were rigid, the errors of `fuzzy-4` are {', '.join(ranges)}. They show how well the motors are controlled, "
        "not where the tip is."
    )


def _overview(document: dict[str, Any], bounds: dict[str, Any]) -> str:
    """Return the README's table: errors in the cases, with noise and over plants, and the bound for nearby arms."""
    near = {row["policy"]: row for row in on_the_circle(bounds) if row["set"] == "near"}
    rows = [
        [
            f"`{row['policy']}`",
            *(_of_seeds(row, case) for case in range(len(PAPER_CASES))),
            " / ".join(map(_two_figures, row["noisy_rms_mm"])),
            "lost" if row["plants_mm"] is None else _two_figures(row["plants_mm"]),
            f"{at_most(near[row['policy']]['bound_mm'], 2)} mm" if row["policy"] in near else "",
        ]
        for row in document["rows"]
    ]
    headings = [*(f"{case}" for case in PAPER_CASES), "with noise", "99 % of plants", "proven, nearby arms, for ever"]
    made = made_with(document, [near[row["policy"]] for row in document["rows"] if row["policy"] in near])
    return (
        f"{markdown(['tip error, rms [mm]', *headings], rows)}\n\n"
        "Noise: 10 µrad and 1 mrad/s on the encoders, in the three cases. 99 % of plants: in each of the three "
        "cases, the largest tip error of 99 % of random arms with random loads is at most this value. Learned: the "
        "shipped policy, and the range of five seeds. `paper-4`: the paper's Theorem 2 solved as printed; "
        "`paper-4-printed`: the gains that it prints. Proven: the [bound on the tip error](docs/theory/tip.md) for "
        "stiffness ± 2 %, damping ± 10 %, masses ± 0.5 %, motor inertias ± 1 %, dry friction ± 20 %, at every "
        "instant of the nominal case, repeated for ever. "
        f"`{document['command']}`, `{bounds['command']}`; {made}"
    )


def _of_seeds(row: dict[str, Any], case: int) -> str:
    """Return the rms error [mm] of a shipped policy in a case, with the range of its seeds if it has some."""
    own, seeds = _two_figures(row["rms_mm"][case]), [seed[case] for seed in row["rms_mm_of_seeds"]]
    low, high = (_two_figures(end(seeds)) for end in (min, max)) if seeds else (own, own)
    return own if low == high else f"{own} ({low} to {high})"


def _two_figures(value: float) -> str:
    return millimetres(value, lambda length: f"{length:#.2g}".rstrip("."))


def _proven(document: dict[str, Any], bounds: dict[str, Any]) -> dict[str, str]:
    """Return what is proven of each policy of an evaluation, of the rigid arm and of the tip, in a few words."""
    proven, shown = {}, tips(document, bounds)
    for policy, certificate in document["certificates"].items():
        nearby = []
        for row in shown.get(policy, []):
            words = {"any-friction": "any friction", "table-1": "exact"}.get(row["set"], row["set"])
            nearby.append(f"{at_most(row['bound_mm'], 2)} mm ({words})")
        parts = ["rigid arm"] * (certificate is not None) + [f"tip within {', '.join(nearby)}"] * bool(nearby)
        proven[policy] = "; ".join(parts) or "no"
    return proven


def tips(document: dict[str, Any], bounds: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Return the bounds of the tip that are shown for each policy of an evaluation.

    These are those for arms near that of Table 1 and for the widest range of payloads; where there are none, that for
    this arm alone, which is said.
    """
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for row in sorted(on_the_circle(bounds), key=lambda row: row["plants"]["payload"][1]):
        kind = "payload" if row["set"].startswith("payload") else row["set"]
        found.setdefault(row["policy"], {})[kind] = row
    return {
        policy: [of[kind] for kind in ("near", "any-friction", "payload") if kind in of] or [*of.values()][:1]
        for policy, of in found.items()
        if policy in document["certificates"]
    }


def on_the_circle(bounds: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the proven bounds of the paper's motion in the nominal case."""
    circle = {"case": "nominal", "path": "circle", "duration": 1.5, "proven": True}
    return [row for row in bounds["rows"] if {key: row[key] for key in circle} == circle]


def _speeds(bench: dict[str, Any]) -> str:
    """Return the README's line about speed, with the peers of the same run."""
    rows = {row["group"]: row for row in bench["rows"] if row["ratios"]}
    one, many = _speed(rows["one environment"], "Pendulum"), _speed(rows["1024 lanes"], "MuJoCo arm")
    return (
        f"**Speed**, control steps a second: {one[0]} with one arm ({one[1]} times Gymnasium's Pendulum), "
        f"{many[0]} with 1024 arms ({many[1]} times the same arm in MuJoCo at equal tip accuracy). Not "
        "compared: GPU simulators; the torch version has not been run on a GPU. "
        f"`{bench['command']}`; {made_with(bench)}"
    )


def _speed(row: dict[str, Any], peer: str) -> tuple[str, str]:
    """Return the speed of a row [control steps/s] in words, and its ratio to the speed of a peer."""
    speed = row["steps_per_s"]["median"]
    words = f"{1e-6 * speed:.1f} million" if speed >= 1e6 else f"{round(speed, -3):,.0f}"
    return words, f"{row['ratios'][peer]['median']:.3g}"


def _leaderboard(document: dict[str, Any], bounds: dict[str, Any]) -> str:
    """Return the output of `fuzzyarm leaderboard --markdown`, what is proven in its last column."""
    words, lines = {"policy": "proven", "---": "---", **_proven(document, bounds)}, []
    for line in ranking.markdown(ranking.rank_policies([RESULTS / "evaluate.json"])).splitlines():
        cells = line.split(" | ")
        note = re.sub("Proven: .* All:", "All:", line)  # of the bounds that are stored, and not of files of --bound
        lines.append(f"{' | '.join(cells[:-2])} | {words[cells[1]]} |" if line.startswith("|") else note)
    made = f"`{document['command']}`, `{bounds['command']}`; {made_with(document, tips(document, bounds))}"
    return "\n".join([*lines, "", _OF_THE_TIP.replace("docs/", "../"), "", made])


def _scores(document: dict[str, Any]) -> str:
    """Return the table of the held-out set, the best policy first."""
    rows = sorted(document["policies"].items(), key=lambda pair: -pair[1]["N"])
    headings = ["policy", "N", "rms [mm]: median", "90 %", "99 %", "torque rate [kN m/s]", "lost [%]"]
    cells = [
        [
            *(policy, f"{row['N']:.1f}", *(f"{value:.3g}" for value in row["rms_mm"].values())),
            *(f"{1e-3 * row['torque_rate']:.2g}", f"{row['lost_percent']:.1f}"),
        ]
        for policy, row in rows
    ]
    return markdown(headings, cells)


def _leaderboard_of_plants(document: dict[str, Any]) -> str:
    """Return the output of `fuzzyarm leaderboard --markdown` for a sweep, without the column of sources."""
    lines = ranking.markdown(rank_sweeps([RESULTS / "sweep.json"])).splitlines()
    return "\n".join(f"{line.rpartition(' | ')[0]} |" if line.startswith("|") else line for line in lines)


def _in_case(key: str) -> Callable[[Any], str]:
    return lambda row: " / ".join(millimetres(row[key][kind]) for kind in ("max_mm", "rms_mm"))


def _interval(found: Mapping[str, float | None], text: Callable[[float], str]) -> str:
    """Return a value with its interval; words where there is no number."""
    value, low, high = (None if number is None else text(number) for number in found.values())
    if value is None:
        return "ended early"
    return value if low is None or high is None else f"{value} ({low} to {high})"


def _swept(document: dict[str, Any]) -> list[dict[str, Any]]:
    return [row for case in CASES for row in document["rows"] if row["case"] == case]


def _quantile(key: str) -> Callable[[Any], str]:
    return lambda row: _interval(row["max_mm"][key], "{:#.3g}".format)


def _learned(document: dict[str, Any]) -> str:
    """Return a table of the largest errors, and one of the rms errors."""
    titles = {task["name"]: task["title"].removeprefix("Case 1, ").partition(":")[0] for task in document["tasks"]}
    cells = {(row["policy"], row["task"]): row for row in document["rows"]}
    policies, parts = list(dict.fromkeys(policy for policy, _ in cells)), []
    for key, heading in (("tip_error_max_mm", "largest tip error [mm]"), ("tip_error_rms_mm", "rms tip error [mm]")):
        rows = [[name, *(_learned_cell(cells[name, task], key) for task in titles)] for name in policies]
        parts.append(markdown([heading, *titles.values()], rows))
    return "\n\n".join(parts)


def _learned_cell(row: dict[str, Any], key: str) -> str:
    """Return an error [mm] with its interval if it has one, and how many seeds failed if any did."""
    failed = [f"{row['failed']} of {row['episodes']} failed"] if row["failed"] else []
    return ", ".join([*([] if row[key] is None else [_interval(row[key], _two_figures)]), *failed])


def _of_learned(document: dict[str, Any]) -> str:
    method = document["method"]
    return (
        "Beside the cases other circles and an eight, without load. Of learned policies the interquartile mean over "
        f"the seeds with its {100 * method['interval']['level']:.0f} % bootstrap interval, without those that failed: "
        f"{method['failed']['rule'].partition(';')[0]}. `{document['command']}`; {made_with(document)}"
    )


def _median(key: str, form: str) -> Callable[[Any], str]:
    """Return the cell of the median over the seeds and their range; a dash if a value is missing."""

    def text(one: Mapping[str, Any]) -> str:
        values: Sequence[float | None] = [run[key] for run in one["runs"]]
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            return "-"
        middle, low, high = (format(found, form) for found in (statistics.median(known), min(known), max(known)))
        return f"{middle} ({low} to {high})"

    return text


README = {
    "results": Section(("overview", "tip_bound"), _overview, None),
    "speed": Section("bench", _speeds, None),
}
"""Sections of the README by name."""

EVALUATIONS = {
    "results": Section("evaluate", (_evaluated, _paper), None),
    "leaderboard": Section(("evaluate", "tip_bound"), _leaderboard, None),
    "score": Section("score", _scores),
    "leaderboard-plants": Section("sweep", _leaderboard_of_plants),
    "tip": Section(
        "tip_feedforward",
        Table(
            lambda document: {
                "law": "{law}",
                "variant": "{variant}",
                "Case 1: max / rms [mm]": _in_case("nominal"),
                "Case 2: max / rms [mm]": _in_case("machining"),
                "Case 3: max / rms [mm]": _in_case("payload"),
                f"Case 1, stiffness {100 * document['wrong']:.0f} % off: max / rms [mm]": _in_case("stiffness_wrong"),
            },
            left=2,
        ),
    ),
    "sweep": Section(
        "sweep",
        Table(
            lambda document: {
                "case": title_of,
                "policy": "{policy}",
                f"below {document['config']['bound']:g} mm [%]": lambda row: _interval(
                    row["success"], lambda value: f"{100 * value:.2f}"
                ),
                "largest tip error, 50 % of plants [mm]": _quantile("0.5"),
                "largest tip error, 99 % of plants [mm]": _quantile("0.99"),
            },
            _swept,
            left=2,
        ),
        "Intervals of 95 %. `{command}`",
    ),
    "learned": Section(
        "learned_comparison",
        (
            _learned,
            _of_learned,
            Table(
                {
                    "learned policy": "{name}",
                    "seeds": lambda one: ", ".join(str(run["seed"]) for run in one["runs"]),
                    "median seed": "{median_seed}",
                    "steps of a seed": lambda one: ", ".join(
                        f"{count:,}" for count in sorted({run["steps"] for run in one["runs"]})
                    ),
                    "wall time of a seed [s]": _median("wall_time_s", ".0f"),
                    "processor time [s]": _median("cpu_time_s", ".0f"),
                    "last tenth / tenth before": _median("plateau", ".2f"),
                },
                "learned",
            ),
        ),
        None,
    ),
}
"""Sections by name."""
