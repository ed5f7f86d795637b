"""Tables of the learned estimate: errors and margins of the seeds, and plants."""

from __future__ import annotations

from typing import Any

from tables import Cell, Section, Table, markdown

from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = ["ESTIMATE"]

_CASES = {"nominal": "Case 1", "machining": "Case 2", "payload": "Case 3"}
_FORMS = {"rms": "{:.4f}".format, "max": "{:.3f}".format}


def _in_case(name: str) -> Cell:
    return lambda row: " / ".join(millimetres(row["cases"][f"{name}_{kind}_mm"], form) for kind, form in _FORMS.items())


_ERRORS = {f"{title}, rms / max [mm]": _in_case(name) for name, title in _CASES.items()}


def _named(policy: str) -> str:
    return f"`{policy}`" if policy.endswith("-observer") else policy


def _radius(name: str) -> Cell:
    def text(row: dict[str, Any]) -> str:
        radius = row["margins"]["spectral_radius"][name]
        return "-" if radius is None else f"{radius:.4f}"

    return text


def _conditions(document: dict[str, Any]) -> list[str]:
    return list(document["seeds"][0]["margins"]["spectral_radius"])


def _plants(document: dict[str, Any]) -> str:
    """Return the largest tip errors over the plants of each distribution."""
    of_seed = f", seed {document['median']}" if "robot" in document else ""
    return "\n\n".join(
        f"Largest tip errors [mm] over {part['plants']} plants of `{name}`{of_seed}:\n\n"
        f"{_quantiles(part, document['quantiles'])}"
        for name, part in document["held_out"].items()
    )


def _quantiles(part: dict[str, Any], quantiles: list[float]) -> str:
    rivals = ("elastic-observer", "adaptive-observer")
    headings = ["policy", "case", *("worst" if share == 1.0 else f"{100 * share:g} %" for share in quantiles)]
    headings += ["ended early", *(f"better than `{rival}` [%]" for rival in rivals)]
    rows = []
    for name, row in part["rows"].items():
        policy, _, case = name.partition(", ")
        errors = ("ended early" if value is None else f"{value:.2f}" for value in row["quantiles_mm"])
        shares = (_share(row["better_than"].get(rival)) for rival in rivals)
        rows.append([_named(policy), _CASES[case], *errors, str(row["lost"]), *shares])
    return markdown(headings, rows, left=2)


def _share(better: dict[str, Any] | None) -> str:
    if better is None:
        return ""
    low, high = better["interval_95"]
    return f"{100 * better['share']:.1f} ({100 * low:.1f} to {100 * high:.1f})"


def _shipped(document: dict[str, Any]) -> str:
    stable = document["stable_in_every_condition"]
    seeds = "all five seeds" if len(stable) == 5 else ", ".join(f"seed {seed}" for seed in stable) or "no seed"
    return f"Seed {document['median']} is shipped. Stable in every condition: {seeds}."


def _swept(*sweeps: dict[str, Any]) -> list[dict[str, Any]]:
    return [row for case in zip(*(sweep["rows"] for sweep in sweeps), strict=True) for row in case]


ESTIMATE = {
    "estimate": Section(
        "learned_observer",
        (
            Table(
                lambda document: {
                    "seed": "{seed}",
                    **_ERRORS,
                    **{name: _radius(name) for name in _conditions(document)},
                    "processor time [s]": "{training[cpu_time_s]:.0f}",
                },
                "seeds",
            ),
            _shipped,
            _plants,
        ),
        "`python benchmarks/learned_observer.py`, trained by `fuzzyarm train estimate --seed 0` to `4` on the same "
        "machine, shared with other work; plants from seed {first_held_out_seed} on",
    ),
    "estimate-sweeps": Section(
        ("elastic_all", "adaptive_all", "learned_all"),
        Table(
            {
                "case": lambda row: _CASES[row["case"]],
                "policy": lambda row: _named(row["policy"]),
                **{f"{float(share):.0%} [mm]": f"{{max_mm[{share}][value]:.2f}}" for share in ("0.5", "0.9", "0.99")},
                "worst [mm]": lambda row: f"{max(plant['max_mm'] for plant in row['worst']):.1f}",
                "ended early": "{ended_early}",
            },
            _swept,
            left=2,
        ),
        lambda *sweeps: (
            f"Largest tip error of each of {sweeps[0]['config']['plants']} plants, the same for all. "
            f"{', '.join('`{command}`'.format(**sweep) for sweep in sweeps)}"
        ),
    ),
}
"""Sections by name."""
