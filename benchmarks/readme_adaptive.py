"""The tables of the page of the adaptive observer, from stored results."""

from __future__ import annotations

import math
from typing import Any

from readme_markdown import made_with, table

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = [
    "adaptive_cases_table",
    "adaptive_constants_table",
    "adaptive_front_table",
    "adaptive_margins_table",
    "adaptive_noise_table",
    "adaptive_passes_table",
    "adaptive_plants_table",
    "adaptive_robot_constants_table",
    "adaptive_robot_table",
    "adaptive_second_plant_table",
    "adaptive_start_table",
    "adaptive_swing_table",
]

_CAP = 50.0  # mm, of documents that do not say it


NO_DOUBT = 1e-6
"""Doubt of the shared factor that stands for none: a weight is above zero."""


def adaptive_cases_table(document: dict[str, Any]) -> str:
    """Return the tip errors of the paper's cases, without and with noise."""
    headings = ["case", "noise", "max [mm]", "max but for 0.1 s at the ends [mm]", "rms [mm]"]
    names = "tip_error_max_mm", "tip_error_max_mid_mm", "tip_error_rms_mm"
    rows = [
        [CASES[row["case"]].title, "yes" if row["noise"] else "no", *(_text(row[name]) for name in names)]
        for row in document["cases"]
    ]
    return f"{table(headings, rows, left=2)}\n\nNoise: 1e-5 rad, 1e-3 rad/s. {_made(document)}"


def adaptive_passes_table(document: dict[str, Any]) -> str:
    """Return the largest error of each pass, of the case's own arm and of random plants."""
    count = len(document["passes"][0]["max_mm"])
    headings = ["largest tip error [mm], pass", *map(str, range(1, count + 1))]
    rows = [
        [f"{row['policy']}, {CASES[row['case']].title}", *(_text(error) for error in row["max_mm"])]
        for row in document["passes"]
    ]
    for row in document["passes_of_plants"]:
        errors = [_text(error) for error in row["quantile_99_mm"]]
        name = f"adaptive-observer, 99 % of {row['plants']} plants, {CASES[row['case']].title}"
        rows.append([name, *errors, *[""] * (count - len(errors))])
    grown = "; ".join(
        f"{', '.join(map(str, row['larger_than_before']))} in {CASES[row['case']].title}"
        for row in document["passes_of_plants"]
    )
    return (
        f"{table(headings, rows)}\n\nRandom plants whose largest error grew by more than 0.05 mm from one pass to the "
        f"next, pass after pass: {grown}. {_made(document)}"
    )


def adaptive_plants_table(document: dict[str, Any], sweeps: list[dict[str, Any]]) -> str:
    """Return what happens to held-out plants; `sweeps` by their documents."""
    headings = ["plants", "case", "number", "median [mm]", "99 % [mm]", "worst [mm]", "beyond 15 mm"]
    rows, commands, far = [], [], document["lost_mm"]
    headings.append(f"beyond {far:g} mm")
    for sweep in sweeps:
        commands.append(f"`{sweep['command']}`")
        for row in sweep["rows"]:
            if row["policy"] == "adaptive-observer":
                cells = [_text(row["max_mm"][key]["value"]) for key in ("0.5", "0.99")]
                cells += [_text(max(plant["max_mm"] for plant in row["worst"])), _beyond(row, 15.0), _beyond(row, far)]
                config = sweep["config"]
                rows.append([f"`{config['distribution']}`", CASES[row["case"]].title, str(config["plants"]), *cells])
    for row in document["populations"]:
        cells = [_text(row[key]) for key in ("median_mm", "quantile_99_mm", "worst_mm")]
        rows.append([row["what"], CASES[row["case"]].title, str(row["plants"]), *cells, "", str(row["lost"])])
    return (
        f"{table(headings, rows, left=2)}\n\nLargest tip error of each plant; {', '.join(commands)}; the others have "
        f"seed {document['seed']}. Beyond: the episode ended early or the tip was once that far off; lower rows show "
        f"what is beyond {far:g} mm as {far:g}. `{document['command']}`; {made_with(document, *sweeps)}"
    )


