"""The table of `fuzzyarm margins`: how far policies are from instability, also where the arm is not as they know it.

What is computed is in `fuzzyarm.eval.stability.linearisation`; here are the conditions, the document and its print.
"""

from __future__ import annotations

import dataclasses
import datetime
import math
import shlex
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.provenance import provenance
from fuzzyarm.eval.stability.linearisation import (
    GAIN_SPAN,
    POSTURES,
    LocalLoop,
    gain_limits,
    largest_radius,
    linearise_path,
)
from fuzzyarm.fuzzy_policy.policy import Policy, Predictor
from fuzzyarm.policies import NAMES, PolicySpec, resolve_all
from fuzzyarm.policies.user_code import UserPolicy

SCHEMA = "fuzzyarm-margins/1"
CONTROL_PERIOD = 1e-3  # s


@dataclasses.dataclass(frozen=True)
class Condition:
    """How the loop differs from what the policy was made for; the policy is not told.

    Attributes:
        name: heading in the table and key in the document.
        loop_gain: factor on the torque's deviation from equilibrium.
        delay: extra samples of delay, a multiple of 0.5.
        stiffness: factor on the stiffness of both joints.
        payload: what the arm carries.
    """

    name: str
    loop_gain: float = 1.0
    delay: float = 0.0
    stiffness: float = 1.0
    payload: Payload | None = None


CONDITIONS = (
    Condition("nominal"),
    Condition("loop gain x 0.67", loop_gain=0.67),
    Condition("loop gain x 1.5", loop_gain=1.5),
    Condition("half a sample later", delay=0.5),
    Condition("one sample later", delay=1.0),
    Condition("stiffness - 20 %", stiffness=0.8),
    Condition("stiffness + 20 %", stiffness=1.2),
    Condition("5 kg payload", payload=Payload(5.0)),
)

LIMITS = {
    "lower": ("loop gain from", 0.0, 0),
    "upper": ("to", 0.0, 1),
    "upper_one_sample_later": ("to, one sample later", 1.0, 1),
}
"""Limits of the loop gain on the nominal arm: heading, extra samples of delay, and which of the `gain_limits`."""


@dataclasses.dataclass(frozen=True)
class MarginsConfig:
    """What is measured.

    Attributes:
        policies: names, files, folders or code, see `fuzzyarm.policies.spec`.
        robot: TOML file of another arm than Table 1, of the plant and of the policies' models.
    """

    policies: tuple[str, ...] = NAMES
    robot: Path | None = None

    def __post_init__(self) -> None:
        """Check the names before anything runs."""
        if not self.policies or len(set(self.policies)) != len(self.policies):
            raise ValueError(f"policies = {list(self.policies)} must be one or more different names")

    def command(self) -> str:
        """Return the command line of this configuration."""
        words = ["fuzzyarm", "margins"]
        if self.policies != NAMES:
            words += [word for policy in self.policies for word in ("--policy", policy)]
        if self.robot is not None:
            words += ["--robot", str(self.robot)]
        return shlex.join(words)


