"""The tables of the page of the adaptive observer, from stored results."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

from fuzzyarm.envs.scenario.cases import CASES

__all__ = [
    "adaptive_cases_table",
    "adaptive_margins_table",
    "adaptive_noise_table",
    "adaptive_passes_table",
    "adaptive_plants_table",
    "adaptive_robot_table",
    "adaptive_second_plant_table",
    "adaptive_start_table",
]


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


def adaptive_plants_table(document: dict[str, Any], sweeps: dict[str, dict[str, Any]]) -> str:
    """Return what happens to held-out plants; `sweeps` by distribution."""
    headings = ["plants", "case", "number", "median [mm]", "99 % [mm]", "worst [mm]", "lost"]
    rows, commands = [], []
    for name, sweep in sweeps.items():
        commands.append(f"`{sweep['command']}`")
        for row in sweep["rows"]:
            cells = [_text(row["max_mm"][key]["value"]) for key in ("0.5", "0.99")]
            cells += [_text(max(plant["max_mm"] for plant in row["worst"])), str(row["ended_early"])]
            rows.append([f"`{name}`", CASES[row["case"]].title, str(sweep["config"]["plants"]), *cells])
    for row in document["populations"]:
        cells = [_text(row[key]) for key in ("median_mm", "quantile_99_mm", "worst_mm")]
        rows.append([row["what"], CASES[row["case"]].title, str(row["plants"]), *cells, str(row["lost"])])
    return (
        f"{table(headings, rows, left=2)}\n\nLargest tip error of each plant; {', '.join(commands)}; the others have "
        f"seed {document['seed']}. Lost: the episode ended early, or, in the lower rows, the tip was once more than "
        f"{document['lost_mm']:g} mm off, which stands there as {document['lost_mm']:g}. {_made(document)}"
    )


def adaptive_margins_table(document: dict[str, Any]) -> str:
    """Return when plants are lost, and the margins of the frozen loop."""
    headings = ["", *(f"lost of {document['adapting'][0]['of']}, {case}" for case in document["adapting"][0]["lost"])]
    words = {"late": "late by {:g} ms", "torque": "torque x {:g}", "noise": "noise x {:g}"}
    rows = [[words[row["what"]].format(row["value"]), *map(str, row["lost"].values())] for row in document["adapting"]]
    frozen = document["frozen"]
    low, high = (f"{limit:.2f}" if limit is not None else "none" for limit in frozen["gain"])
    return (
        f"{table(headings, rows)}\n\nFrozen loop: spectral radius {frozen['radius']:.3f}; stable for a loop gain of "
        f"{low} to {high}; radius {frozen['radius_gain_0.8']:.2f} at 0.8, {frozen['radius_gain_1.25']:.2f} at 1.25, "
        f"{frozen['radius_half_a_sample_later']:.2f} half a sample later. {_made(document)}"
    )


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
    headings = ["case", "policy", "max / rms [mm]", "with noise [mm]", "plants: median / worst [mm]", "lost"]
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
        *("strong motors: mean [mm]", "lost", "late: mean [mm]", "worst [mm]", "objective [mm]"),
    ]
    rows = []
    for row in document["last"]:
        weights, groups = row["weights"], row["groups"]
        known, strong, late = groups["known"], groups["strong"], groups["late"]
        rows.append(
            [
                f"{weights['first_gain']:g}",
                f"{1e3 * weights['soft_start']:g}" if weights["first_gain"] < 1.0 else "",
                f"{weights['scale_doubt']:.2g}",
                *(f"{known['mean_mm']:.2f}", f"{strong['mean_mm']:.2f}", str(strong["lost"])),
                *(f"{late['mean_mm']:.2f}", f"{late['worst_mm']:.1f}", f"{row['objective_mm']:.1f}"),
            ]
        )
    return f"{table(headings, rows)}\n\nOf 1,500 plants each but for the known arm. {_made(document)}"


def _text(value: float | None) -> str:
    return "ended early" if value is None else f"{value:#.2g}".removesuffix(".")


def _made(document: dict[str, Any]) -> str:
    return f"`{document['command']}`; {made_with(document)}"