def _beyond(row: dict[str, Any], bound: float) -> str:
    """Return how many episodes of a sweep's row ended early or erred by more than a bound [mm].

    The row lists its worst episodes, which is all of them unless every one that it lists is beyond.
    """
    listed = [plant for plant in row["worst"] if not plant["completed"] or plant["max_mm"] > bound]
    if len(listed) == len(row["worst"]):
        return f"{max(len(listed), row['ended_early'])} or more"
    return str(len(listed))


def adaptive_margins_table(document: dict[str, Any]) -> str:
    """Return when plants end early or are far off, and the margins of the frozen loop."""
    beyond, first = f"beyond {document.get('lost_mm', _CAP):g} mm", document["adapting"][0]
    headings = ["", *(f"{beyond}, of {first['of']}, {case}" for case in first["lost"])]
    words = {"late": "late by {:g} ms", "torque": "torque x {:g}", "noise": "noise x {:g}"}
    rows = [[words[row["what"]].format(row["value"]), *map(str, row["lost"].values())] for row in document["adapting"]]
    frozen = document["frozen"]
    return (
        f"{table(headings, rows)}\n\nFrozen loop: spectral radius {frozen['radius']:.3f}; stable for a loop gain of "
        f"{_stable_gains(frozen)}; radius {frozen['radius_gain_0.8']:.2f} at 0.8, {frozen['radius_gain_1.25']:.2f} at "
        f"1.25, {frozen['radius_half_a_sample_later']:.2f} half a sample later. {_made(document)}"
    )


def adaptive_front_table(document: dict[str, Any]) -> str:
    """Return the front between error and margins: slower and slower weights."""
    first = document["front"][0]
    conditions = ", ".join(_condition(hard) for hard in first["adapting"])
    groups = [f"{group} arms [mm]" for group in first["mean_largest_error_mm"]]
    cases = [f"{CASES[case].title.partition(':')[0]}: max / rms [mm]" for case in first["cases"]]
    headings = ["slower", "gains of a stable frozen loop", *groups, *cases, f"beyond: {conditions}"]
    rows = []
    for row in document["front"]:
        gains = _stable_gains(row["frozen"])
        errors = [f"{error:.2f}" for error in row["mean_largest_error_mm"].values()]
        errors += [f"{case['max_mm']:.2f} / {case['rms_mm']:.2f}" for case in row["cases"].values()]
        beyond = ", ".join(str(hard["lost"]) for hard in row["adapting"])
        rows.append([f"× {row['slower']:g}", gains, *errors, beyond])
    episodes = len(document["adapting"][0]["lost"]) * document["adapting"][0]["of"]
    beyond = f"Beyond {document.get('lost_mm', _CAP):g} mm or ended early, of {episodes} episodes with each"
    return f"{table(headings, rows)}\n\n{beyond}. {_made(document)}"


def _stable_gains(frozen: dict[str, Any]) -> str:
    """Return the range of loop gains at which a frozen loop is stable, rounded inwards."""
    low, high = frozen["gain"]
    if low is None or high is None:
        return "none"
    return f"{math.ceil(100 * low) / 100:g} to {math.floor(100 * high) / 100:g}"


def _condition(hard: dict[str, Any]) -> str:
    """Return in words what makes plants hard."""
    return f"late by {hard['late']} ms" if "late" in hard else f"torque x {hard['torque']:g}"


