"""The table of the shipped robots: what each of them is asked to do and carries in the cases, as the package has it."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

from fuzzyarm.envs.physics.equations import PAPER, chosen_arm, robot_of
from fuzzyarm.envs.physics.robot import shipped_robots
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import MachiningForce
from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = [
    "robot_comparison_tables",
    "robot_friction_table",
    "robot_learned_table",
    "robot_speed_table",
    "robots_table",
]


def robots_table() -> str:
    """Return the table; nothing in it is measured."""
    rows = []
    for name in sorted(shipped_robots(), key=lambda name: (name != PAPER, len(robot_of(chosen_arm(name, None))))):
        arm = chosen_arm(name, None)
        force, payload = case_for("machining", arm).disturbance.tip_force, case_for("payload", arm).disturbance.payload
        assert isinstance(force, MachiningForce)
        reference = default_reference(arm)
        radius = reference.circle[1] if reference.circle is not None else float("nan")
        between = f"{force.base:g} to {force.base + force.swing:g}"
        cells = (f"{radius:.3f}", f"{reference.duration:g}", between, f"{payload.mass:g}")
        rows.append((f"`{name}`", str(reference.joints), *cells))
    headings = (
        "robot",
        "joints",
        "radius of the circle [m]",
        "duration [s]",
        "machining force [N]",
        "payload [kg]",
    )
    return table(headings, rows)


def robot_speed_table(document: dict[str, Any]) -> str:
    """Return nanoseconds a sub-step and lane of each robot beside MuJoCo's elastic arm in the same run."""
    headings = ("robot", "joints", "a sub-step and lane [ns]", "MuJoCo [ns]", "times as fast")
    rows = [
        (f"`{row['robot']}`", str(row["joints"]), f"{row['ns']:.0f}", f"{row['mujoco_ns']:.0f}", f"{row['ratio']:.0f}")
        for row in document["rows"]
    ]
    compared = ", ".join(f"{name} {row['ratio']:.2f}" for name, row in document["generated_over_hand_written"].items())
    note = (
        f"Equations of two joints written by hand: {document['hand_written_ns']:.0f} ns; time of the recursion "
        f"over theirs: {compared}. One thread; `{document['command']}`; {made_with(document)}"
    )
    return f"{table(headings, rows)}\n\n{note}"


def robot_comparison_tables(documents: list[dict[str, Any]]) -> str:
    """Return for each robot the trade-off of its rules, the cases, the margins and the sweep."""
    return "\n\n".join(_comparison(document) for document in documents)


def robot_friction_table(document: dict[str, Any]) -> str:
    """Return the tip errors of policies in the cases with the robot's friction, and with a multiple of it."""
    headings = (
        "policy",
        "friction",
        *(f"{title.partition(': ')[2]}, rms (max) [mm]" for title in document["titles"].values()),
    )
    cells: dict[tuple[str, str], list[str]] = {}
    for row in document["rows"]:
        error = f"{row['tip_error_rms_mm']:.3g} ({row['tip_error_max_mm']:.3g})" if row["completed"] else "ended early"
        cells.setdefault((row["policy"], f"{row['friction']:g} times"), []).append(error)
    rows = [(*of, *errors) for of, errors in sorted(cells.items())]
    return f"{table(headings, rows, left=2)}\n\n`{document['command']}`; {made_with(document)}"


def robot_learned_table(document: dict[str, Any]) -> str:
    """Return what each seed of a training for a robot reached, below the policy that it shifts."""
    cases = ("nominal", "machining", "payload")
    headings = ("policy", "seed", "million steps", "processor time [s]", *(f"{case}, rms (max) [mm]" for case in cases))
    rows = []
    for row in document["rows"]:
        run = ["-", "-", "-"]
        if "seed" in row:
            run = [f"{row['seed']}", f"{1e-6 * row['steps']:.1f}", f"{row['cpu_time_s']:.0f}"]
        errors = [_error(row, case) for case in cases]
        rows.append((row["policy"], *run, *errors, _number(row.get("radius"), "{:.4f}")))
    note = f"`{document['command']}`; {made_with(document)}"
    return f"{table((*headings, 'radius, elastic'), rows)}\n\n{note}"


def _error(row: dict[str, Any], case: str) -> str:
    if row[f"{case}_share"] < 1.0:
        return "ended early"
    return _rms_and_max(row[f"{case}_rms_mm"], row[f"{case}_max_mm"])


def _rms_and_max(*errors: float) -> str:
    return "{} ({})".format(*(millimetres(error, "{:.3g}".format) for error in errors))


def _comparison(document: dict[str, Any]) -> str:
    parts = [f"### `{document['robot']}`", _tradeoff(document["tradeoff"]), _policies(document)]
    note = f"{document['plants']} plants. `{document['command']}`; {made_with(document)}"
    return "\n\n".join([*parts, note])


def _tradeoff(rows: list[dict[str, Any]]) -> str:
    headings = (
        "rules",
        "premises",
        "κ",
        "α [1/s]",
        "fastest pole [1/s]",
        "γ [rad/(N m)]",
        "γ at the first α and pole",
        "k_p [1/s²]",
        "k_d [1/s]",
        "radius, elastic",
        "loop gain to",
        "to, one sample later",
        "design and proof [s]",
    )
    cells = [
        (
            str(row["rules"]),
            ", ".join(row["premises"]) or "none",
            f"{row['kappa']:.2f}",
            f"{row['alpha']:g}",
            f"{row['fastest_pole']:.0f}",
            f"{row['gamma']:.2g}",
            _number(row.get("gamma_at_first_pole"), "{:.2g}"),
            f"{row['k_p']:.3g}",
            f"{row['k_d']:.3g}",
            _number(row["spectral_radius"]["nominal"], "{:.4f}"),
            _number(row["loop_gain"]["upper"], "{:.2f}"),
            _number(row["loop_gain"]["upper_one_sample_later"], "{:.2f}"),
            f"{row['seconds']:.0f}",
        )
        for row in rows
    ]
    return table(headings, cells, left=2)


def _policies(document: dict[str, Any]) -> str:
    """Return a row for each policy: tip errors in the cases, margins, and the sweep."""
    cases, bound = list(document["titles"]), document["bound"]
    headings = ["policy", *(f"{title.partition(': ')[2]}, rms (max) [mm]" for title in document["titles"].values())]
    headings += ["radius, elastic", "loop gain to"]
    headings += [f"plants below {bound:g} mm, {case} [%]" for case in cases]
    rows = []
    for margins in document["margins"]:
        policy = margins["policy"]
        of_case = {row["case"]: row for row in document["cases"] if row["policy"] == policy}
        swept = {row["case"]: row for row in document["sweep"] if row["policy"] == policy}
        errors = [
            _rms_and_max(row["tip_error_rms_mm"], row["tip_error_max_mm"]) if row["completed"] else "ended early"
            for row in (of_case[case] for case in cases)
        ]
        radius, gain = margins["spectral_radius"]["nominal"], margins["loop_gain"]["upper"]
        success = [f"{100.0 * swept[case]['success']['value']:.1f}" for case in cases]
        rows.append((policy, *errors, _number(radius, "{:.4f}"), _number(gain, "{:.2f}"), *success))
    return table(headings, rows)


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
