"""The table of the shipped robots: what each of them is asked to do and carries in the cases, as the package has it."""

from __future__ import annotations

from readme_markdown import table

from fuzzyarm.envs.physics.equations import PAPER, chosen_arm, robot_of
from fuzzyarm.envs.physics.robot import shipped_robots
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import MachiningForce

__all__ = ["robots_table"]


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