def adaptive_constants_table(document: dict[str, Any]) -> str:
    """Return the objective, and the error by noise in Case 1, with each constant halved, as it is, and doubled."""
    shipped, by_name = document["shipped"], dict[str, list[dict[str, Any]]]()
    for row in document["variants"]:
        by_name.setdefault(row["constant"], []).append(row)
    headings = ["constant", "shipped", "objective: half [mm]", "shipped [mm]", "double [mm]"]
    headings += ["Case 1 with noise: half [mm]", "shipped [mm]", "double [mm]"]
    rows = []
    for name, (half, double) in by_name.items():
        found = half, shipped, double
        value = f"{half['value'] / half['factor']:g}"
        numbers = [f"{row[key]:{digits}}" for key, digits in _OF_CONSTANTS.items() for row in found]
        rows.append([f"`{name}`", value, *numbers])
    measured = [shipped, *document["variants"]]
    beyond = sum(group["lost"] for row in measured for group in row["groups"].values())
    arms = len(shipped["groups"]) * document["arms"]
    return (
        f"{table(headings, rows)}\n\nOver {arms} arms from seed {document['seed']} on; {beyond} of "
        f"{len(measured) * arms:,} episodes were beyond {_CAP:g} mm or ended early. {_made(document)}"
    )


def adaptive_robot_constants_table(document: dict[str, Any]) -> str:
    """Return what random courses and loads on robots say of their two own numbers."""
    rows = []
    for number, pair in enumerate(document["pairs"]):
        found = [robot[number] for robot in document["robots"].values()]
        cells = [
            f"{row['objective_mm']:.2f} ({row['mean_mm']['without noise'][0]:.2f}, {row['worst_mm']:.1f})"
            for row in found
        ]
        rows.append([f"{100.0 * pair['share']:g} %", f"{pair['c']:g}", *cells, f"{pair['objective']:.3f}"])
    headings = ["largest share of a sample", "c", *document["robots"], "mean over the robots, each in its smallest"]
    return (
        f"{table(headings, rows)}\n\nOf each robot the objective (mean without noise in the first pass, worst of all) "
        f"[mm], over {document['courses']} courses from seed {document['seed']} on. {_made(document)}"
    )


_OF_CONSTANTS = {"objective_mm": ".2f", "noisy_nominal_mm": ".3f"}


def adaptive_noise_table(document: dict[str, Any]) -> str:
    """Return what encoder noise does with some of the beliefs fixed, and what the worst plants have in common."""
    headings = ["fixed", "max, mean of episodes [mm]", "max [mm]", "rms [mm]"]
    names = "max_mean_mm", "max_mm", "rms_mm"
    rows = [[row["fixed"].replace("_", " "), *(_text(row[name]) for name in names)] for row in document["beliefs"]]
    words = "; ".join(
        f"{row['group']} ({row['plants']}): median of the largest tip error {_text(row['median_max_mm'])} mm, "
        f"{100 * row['late']:.0f} % late, noise read beyond that of the encoders {row['read_beyond_noise_rad']:.1g} rad"
        for row in document["plants"]
    )
    return (
        f"{table(headings, rows)}\n\nPlants of `all` without force, by their largest errors: {words}. {_made(document)}"
    )


def adaptive_robot_table(document: dict[str, Any]) -> str:
    """Return the errors on a robot: of the cases, without and with noise, and of random plants."""
    headings = ["case", "policy", "max / rms [mm]", "with noise [mm]", "plants: median / worst [mm]"]
    headings.append(f"ended early or beyond {document['lost_mm']:g} mm")
    rows = []
    for plant in document["plants"]:
        own = {
            row["noise"]: f"{_text(row['tip_error_max_mm'])} / {_text(row['tip_error_rms_mm'])}"
            for row in document["cases"]
            if (row["policy"], row["case"]) == (plant["policy"], plant["case"])
        }
        spread = f"{_text(plant['median_mm'])} / {_text(plant['worst_mm'])}"
        lost = f"{plant['lost']} of {plant['plants']}"
        title = CASES[plant["case"]].title.replace(": 5 kg payload", ": payload")
        rows.append([title, plant["policy"], own[False], own[True], spread, lost])
    return (
        f"{table(headings, rows, left=2)}\n\n`{document['robot']}`; noise: 1e-5 rad, 1e-3 rad/s; plants: masses, "
        f"rotors, stiffness, damping and friction drawn around the robot. {_made(document)}"
    )


