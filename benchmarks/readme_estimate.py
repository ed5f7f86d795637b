"""The tables of the learned estimate: errors and margins of the seeds, plants, what the parts give, and the front."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = [
    "estimate_front",
    "estimate_parts",
    "estimate_pushes",
    "estimate_robot",
    "estimate_seeds",
    "estimate_sweeps",
    "estimate_tables",
]

_CASES = {"nominal": "Case 1", "machining": "Case 2", "payload": "Case 3"}


def estimate_tables(document: dict[str, Any]) -> str:
    """Return the table of the seeds, those of the plants, and the line that says how they were made."""
    plants = "\n\n".join(
        f"Largest tip errors [mm] over {part['plants']} plants of `{name}`:\n\n{_plants(part, document['quantiles'])}"
        for name, part in document["held_out"].items()
    )
    stable = document["stable_in_every_condition"]
    return (
        f"{_seeds(document)}\n\nShipped: seed {document['median']}. Stable in every condition: "
        f"{', '.join(map(str, stable)) or 'none'} of the five.\n\n{plants}\n\n"
        f"`python benchmarks/learned_observer.py`, trained by `fuzzyarm train estimate --seed 0` to `4` on the same "
        f"machine, shared with other work; plants from seed {document['first_held_out_seed']} on; {made_with(document)}"
    )


def estimate_seeds(document: dict[str, Any]) -> str:
    """Return the largest tip errors of every seed over plants, with how many percentiles are below the observer's."""
    headings = ["plants", "case", "policy", *_shares(document["quantiles"]), "ended early"]
    headings += ["percentiles below `elastic-observer`, of 99"]
    plants = document["plants"]
    rows = [
        [
            f"{plants[name]:,} of `{name}`",
            _CASES[case],
            _named(policy),
            *map(_error, found[case]["quantiles_mm"]),
            str(found[case]["lost"]),
            "" if policy.endswith("observer") else str(found[case]["percentiles_below_elastic"]),
        ]
        for name, part in document["held_out"].items()
        for case in _CASES
        for policy, found in part.items()
    ]
    command = "python benchmarks/estimate_seeds.py benchmarks/estimates/seed-*"
    options = " ".join(f"--{name} {count}" for name, count in plants.items())
    return (
        f"{table(headings, rows, left=3)}\n\nLargest tip errors [mm] over the first of these plants, from seed "
        f"{document['first_held_out_seed']} on, the same for all. `{command} {options} --pushed "
        f"{document['pushed']['plants']}`; {made_with(document)}"
    )


def estimate_pushes(document: dict[str, Any]) -> str:
    """Return the table of constant pushes and forces across the motion, and that of other courses under the loads."""
    part, quantiles = document["pushed"], document["quantiles"]
    pushes = [
        [kind, _named(name), *map(_error, row["quantiles_mm"]), str(row["lost"])]
        for kind, by_policy in part["kinds"].items()
        for name, row in by_policy.items()
    ]
    policies = document["courses"]
    courses = [
        [
            row["title"].removeprefix("Case 1, "),
            _CASES[key.partition(", ")[2]],
            *(f"{_error(found[key]['rms_mm'], 3)} / {_error(found[key]['largest_mm'])}" for found in policies.values()),
        ]
        for key, row in next(iter(policies.values())).items()
    ]
    return (
        f"{table(['force', 'policy', *_shares(quantiles), 'ended early'], pushes, left=2)}\n\n"
        f"Largest tip errors [mm] over the first {part['plants']} of the plants of `loads`: pushes from 0.3 to 0.9 s "
        f"in four directions, and forces to the left and to the right of the motion, of {part['size_N']:g} N times the "
        f"plant's factor, 0.5 to 1.5.\n\n{table(['course', 'case', *map(_named, policies)], courses, left=2)}\n\n"
        f"Tip errors of the known arm, rms / largest [mm]. `python benchmarks/estimate_seeds.py` as above; "
        f"{made_with(document)}"
    )


