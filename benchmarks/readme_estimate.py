"""The tables of the learned estimate: errors and margins of the seeds, plants, and what the parts of the law give."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

__all__ = ["estimate_parts", "estimate_robot", "estimate_sweeps", "estimate_tables"]

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
        f"same for all. {commands}; {made_with(sweeps[-1])}"
    )


def _errors(cases: dict[str, float]) -> list[str]:
    return [f"{cases[f'{name}_rms_mm']:.4f} / {cases[f'{name}_max_mm']:.3f}" for name in _CASES]


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
                *(f"{row['cases'][case]['rms_mm']:.4f}" for case in _CASES),
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
    headings = ["policy", "case", *(f"{100 * share:g} %" for share in quantiles), "ended early"]
    headings += [f"better than `{rival}` [%]" for rival in rivals]
    rows = []
    for name, row in part["rows"].items():
        policy, _, case = name.partition(", ")
        rows.append(
            [
                _named(policy),
                _CASES[case],
                *("ended early" if value is None else f"{value:.2f}" for value in row["quantiles_mm"]),
                str(row["lost"]),
                *(_share(row["better_than"].get(rival)) for rival in rivals),
            ]
        )
    return table(headings, rows, left=2)


def _share(better: dict[str, Any] | None) -> str:
    if better is None:
        return ""
    low, high = better["interval_95"]
    return f"{100 * better['share']:.1f} ({100 * low:.1f} to {100 * high:.1f})"
