"""Tables of the shipped robots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from tables import Cell, Section, Table, made_with, number

from fuzzyarm.envs.physics.equations import chosen_arm, robot_of
from fuzzyarm.envs.physics.robot import shipped_robots
from fuzzyarm.envs.scenario.cases import PAPER_CASES, case_for
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = ["COMPARED_ROBOTS", "ROBOTS"]

COMPARED_ROBOTS = ("cicese", "manutec-r3", "planar-3r", "ur5", "panda")
"""Robots whose whole comparison is measured."""


def _robots() -> list[dict[str, Any]]:
    """Return what each of the robots is asked to do and carries in the cases, as the package has it."""
    rows = []
    for name in sorted(shipped_robots(), key=lambda name: (name != "paper", len(robot_of(chosen_arm(name, None))))):
        arm = chosen_arm(name, None)
        force: Any = case_for("machining", arm).disturbance.tip_force
        reference = default_reference(arm)
        radius = reference.circle[1] if reference.circle is not None else float("nan")
        row = {
            "name": name,
            "radius": radius,
            "reference": reference,
            "force": force,
            "largest": force.base + force.swing,
        }
        rows.append({**row, "payload": case_for("payload", arm).disturbance.payload})
    return rows


def _rms_and_max(row: Mapping[str, Any], rms: str, largest: str) -> str:
    return "{} ({})".format(*(millimetres(row[key], "{:.3g}".format) for key in (rms, largest)))


def _learned_in(case: str) -> Cell:
    return lambda row: (
        "ended early" if row[f"{case}_share"] < 1.0 else _rms_and_max(row, f"{case}_rms_mm", f"{case}_max_mm")
    )


def _of_run(form: Callable[[Any], str]) -> Cell:
    return lambda row: form(row) if "seed" in row else "-"


def _titles(document: Mapping[str, Any]) -> dict[str, str]:
    """Return the heading of each case."""
    return {case: f"{title.partition(': ')[2]}, rms (max) [mm]" for case, title in document["titles"].items()}


def _frictions(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each policy and friction, with the results of its cases."""
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for row in document["rows"]:
        of = {"policy": row["policy"], "friction": f"{row['friction']:g} times"}
        rows.setdefault((of["policy"], of["friction"]), of)[row["case"]] = row
    return [rows[key] for key in sorted(rows)]


def _with_friction(case: str) -> Cell:
    form = "{tip_error_rms_mm:.3g} ({tip_error_max_mm:.3g})"
    return lambda row: form.format(**row[case]) if row[case]["completed"] else "ended early"


def _of_speed(document: Mapping[str, Any]) -> str:
    compared = ", ".join(f"{name} {row['ratio']:.2f}" for name, row in document["generated_over_hand_written"].items())
    return (
        f"Equations of two joints written by hand: {document['hand_written_ns']:.0f} ns; time of the recursion over "
        f"theirs: {compared}. One thread; `{document['command']}`"
    )


_TRADEOFF = Table(
    {
        "rules": "{rules}",
        "premises": lambda row: ", ".join(row["premises"]) or "none",
        "κ": "{kappa:.2f}",
        "α [1/s]": "{alpha:g}",
        "fastest pole [1/s]": "{fastest_pole:.0f}",
        "γ [rad/(N m)]": "{gamma:.2g}",
        "γ at the first α and pole": number("gamma_at_first_pole", ".2g"),
        "k_p [1/s²]": "{k_p:.3g}",
        "k_d [1/s]": "{k_d:.3g}",
        "radius, elastic": lambda row: number("nominal", ".4f")(row["spectral_radius"]),
        "loop gain to": lambda row: number("upper", ".2f")(row["loop_gain"]),
        "to, one sample later": lambda row: number("upper_one_sample_later", ".2f")(row["loop_gain"]),
        "design and proof [s]": "{seconds:.0f}",
    },
    "tradeoff",
    left=2,
)


def _policies(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each policy: its margins, and by case its errors and its sweep."""
    return [
        {
            **margins,
            "cases": {row["case"]: row for row in document["cases"] if row["policy"] == margins["policy"]},
            "sweep": {row["case"]: row for row in document["sweep"] if row["policy"] == margins["policy"]},
        }
        for margins in document["margins"]
    ]


def _in_case(case: str) -> Cell:
    def text(row: Mapping[str, Any]) -> str:
        own = row["cases"][case]
        return _rms_and_max(own, "tip_error_rms_mm", "tip_error_max_mm") if own["completed"] else "ended early"

    return text


def _success(case: str) -> Cell:
    return lambda row: f"{100.0 * row['sweep'][case]['success']['value']:.1f}"


_OF_POLICIES = Table(
    lambda document: {
        "policy": "{policy}",
        **{heading: _in_case(case) for case, heading in _titles(document).items()},
        "radius, elastic": lambda row: number("nominal", ".4f")(row["spectral_radius"]),
        "loop gain to": lambda row: number("upper", ".2f")(row["loop_gain"]),
        **{f"plants below {document['bound']:g} mm, {case} [%]": _success(case) for case in document["titles"]},
    },
    _policies,
)


def _compared(*documents: Mapping[str, Any]) -> str:
    """Return for each robot the trade-off of its rules, the cases, the margins and the sweep."""
    parts: list[str] = []
    for document in documents:
        parts += [f"### `{document['robot']}`", _TRADEOFF(document), _OF_POLICIES(document)]
        parts.append(f"{document['plants']} plants. `{document['command']}`; {made_with(document)}")
    return "\n\n".join(parts)


ROBOTS = {
    "robots": Section(
        (),
        Table(
            {
                "robot": "`{name}`",
                "joints": "{reference.joints}",
                "radius of the circle [m]": "{radius:.3f}",
                "duration [s]": "{reference.duration:g}",
                "machining force [N]": "{force.base:g} to {largest:g}",
                "payload [kg]": "{payload.mass:g}",
            },
            _robots,
        ),
        None,
    ),
    "robot-speed": Section(
        "robot_speed",
        Table(
            {
                "robot": "`{robot}`",
                "joints": "{joints}",
                "a sub-step and lane [ns]": "{ns:.0f}",
                "MuJoCo [ns]": "{mujoco_ns:.0f}",
                "times as fast": "{ratio:.0f}",
            }
        ),
        _of_speed,
    ),
    "robot-friction": Section(
        "robot_friction_panda",
        Table(
            lambda document: {
                "policy": "{policy}",
                "friction": "{friction}",
                **{heading: _with_friction(case) for case, heading in _titles(document).items()},
            },
            _frictions,
            left=2,
        ),
    ),
    "robot-learned": Section(
        "robot_learned_ur5",
        Table(
            {
                "policy": "{policy}",
                "seed": _of_run("{seed}".format_map),
                "million steps": _of_run(lambda row: f"{1e-6 * row['steps']:.1f}"),
                "processor time [s]": _of_run("{cpu_time_s:.0f}".format_map),
                **{f"{case}, rms (max) [mm]": _learned_in(case) for case in PAPER_CASES},
                "radius, elastic": number("radius", ".4f"),
            }
        ),
    ),
    "robot-comparison": Section([f"robot_comparison_{name}" for name in COMPARED_ROBOTS], _compared, None),
}
"""Sections by name."""
