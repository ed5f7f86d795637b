"""The stability margins of `fuzzyarm margins`: their measurement, document and table."""

import dataclasses
import math
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from functools import cache, cached_property, partial
from typing import Any

from rich.console import Console

from fuzzyarm.common.checks import distinct, instance, listed
from fuzzyarm.common.console import Sheet, print_paragraphs
from fuzzyarm.envs.periods import checked_period
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import AnyArm, chosen_arm, corners_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.eval.provenance import made_now
from fuzzyarm.eval.stability import _linearisation as linearisation
from fuzzyarm.eval.stability._linearisation import (
    GAIN_SPAN,
    GainLimits,
    Linearisable,
    LocalLoop,
    gain_limits,
    largest_radius,
)
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of, with_drives
from fuzzyarm.policies import ANY_ROBOT, NAMES, policies_of, recorded, resolve_all

__all__ = [
    "CONTROL_PERIOD", "MarginsConfig", "ends_in_words", "ends_of", "margin_cells", "margin_notes", "margins_in_words",
    "measure_margins", "policy_margins", "print_margins",
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class _Condition:
    """A difference between the loop and the policy's design model; the policy does not know it."""

    name: str  # heading in the table and key in the document
    loop_gain: float = 1.0  # factor on the torque's deviation from equilibrium
    delay: float = 0.0  # extra samples, a multiple of 0.5
    stiffness: float = 1.0  # factor for all joints
    payload: Payload | None = None


# Limits of the loop gain on the nominal arm by key in the document: heading, extra samples, index in `GainLimits`.
_LIMITS = {
    "lower": ("loop gain from", 0.0, 0),
    "upper": ("to", 0.0, 1),
    "upper_one_sample_later": ("to, one sample later", 1.0, 1),
}


def _conditions_for(arm: AnyArm) -> tuple[_Condition, ...]:
    """Return the conditions of `fuzzyarm margins` for an arm; the payload is from the evaluation case ``payload``."""
    payload = case_for("payload", arm).disturbance.payload
    return (
        _Condition("nominal"),
        _Condition("loop gain x 0.67", loop_gain=0.67),
        _Condition("loop gain x 1.5", loop_gain=1.5),
        _Condition("half a sample later", delay=0.5),
        _Condition("one sample later", delay=1.0),
        _Condition("stiffness - 20 %", stiffness=0.8),
        _Condition("stiffness + 20 %", stiffness=1.2),
        _Condition(f"{payload.mass:g} kg payload", payload=payload),
    )


_SCHEMA = "fuzzyarm-margins/1"
CONTROL_PERIOD = 1e-3  # s


@dataclasses.dataclass(frozen=True)
class MarginsConfig:
    """The policies whose margins are measured, and the arm.

    Attributes:
        policies: names, files, folders or code, see `fuzzyarm.policies.spec`; None: those in the folder if `robot` is
            a folder of `fuzzyarm tune`, otherwise `ANY_ROBOT` for a robot and all named ones for a two-joint arm.
        robot: for both plant and policies, as for `chosen_arm`; None: Table 1.
        control_period: time between two actions [s].
    """

    policies: tuple[str, ...] | None = None
    robot: str | os.PathLike[str] | AnyArm | None = None
    control_period: float = CONTROL_PERIOD

    def __post_init__(self) -> None:
        checked_period("control_period", self.control_period)
        if self.policies is not None:
            distinct("policies", self.policies)
        if not isinstance(self.robot, str | os.PathLike):
            chosen_arm(self.robot, None)  # a name or a file is looked up where the arm is needed

    @cached_property
    def arm(self) -> AnyArm:
        """The arm; ValueError if its name is unknown."""
        return chosen_arm(self.robot, None)

    def names(self) -> tuple[str, ...]:
        """Return the names of the policies that are measured."""
        named = self.policies or policies_of(self.robot)
        return named or (NAMES if isinstance(self.arm, ArmParameters) else ANY_ROBOT)

    def command(self) -> str | None:
        """Return the command line of this configuration, absolute paths shortened; None if `robot` is an object."""
        if not isinstance(self.robot, str | os.PathLike | None):
            return None
        words = ["fuzzyarm", "margins"]
        words += [word for policy in self.policies or () for word in ("--policy", recorded(policy))]
        if self.robot is not None:
            words += ["--robot", recorded(os.fspath(self.robot))]
        if self.control_period != CONTROL_PERIOD:
            words += ["--control-period", f"{self.control_period:g}"]
        return shlex.join(words)


def measure_margins(config: MarginsConfig, progress: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """Measure every policy in every condition and return the document that `fuzzyarm margins --json` prints.

    The document contains the provenance, ``conditions``, and ``rows``: for each policy the result of `policy_margins`
    and, if the robot's file has ranges, ``ends``, that of `ends_of`. `progress` is called after each policy.

    Raises:
        ValueError: a policy is unknown, or a policy or the path does not fit the robot.
    """
    arm = instance("config", config, MarginsConfig).arm
    default_reference(arm)  # if the arm cannot follow it, that is a usage error and not a row of the table
    policies = {}
    for label, spec in resolve_all(config.names(), run_code=True).items():
        policy = spec.load(config.control_period, arm)
        period = policy.action_period  # over one such period the loop is a single map
        policies[label] = policy if period == config.control_period else spec.load(period, arm)
    rows, corners = [], corners_of(config.robot)
    for name, policy in policies.items():
        row = {"policy": name, **policy_margins(policy, arm, policy.control_period)}
        rows.append(row | ({"ends": ends_of(policy, corners, policy.control_period)} if corners else {}))
        progress()
    described = {"parameters": arm.to_dict()} if isinstance(arm, ArmParameters) else {"robot": dataclasses.asdict(arm)}
    return {
        "schema": _SCHEMA,
        **made_now(config.command()),
        "method": {"control_period": config.control_period, "postures": linearisation.POSTURES, "gain_span": GAIN_SPAN},
        **described,
        "conditions": [dataclasses.asdict(condition) for condition in _conditions_for(arm)],
        "rows": rows,
    }


def ends_of(policy: Linearisable, corners: Mapping[str, AnyArm], control_period: float) -> dict[str, float | None]:
    """Return the spectral radius [1] of a policy's closed loop with each arm of `corners`, by the key of the arm.

    It is None if the loop cannot be linearised. `corners` are the arms at the ends of ranges, see `corners_of`; the
    policy keeps its model of the arm. The control period is in s.
    """
    found: dict[str, float | None] = {}
    for words, arm in corners.items():
        try:
            found[words] = largest_radius(linearisation.linearise_path(policy, arm, control_period))
        except ValueError:  # a torque limit, or no equilibrium
            found[words] = None
    return found


def ends_in_words(ends: Mapping[str, float | None]) -> str:
    """Return a text with the spectral radii of `ends_of`, the worst first; None (no linearisation) is the worst."""
    ordered = sorted(ends, key=lambda words: -math.inf if ends[words] is None else -ends[words])  # type: ignore[operator]
    first, *others = (f"{_radius_cell(ends[words])} with {words}" for words in ordered)
    rest = "".join(f", {other}" for other in others)
    unstable = any(radius is None or radius >= 1.0 for radius in ends.values())
    way = "; before you run the policy, measure the parameter that gives the worst value" if unstable else ""
    return f"has these spectral radii at the ends of the ranges: {first} (the worst){rest}{way}"


def policy_margins(policy: Linearisable, parameters: AnyArm, control_period: float) -> dict[str, Any]:
    """Return the stability margins of a policy that knows the arm `parameters` and acts every `control_period` [s].

    They are ``control_period`` [s], ``spectral_radius`` by name of condition and ``loop_gain`` by key of `_LIMITS`. A
    number that does not exist is None, and ``reasons`` says why under the same name.
    """

    @cache
    def loops(stiffness: float, payload: Payload | None) -> list[LocalLoop]:
        plant = with_drives(parameters, stiffness=stiffness * per_joint_of(parameters, "stiffness"))
        return linearisation.linearise_path(policy, plant, control_period, payload)

    reasons: dict[str, str] = {}

    def number_or_reason(name: str, compute: Callable[[], float]) -> float | None:
        try:
            return compute()
        except (TypeError, ValueError) as error:  # as documented by `linearise_path`, or there is no limit
            reasons[name] = " ".join(str(error).split())
            return None

    def radius(c: _Condition) -> float:
        return largest_radius(loops(c.stiffness, c.payload), c.loop_gain, c.delay)

    @cache
    def limits(delay: float) -> GainLimits:
        return gain_limits(loops(1.0, None), delay)

    def limit(delay: float, side: int) -> float:
        found = limits(delay)[side]
        if math.isnan(found):
            raise ValueError("unstable at the nominal loop gain")
        if found in (0.0, math.inf):
            raise ValueError(
                f"stable at every loop gain tried, {'up' if found else 'down'} to "
                f"{GAIN_SPAN if found else 1 / GAIN_SPAN:g} times the nominal gain"
            )
        return found

    return {
        "control_period": control_period,
        "spectral_radius": {c.name: number_or_reason(c.name, partial(radius, c)) for c in _conditions_for(parameters)},
        "loop_gain": {
            key: number_or_reason(key, partial(limit, delay, side)) for key, (_, delay, side) in _LIMITS.items()
        },
        "reasons": reasons,
    }


def margins_in_words(policy: Linearisable, arm: AnyArm, control_period: float) -> str:
    """Return the margins of one policy as a paragraph, for a control period [s]; see `policy_margins`."""
    found = policy_margins(policy, arm, control_period)
    radii = [f"{name} {_radius_cell(radius)}" for name, radius in found["spectral_radius"].items()]
    lower, upper, later = (
        found["reasons"].get(key) or f"stable {ways} to {found['loop_gain'][key]:.2f} times the nominal loop gain"
        for key, ways in zip(_LIMITS, ("down", "up", "up"), strict=True)
    )
    text = (
        f"On the elastic arm, sampled every {1e3 * control_period:g} ms, linearised at {linearisation.POSTURES} "
        f"postures of its default path (measured, not proven), spectral radius: {', '.join(radii)}; "
        f"{' and '.join(dict.fromkeys((lower, upper)))}; with one sample of delay, {later}"
    )
    unstable = [name for name, radius in found["spectral_radius"].items() if radius is None or radius >= 1.0]
    if not unstable:
        return text
    worst = "even in its nominal condition" if "nominal" in unstable else f"with {listed(unstable)}"
    return (
        f"{text}\n\nWARNING: the proof is for the rigid arm; on the elastic, sampled arm this controller is "
        f"unstable {worst}. Lower its gains: lower --alpha, raise --gamma or change --fastest-pole, and check the "
        "margins again before you run it."
    )


def margin_cells(rows: Sequence[dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Return the headings of the table of margins, then the cells of each row as text; a dash if there is no number."""
    conditions = list(rows[0]["spectral_radius"])  # every row has the same ones
    headings = ["policy", *conditions, *(heading for heading, *_ in _LIMITS.values())]
    cells = [
        [
            row["policy"],
            *(_radius_cell(row["spectral_radius"][name]) for name in conditions),
            *("-" if row["loop_gain"][key] is None else f"{row['loop_gain'][key]:.2f}" for key in _LIMITS),
        ]
        for row in rows
    ]
    return headings, cells


def _radius_cell(radius: float | None) -> str:
    return "-" if radius is None else f"{radius:.4f}{' unstable' if radius >= 1.0 else ''}"


def margin_notes(document: dict[str, Any]) -> list[str]:
    """Return the notes below the table of margins, one string for each paragraph."""
    method, robot = document["method"], document.get("robot")
    path = "the paper's path" if robot is None else f"the default reference of {robot['name']}"
    notes = [
        f"Spectral radius of the loop over one control period of {1e3 * method['control_period']:g} ms, the largest at "
        f"{method['postures']} postures of {path}: below 1, small deviations decay. The radius stays below 1 "
        "between the listed factors on the loop gain.",
        "This is a local measurement, not a proof: postures are frozen, dry friction is removed, and deviations are "
        "small. Each policy keeps its nominal model of the arm.",
    ]
    for row in document["rows"]:
        if row["control_period"] != method["control_period"]:
            period = 1e3 * row["control_period"]
            notes.append(f"{row['policy']} acts every {period:g} ms, which is its control period in this table.")
        if "ends" in row:
            notes.append(f"{row['policy']} {ends_in_words(row['ends'])}.")
        missing: dict[str, list[str]] = {}
        for name, reason in row["reasons"].items():
            missing.setdefault(reason, []).append(f"'{_LIMITS[name][0] if name in _LIMITS else name}'")
        notes += [f"{row['policy']} has no {' or '.join(names)}: {reason}" for reason, names in missing.items()]
    return notes


def print_margins(document: dict[str, Any], console: Console) -> None:
    """Print the table of margins, from the document of `measure_margins`, and its notes."""
    Sheet(*margin_cells(document["rows"]), alarm="unstable").print(console)
    print_paragraphs(console, margin_notes(document))
