"""`fuzzyarm design`: design a fuzzy controller by linear matrix inequalities."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from fuzzyarm.cli.usage import UsageError, output_file

if TYPE_CHECKING:
    from fuzzyarm.synthesis import Specification

__all__ = ["Options", "run"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Design a fuzzy controller in the consistent-reference form and prove it from its stored gains."""

    out: Annotated[Path, Parameter(metavar="FILE")]
    """Controller file to write (.json)"""
    rules: Annotated[int | None, Parameter(metavar="N")] = None
    """32, 16, 8, 4, 2 or 1 rules (default: 4)"""
    keep: Annotated[str | None, Parameter(metavar="Z,Z")] = None
    """Premises to keep, such as z1,z3, in place of --rules; the others become uncertainty"""
    theorem: Literal["consistent", "paper"] = "consistent"
    """Consistent-reference form, or Theorem 1 or 2 of the paper with the reference model in the loop"""
    alpha: Annotated[float | Literal["max"], Parameter(metavar="RATE", show_choices=False)] = 20.0
    """Decay rate [1/s], or "max" for the largest"""
    gamma: Annotated[float | Literal["min"] | None, Parameter(metavar="GAIN", show_choices=False)] = None
    """Bound of the L2 gain, in the consistent form in rad/(N m), or "min" for the smallest (default: 2e-4, with
    --theorem paper 1000)"""
    gain_bound: Annotated[float | None, Parameter(metavar="BOUND")] = None
    """Bound of the feedback [N m/rad], on joint 1's position gain, on the others in proportion to their units
    (default: as small as the rest allows)"""
    fastest_pole: Annotated[float | None, Parameter(metavar="RATE")] = None
    """Bound of the decay rate from above [1/s]: the rigid loop frozen at any state of the box has no pole with a real
    part below -RATE (default: no bound)"""
    common_multiplier: bool = False
    """One multiplier for all dropped premises of A, as Theorem 2 prints it (default: one for each)"""
    integral: Annotated[bool, Parameter(negative="--no-integral")] = True
    """Integral action"""
    robot: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """TOML file of another arm (default: Table 1 of the paper)"""


def run(options: Options) -> int:
    """Design, prove and write the controller; return 1 if there is none with these requirements."""
    from fuzzyarm.common.console import say, status
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.synthesis import DesignFailed, describe, design

    specification = _specification(options)
    output_file(options.out, ".json")
    parameters = ArmParameters.from_toml(options.robot) if options.robot else ArmParameters()
    try:
        with status("solving and proving"):
            result = design(specification, parameters)
    except DesignFailed as error:
        say(" ".join(f"fuzzyarm design: {error}; nothing was written".split()), error=True)
        return 1
    result.controller.save(options.out)
    say(describe(result))
    say(f"\nwritten to {options.out}")
    return 0


def _specification(options: Options) -> Specification:
    from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
    from fuzzyarm.synthesis import Specification

    if options.rules is not None and options.keep is not None:
        raise UsageError(f"--rules {options.rules} and --keep {options.keep} both choose the premises; leave out one")
    rules = 4 if options.rules is None else options.rules
    if rules not in NAMED_RULES:
        raise UsageError(f"--rules {rules} is unknown; choose from: {', '.join(map(str, NAMED_RULES))}")
    kept = NAMED_RULES[rules] if options.keep is None else tuple(name for name in options.keep.split(",") if name)
    gamma = options.gamma
    if gamma is None:
        gamma = 2e-4 if options.theorem == "consistent" else 1000.0
    return Specification(
        kept=kept,
        form=options.theorem,
        alpha=None if options.alpha == "max" else options.alpha,
        gamma=None if gamma == "min" else gamma,
        gain_bound=options.gain_bound,
        integral=options.integral,
        common_multiplier=options.common_multiplier,
        fastest_pole=options.fastest_pole,
    )
