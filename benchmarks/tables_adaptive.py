"""Tables of the adaptive observer and of arms that were tuned."""

from __future__ import annotations

from typing import Any

from tables import Cell, Section, Table, markdown, mm, title_of

from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = ["ADAPTIVE"]


def _text(value: float | None) -> str:
    """Return two significant digits, without an exponent."""
    if value is None:
        return "ended early"
    return f"{float(f'{value:.2g}'):g}" if value >= 10.0 else millimetres(value, "{:#.2g}".format)


def _mm(*keys: str) -> Cell:
    return lambda row: " / ".join(_text(row[key]) for key in keys)


def _passes(document: dict[str, Any]) -> str:
    """Return the largest error of each pass, of the case's own arm and of random plants."""
    count = len(document["passes"][0]["max_mm"])
    rows = [[f"{row['policy']}, {title_of(row)}", *map(_text, row["max_mm"])] for row in document["passes"]]
    for row in document["passes_of_plants"]:
        errors = [_text(error) for error in row["quantile_99_mm"]]
        name = f"adaptive-observer, 99 % of {row['plants']} plants, {title_of(row)}"
        rows.append([name, *errors, *[""] * (count - len(errors))])
    return markdown(["largest tip error [mm], pass", *map(str, range(1, count + 1))], rows)


def _grown(document: dict[str, Any]) -> str:
    grown = "; ".join(
        f"{', '.join(map(str, row['larger_than_before']))} in {title_of(row)}" for row in document["passes_of_plants"]
    )
    return (
        "Random plants whose largest error grew by more than 0.05 mm from one pass to the next, pass after pass: "
        f"{grown}. `{document['command']}`"
    )


def _plants(document: dict[str, Any], *sweeps: dict[str, Any]) -> str:
    """Return what happens to held-out plants: those of sweeps, then other populations."""
    far, rows = document["lost_mm"], []
    for sweep in sweeps:
        for row in sweep["rows"]:
            if row["policy"] == "adaptive-observer":
                cells = [_text(row["max_mm"][key]["value"]) for key in ("0.5", "0.99")]
                cells += [_text(max(plant["max_mm"] for plant in row["worst"])), _beyond(row, 15.0), _beyond(row, far)]
                config = sweep["config"]
                rows.append([f"`{config['distribution']}`", title_of(row), str(config["plants"]), *cells])
    for row in document["populations"]:
        cells = [_text(row[key]) for key in ("median_mm", "quantile_99_mm", "worst_mm")]
        rows.append([row["what"], title_of(row), str(row["plants"]), *cells, "", str(row["lost"])])
    headings = ["plants", "case", "number", "median [mm]", "99 % [mm]", "worst [mm]", "beyond 15 mm"]
    return markdown([*headings, f"beyond {far:g} mm"], rows, left=2)


def _beyond(row: dict[str, Any], bound: float) -> str:
    """Return how many episodes of a sweep's row ended early or erred by more than a bound [mm].

    The row lists its worst episodes, which is all of them unless every one that it lists is beyond.
    """
    listed = [plant for plant in row["worst"] if not plant["completed"] or plant["max_mm"] > bound]
    if len(listed) == len(row["worst"]):
        return f"{max(len(listed), row['ended_early'])} or more"
    return str(len(listed))


def _of_plants(document: dict[str, Any], *sweeps: dict[str, Any]) -> str:
    far, commands = document["lost_mm"], ", ".join(f"`{sweep['command']}`" for sweep in sweeps)
    return (
        f"Largest tip error of each plant; {commands}; the other rows have seed {document['seed']}. *Beyond*: the "
        "episode ended early, or the tip error exceeded that value at some instant; the lower rows are cut off at "
        f"{far:g} mm. "
        f"`{document['command']}`"
    )


def _robot(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of the plants, each with the errors of its case without and with noise."""
    own = {(row["policy"], row["case"], row["noise"]): row for row in document["cases"]}
    return [
        {**row, "own": [own[row["policy"], row["case"], noise] for noise in (False, True)]}
        for row in document["plants"]
    ]


_errors = _mm("tip_error_max_mm", "tip_error_rms_mm")


def _tuned(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return for each arm and policy its spectral radii and the results of its cases."""
    return [
        {"arm": row["arm"], "policy": policy, "radii": radii}
        | {one["case"]: one for one in row["results"] if one["policy"] == policy}
        for row in document["rows"]
        for policy, radii in row["spectral_radius"].items()
    ]


def _largest_radius(row: dict[str, Any]) -> str:
    radii = row["radii"].values()
    unstable = sum(radius is None or radius >= 1.0 for radius in radii)
    return f"unstable in {unstable} of {len(radii)}" if unstable else f"{max(radii):.4f}"


def _in_case(case: str) -> Cell:
    return lambda row: mm("tip_error_max_mm", ".3g")(row[case]) if row[case]["completed"] else "ended early"


ADAPTIVE = {
    "adaptive-cases": Section(
        "adaptive_cases",
        Table(
            {
                "case": title_of,
                "noise": lambda row: "yes" if row["noise"] else "no",
                "max [mm]": _mm("tip_error_max_mm"),
                "max but for 0.1 s at the ends [mm]": _mm("tip_error_max_mid_mm"),
                "rms [mm]": _mm("tip_error_rms_mm"),
            },
            "cases",
            left=2,
        ),
        "Noise: 1e-5 rad, 1e-3 rad/s. `{command}`",
    ),
    "adaptive-passes": Section("adaptive_cases", _passes, _grown),
    "adaptive-plants": Section(("adaptive_cases", "sweep", "adaptive_all"), _plants, _of_plants),
    "adaptive-robot": Section(
        "adaptive_robot_ur5",
        Table(
            lambda document: {
                "case": lambda row: title_of(row).replace(": 5 kg payload", ": payload"),
                "policy": "{policy}",
                "max / rms [mm]": lambda row: _errors(row["own"][0]),
                "with noise [mm]": lambda row: _errors(row["own"][1]),
                "plants: median / worst [mm]": _mm("median_mm", "worst_mm"),
                f"ended early or beyond {document['lost_mm']:g} mm": "{lost} of {plants}",
            },
            _robot,
            left=2,
        ),
        "`{robot}`; noise: 1e-5 rad, 1e-3 rad/s; plants: masses, rotors, stiffness, damping and friction drawn around "
        "the robot. `{command}`",
    ),
    "own-arms": Section(
        "own_arms",
        Table(
            lambda document: {
                "arm": "{arm}",
                "policy": "{policy}",
                "largest spectral radius of the conditions": _largest_radius,
                **{f"tip error max, {case} [mm]": _in_case(case) for case in document["rows"][0]["titles"]},
            },
            _tuned,
            left=2,
        ),
    ),
}
"""Sections by name."""