def estimate_front(document: dict[str, Any]) -> str:
    """Return the table of the shares of the network: accuracy, calm of the torques, and failures by condition."""
    late, factors = ({row[key]: None for row in _first(document)} for key in ("late", "factor"))
    headings = ["share of the network", "largest tip error [mm]", "rms tip error [mm]"]
    headings += [f"torque rate [N m/ms], {'on time' if not value else _late(value)}" for value in (0.0, 0.5, 1.0)]
    headings += [f"failed, {_late(value)}" for value in late if value]
    headings += [f"failed, torques × {value:g}" for value in factors if value != 1.0]
    headings += ["two plants of `all` [mm]"]
    rows = []
    for name, found in document["policies"].items():
        on_time = [row for row in found if not row["late"] and row["factor"] == 1.0]
        rows.append(
            [
                _named(name),
                *(" / ".join(f"{row[key][0]:.{digits}f}" for row in on_time) for key, digits in _ACCURACY),
                *(
                    " / ".join(
                        f"{row['torque_rate']:.1f}"
                        for row in found
                        if row["late"] == value and row["factor"] == 1.0 and row["case"] != "nominal"
                    )
                    for value in (0.0, 0.5, 1.0)
                ),
                *(_failed(found, "late", value) for value in late if value),
                *(_failed(found, "factor", value) for value in factors if value != 1.0),
                " / ".join(_error(value, 1) for value in document["tail"]["largest_mm"][name]),
            ]
        )
    plants = document["plants"]
    return (
        f"{table(headings, rows)}\n\nMedians over {plants} development plants of `loads`, from seed "
        f"{document['first_plant_seed']} on, in Cases 1, 2 and 3, and rates in Cases 2 and 3; how many of {2 * plants} "
        f"episodes of Cases 2 and 3 end early or err by more than {document['failed_above_mm']:g} mm; largest tip "
        f"errors in Case 1 on plants {' and '.join(map(str, document['tail']['plants']))} of the sweep of `all` above. "
        f"`python benchmarks/estimate_front.py`; {made_with(document)}"
    )


_ACCURACY = (("largest_mm", 2), ("rms_mm", 3))