def margins(config: MarginsConfig, progress: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """Measure every policy in every condition and return the document that `fuzzyarm margins --json` prints.

    Args:
        config: what is measured.
        progress: called after each policy.

    Returns:
        provenance, ``conditions``, and under ``rows`` for each policy what `measure` returns.

    Raises:
        ValueError: a policy is unknown or does not fit the robot, or the path does not fit it.
        OSError: a file cannot be read.
    """
    parameters = ArmParameters.from_toml(config.robot) if config.robot else ArmParameters()
    JointReference(parameters=parameters)  # an arm that cannot follow the path is bad usage, not a row of dashes
    specs = resolve_all(config.policies, run_code=True)
    policies = {label: _loaded(spec, parameters) for label, spec in specs.items()}
    rows = []
    for name, policy in policies.items():
        rows.append({"policy": name, **measure(policy, parameters, policy.control_period)})
        progress()
    return {
        "schema": SCHEMA,
        "command": config.command(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        **provenance(),
        "method": {"control_period": CONTROL_PERIOD, "postures": POSTURES, "gain_span": GAIN_SPAN},
        "parameters": parameters.to_dict(),
        "conditions": [dataclasses.asdict(condition) for condition in CONDITIONS],
        "rows": rows,
    }


def _loaded(spec: PolicySpec, parameters: ArmParameters) -> Policy | UserPolicy:
    """Return a policy for `CONTROL_PERIOD`, or for the time it holds an action: over that its loop is one map."""
    policy = spec.load(CONTROL_PERIOD, parameters)
    period = policy.action_period
    return policy if period == CONTROL_PERIOD else spec.load(period, parameters)


def measure(policy: Predictor, parameters: ArmParameters, control_period: float) -> dict[str, Any]:
    """Return the margins of a policy that knows the arm `parameters` and acts every `control_period` [s].

    Returns:
        ``control_period`` [s], ``spectral_radius`` by name of condition and ``loop_gain`` by key of `LIMITS`; None
        where there is no such number, and then under the same name in ``reasons`` why.
    """

    @cache
    def loops(stiffness: float, payload: Payload | None) -> list[LocalLoop]:
        first, second = parameters.stiffness
        plant = dataclasses.replace(parameters, stiffness=(stiffness * first, stiffness * second))
        return linearise_path(policy, plant, control_period, payload)

    reasons: dict[str, str] = {}

    def number_or_reason(name: str, compute: Callable[[], float]) -> float | None:
        try:
            return compute()
        except (TypeError, ValueError) as error:  # as documented by `linearise_path` and `_limit`
            reasons[name] = " ".join(str(error).split())
            return None

    def radius(condition: Condition) -> float:
        plant = loops(condition.stiffness, condition.payload)
        return largest_radius(plant, condition.loop_gain, condition.delay)

    def limit(delay: float, side: int) -> float:
        return _limit(loops(1.0, None), delay, side)

    return {
        "control_period": control_period,
        "spectral_radius": {c.name: number_or_reason(c.name, partial(radius, c)) for c in CONDITIONS},
        "loop_gain": {
            key: number_or_reason(key, partial(limit, delay, side)) for key, (_, delay, side) in LIMITS.items()
        },
        "reasons": reasons,
    }


def _limit(loops: Sequence[LocalLoop], delay: float, side: int) -> float:
    """Return one of the `gain_limits`; ValueError with the reason if there is none."""
    limit = gain_limits(loops, delay)[side]
    if math.isnan(limit):
        raise ValueError("unstable with its own loop gain")
    if limit in (0.0, math.inf):
        raise ValueError(
            f"stable {'up' if limit else 'down'} to {GAIN_SPAN if limit else 1 / GAIN_SPAN:g} times its loop gain"
        )
    return limit


def margin_cells(rows: Sequence[dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Return the headings and the cells, which are text; a dash where there is no number."""
    headings = ["policy", *(c.name for c in CONDITIONS), *(heading for heading, _, _ in LIMITS.values())]
    cells = [
        [
            row["policy"],
            *(_radius_cell(row["spectral_radius"][c.name]) for c in CONDITIONS),
            *("-" if row["loop_gain"][key] is None else f"{row['loop_gain'][key]:.2f}" for key in LIMITS),
        ]
        for row in rows
    ]
    return headings, cells


def _radius_cell(radius: float | None) -> str:
    if radius is None:
        return "-"
    return f"{radius:.4f}{' unstable' if radius >= 1.0 else ''}"


def margin_notes(document: dict[str, Any]) -> list[str]:
    """Return what has to be said below the table, a paragraph each."""
    method = document["method"]
    notes = [
        f"Spectral radius of the loop over one control period of {1e3 * method['control_period']:g} ms, the largest at "
        f"{method['postures']} postures of the paper's path: below 1, small deviations decay. Then the factors on the "
        "loop gain between which it stays below 1.",
        "A local measurement and not a proof: postures frozen, dry friction removed, deviations small. Each policy "
        "keeps its nominal knowledge.",
    ]
    headings = {key: heading for key, (heading, _, _) in LIMITS.items()}
    for row in document["rows"]:
        if row["control_period"] != method["control_period"]:
            notes.append(f"{row['policy']} acts every {1e3 * row['control_period']:g} ms, which is its period here.")
        missing: dict[str, list[str]] = {}
        for name, reason in row["reasons"].items():
            missing.setdefault(reason, []).append(f"'{headings.get(name, name)}'")
        notes += [f"{row['policy']}, no {' or '.join(names)}: {reason}" for reason, names in missing.items()]
    return notes


def print_margins(document: dict[str, Any], console: Console) -> None:
    """Print the table and its notes; in a terminal too narrow for all columns, several tables below each other."""
    headings, cells = margin_cells(document["rows"])
    unlimited = console.options.update(max_width=1000)
    tables: list[Table] = []
    shown: list[int] = []
    for column in range(1, len(headings)):
        wider = _table(headings, cells, [*shown, column], console.is_terminal)
        fits = not console.is_terminal or console.measure(wider, options=unlimited).maximum <= console.width
        if fits and tables:
            tables[-1], shown = wider, [*shown, column]
        else:
            tables, shown = [*tables, _table(headings, cells, [column], console.is_terminal)], [column]
    for table in tables:
        console.print(table)
    for note in margin_notes(document):
        console.print(f"\n{note}", highlight=False, markup=False)


def _table(headings: Sequence[str], cells: Sequence[Sequence[str]], columns: Sequence[int], terminal: bool) -> Table:
    """Return the table of some columns beside the policies: with lines in a terminal, plain columns when piped."""

    def text(content: str) -> Text:
        # In a terminal a word a line keeps the columns narrow.
        return Text(content.replace(" ", "\n") if terminal else content, style="red" if "unstable" in content else "")

    table = Table(box=box.SIMPLE_HEAD if terminal else None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column(headings[0], no_wrap=True)
    for column in columns:
        table.add_column(text(headings[column]), justify="right", no_wrap=not terminal)
    for row in cells:
        table.add_row(Text(row[0]), *(text(row[column]) for column in columns))
    return table