def adaptive_second_plant_table(document: dict[str, Any]) -> str:
    """Return the tip errors on the second plant, each beside that in the simulator."""
    names = {"max_mm": "max [mm]", "max_but_ends_mm": "max but for 0.1 s at the ends [mm]", "rms_mm": "rms [mm]"}
    headings = ["case", "policy", *(f"{name}: second plant / simulator" for name in names.values())]
    rows = []
    for case in dict.fromkeys(row["case"] for row in document["rows"]):
        for row in document["rows"]:
            if row["case"] == case:
                errors = [f"{_text(row['plant'][name])} / {_text(row['simulator'][name])}" for name in names]
                rows.append([CASES[case].title, row["policy"], *errors])
    return (
        f"{table(headings, rows, left=2)}\n\nRunge-Kutta steps of {1e6 * document['step_s']:g} µs, dry friction "
        f"smoothed by tanh(v/{document['smoothing_rad_s']:g} rad/s). {_made(document)}"
    )


def adaptive_start_table(document: dict[str, Any]) -> str:
    """Return what the best ways to begin an episode reach, of those that were measured again, the best one first."""
    headings = [
        *("first gain", "for [ms]", "doubt", "known arm, mean [mm]"),
        *(
            "strong motors: mean [mm]",
            f"ended early or beyond {_CAP:g} mm",
            "late: mean [mm]",
            "worst [mm]",
            "objective [mm]",
        ),
    ]
    rows = []
    for row in document["last"]:
        weights, groups = row["weights"], row["groups"]
        known, strong, late = groups["known"], groups["strong"], groups["late"]
        rows.append(
            [
                f"{weights['first_gain']:g}",
                f"{1e3 * weights['soft_start']:g}" if weights["first_gain"] < 1.0 else "",
                f"{weights['scale_doubt']:.2g}" if weights["scale_doubt"] > NO_DOUBT else "none",
                *(f"{known['mean_mm']:.2f}", f"{strong['mean_mm']:.2f}", str(strong["lost"])),
                *(f"{late['mean_mm']:.2f}", f"{late['worst_mm']:.1f}", f"{row['objective_mm']:.1f}"),
            ]
        )
    return f"{table(headings, rows)}\n\nOf 1,500 plants each but for the known arm. {_made(document)}"


def adaptive_swing_table(document: dict[str, Any]) -> str:
    """Return what each largest swing of the commands reaches."""
    groups = list(document["variants"][0]["groups"])
    headings = ["largest swing", *(f"{group}: mean, worst [mm]" for group in groups), "objective [mm]"]
    rows = []
    for row in document["variants"]:
        largest = row["largest_swing"]
        errors = [f"{group['mean_mm']:.2f}, {group['worst_mm']:.1f}" for group in row["groups"].values()]
        # The mean of what lies between 0 and 2 is below 2.
        rows.append([f"{largest:g}" if largest < 2.0 else "none", *errors, f"{row['objective_mm']:.2f}"])
    arms = (
        f"{document['arms']} known arms, as many unknown ones, {document['plants']} strong ones and as many late ones"
    )
    cap = f"An error beyond {_CAP:g} mm, and an episode that ends early, count as {_CAP:g} mm"
    return f"{table(headings, rows)}\n\n{arms}. {cap}. {_made(document)}"


def _text(value: float | None) -> str:
    """Return two significant digits, without an exponent."""
    return (
        "ended early"
        if value is None
        else f"{float(f'{value:.2g}'):g}"
        if value >= 10.0
        else millimetres(value, "{:#.2g}".format)
    )


def _made(document: dict[str, Any]) -> str:
    return f"`{document['command']}`; {made_with(document)}"