def _first(document: dict[str, Any]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = next(iter(document["policies"].values()))
    return rows


def _late(samples: float) -> str:
    return "half a sample late" if samples == 0.5 else f"{samples:g} sample{'s' * (samples != 1.0)} late"


def _failed(rows: list[dict[str, Any]], key: str, value: float) -> str:
    return str(sum(row["failed"] for row in rows if row[key] == value))


def estimate_robot(document: dict[str, Any]) -> str:
    """Return the tables of a robot: the cases of each seed below the laws that it joins, and plants."""
    conditions = list(document["seeds"][0]["margins"]["spectral_radius"])
    headings = ["policy", "seed", *(f"{name}, rms / max [mm]" for name in _CASES.values())]
    headings += ["largest radius in all conditions", "processor time [s]"]
    rows = [[_named(name), "", *_errors(cases), "", ""] for name, cases in document["without"].items()]
    for row in document["seeds"]:
        radii = [row["margins"]["spectral_radius"][name] for name in conditions]
        worst = "-" if None in radii else f"{max(radii):.4f}"
        seconds = f"{row['training']['cpu_time_s']:.0f}"
        rows.append(["`learned-observer`", str(row["seed"]), *_errors(row["cases"]), worst, seconds])
    plants = "\n\n".join(
        f"Largest tip errors [mm] over {part['plants']} plants of `{name}`, seed {document['median']}:\n\n"
        f"{_plants(part, document['quantiles'])}"
        for name, part in document["held_out"].items()
    )
    name, chunks = document["robot"], document["seeds"][0]["training"]["chunks"]
    measured = f"python benchmarks/learned_observer.py --robot {name} --plants {document['plants']}"
    return (
        f"{table(headings, rows)}\n\n{plants}\n\n`{measured}`, trained by `fuzzyarm train estimate --robot {name} "
        f"--chunks {chunks}` with these seeds on the same machine, shared with other work; plants from seed "
        f"{document['first_held_out_seed']} on; {made_with(document)}"
    )


def estimate_sweeps(sweeps: list[dict[str, Any]]) -> str:
    """Return the largest tip errors of policies over the same plants, from a sweep of each."""
    shares = "0.5", "0.9", "0.99"
    headings = ["case", "policy", *(f"{float(share):.0%} [mm]" for share in shares), "worst [mm]", "ended early"]
    rows = [
        [
            _CASES[row["case"]],
            _named(row["policy"]),
            *(f"{row['max_mm'][share]['value']:.2f}" for share in shares),
            f"{max(plant['max_mm'] for plant in row['worst']):.1f}",
            str(row["ended_early"]),
        ]
        for case in zip(*(sweep["rows"] for sweep in sweeps), strict=True)
        for row in case
    ]
    commands = ", ".join(f"`{sweep['command']}`" for sweep in sweeps)
    return (
        f"{table(headings, rows, left=2)}\n\nLargest tip error of each of {sweeps[0]['config']['plants']} plants, the "
        f"same for all. {commands}; {made_with(*sweeps)}"
    )


def _errors(cases: dict[str, float]) -> list[str]:
    forms = {"rms": "{:.4f}".format, "max": "{:.3f}".format}
    return [
        " / ".join(millimetres(cases[f"{name}_{kind}_mm"], form) for kind, form in forms.items()) for name in _CASES
    ]


def _named(policy: str) -> str:
    return f"`{policy}`" if policy.endswith("-observer") else policy


def estimate_parts(document: dict[str, Any]) -> str:
    """Return the table of what the parts give, and the line that says how it was made."""
    headings = ["", *(f"{case}, rms [mm]" for case in _CASES.values())]
    headings += [f"half a sample late: {what}" for what in ("rms [mm]", "torque rate [N m/ms]")]
    headings += [
        f"{name}, {share:.0%} of the largest errors [mm]" for name in ("`loads`", "`all`") for share in (0.5, 0.99)
    ]
    rows = []
    for name, row in document["policies"].items():
        late = row["late"].values()
        errors = [
            [case["quantiles_mm"][place] for case in cases.values()]
            for cases in row["plants"].values()
            for place in range(len(document["quantiles"]))
        ]
        rows.append(
            [
                _named(name),
                *(millimetres(row["cases"][case]["rms_mm"], "{:.4f}".format) for case in _CASES),
                " / ".join(f"{case['rms_mm']:.3f}" for case in late),
                " / ".join(f"{case['torque_rate']:.1f}" for case in late),
                *(" / ".join(f"{value:.2f}" for value in values) for values in errors),
            ]
        )
    ended = sum(
        case["lost"] for row in document["policies"].values() for by in row["plants"].values() for case in by.values()
    )
    return (
        f"{table(headings, rows)}\n\nThree numbers: Cases 1, 2 and 3. `python benchmarks/estimate_parts.py`, "
        f"{document['plants']} development plants from seed {document['first_plant_seed']} on, {ended} episodes "
        f"ended early; {made_with(document)}"
    )


def _seeds(document: dict[str, Any]) -> str:
    conditions = list(document["seeds"][0]["margins"]["spectral_radius"])
    headings = ["seed", *(f"{name}, rms / max [mm]" for name in _CASES.values()), *conditions, "processor time [s]"]
    rows = []
    for row in document["seeds"]:
        cases, radius = row["cases"], row["margins"]["spectral_radius"]
        rows.append(
            [
                str(row["seed"]),
                *_errors(cases),
                *("-" if radius[name] is None else f"{radius[name]:.4f}" for name in conditions),
                f"{row['training']['cpu_time_s']:.0f}",
            ]
        )
    return table(headings, rows)


def _plants(part: dict[str, Any], quantiles: list[float]) -> str:
    rivals = ("elastic-observer", "adaptive-observer")
    headings = ["policy", "case", *_shares(quantiles), "ended early"]
    headings += [f"better than `{rival}` [%]" for rival in rivals]
    rows = []
    for name, row in part["rows"].items():
        policy, _, case = name.partition(", ")
        rows.append(
            [
                _named(policy),
                _CASES[case],
                *map(_error, row["quantiles_mm"]),
                str(row["lost"]),
                *(_share(row["better_than"].get(rival)) for rival in rivals),
            ]
        )
    return table(headings, rows, left=2)


def _shares(quantiles: list[float]) -> list[str]:
    return ["worst" if share == 1.0 else f"{100 * share:g} %" for share in quantiles]


def _error(value: float | None, digits: int = 2) -> str:
    return "ended early" if value is None else f"{value:.{digits}f}"


def _share(better: dict[str, Any] | None) -> str:
    if better is None:
        return ""
    low, high = better["interval_95"]
    return f"{100 * better['share']:.1f} ({100 * low:.1f} to {100 * high:.1f})"
