"""`fuzzyarm show`: the law of a policy and its gains, as numbers."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from fuzzyarm.cli._usage import UsageError
from fuzzyarm.common.console import say, say_json

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["Options"]


@dataclass(frozen=True)
class Options:
    """Print the law of a policy: equations in the order of computation, numbers with units, and one state as a check.

    Then print what is proven about it, with numbers rounded in the safe direction. A controller file is first proven
    again; it is shown for the arm that it was designed for.
    """

    policy: Annotated[str, Parameter(name="", metavar="NAME|FILE")]
    """Policy: fuzzy-4, computed-torque, ... with or without -tip, elastic-observer, or a controller file (.json,
    .json-tip)"""
    _: KW_ONLY
    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Robot by name, or TOML file of another arm or robot, for policies without a file (default: Table 1 of the
    paper)"""
    csv: bool = False
    """Print the numbers as CSV, exactly"""
    json: bool = False
    """Print everything as JSON, with exact numbers"""

    def run(self) -> int:
        """Print the law and the numbers of the policy."""
        from fuzzyarm.export.sheet import sheet_of

        if self.csv and self.json:
            raise UsageError("--csv and --json both choose the output format; leave out one")
        sheet = sheet_of(self.policy, loaded(self.policy, self.robot))
        if self.csv:
            say(sheet.to_csv())
        elif self.json:
            say_json(sheet.to_dict())
        else:
            say(sheet.to_text())
        return 0


def loaded(name: str, robot: str | None) -> Policy:
    """Load the policy `name` for a robot; without one, a controller file is loaded for the arm of its design."""
    from fuzzyarm.fuzzy_policy.controller import Controller
    from fuzzyarm.fuzzy_policy.scheduled_controller import load_controller
    from fuzzyarm.policies import Kind, load_policy, resolve

    spec = resolve(name)
    if robot is None and spec.kind is Kind.CONTROLLER and not spec.named and spec.path is not None:
        controller = load_controller(spec.path)
        own = controller.model.parameters if isinstance(controller, Controller) else controller.robot
        return load_policy(name, robot=own)
    return load_policy(name, robot=robot)
