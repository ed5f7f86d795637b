"""`fuzzyarm design`: design a fuzzy controller by linear matrix inequalities."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from fuzzyarm.cli._options import given
from fuzzyarm.cli._usage import UsageError, output_file
from fuzzyarm.common.console import say, status

if TYPE_CHECKING:
    from fuzzyarm.envs.physics.equations import AnyArm
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.fuzzy_policy.controller import Controller
    from fuzzyarm.fuzzy_policy.scheduled_controller import Premise, ScheduledController
    from fuzzyarm.synthesis import ScheduledSpecification, Specification

__all__ = ["Options"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Design a fuzzy controller, and prove its matrix inequalities from the stored gains.

    The two-joint arm uses the consistent-reference form. Any other robot uses the semidefinite form, in which the rules
    schedule the gains by the inertia.
    """

    out: Annotated[Path, Parameter(metavar="FILE")]
    """Controller file to write (.json)"""
    rules: Annotated[int | None, Parameter(metavar="N")] = None
    """Number of rules: 32, 16, 8, 4, 2 or 1 (default: 4). Semidefinite form: at most 16; their premises are found, at
    most one for each angle but the first"""
    keep: Annotated[str | None, Parameter(metavar="Z,Z")] = None
    """Premises to keep, such as z1,z3, or "cos q2,cos 2q3" in the semidefinite form, instead of --rules; the others
    become uncertainty"""
    theorem: Literal["consistent", "paper", "semidefinite"] | None = None
    """Form: the consistent-reference form, Theorem 1 or 2 of the paper with the reference model in the loop, or the
    semidefinite form for any number of joints (default: consistent for the two-joint arm, semidefinite for a robot of
    joints)"""
    alpha: Annotated[float | Literal["max"] | None, Parameter(metavar="RATE", show_choices=False)] = None
    """Decay rate [1/s], or "max" for the largest (default: the largest up to 20 at which the loop on the sampled
    elastic arm stays stable with twice its gain and with one sample of delay; 20 with --theorem paper)"""
    gamma: Annotated[float | Literal["min"] | None, Parameter(metavar="GAIN", show_choices=False)] = None
    """Bound on the L2 gain, in rad/(N m) in the consistent and the semidefinite form, or "min" for the smallest
    (default: from the arm's inertia and alpha, 2e-4 for Table 1; 1000 with --theorem paper; semidefinite: what the
    fastest pole allows)"""
    gain_bound: Annotated[float | None, Parameter(metavar="BOUND")] = None
    """Bound on the feedback [N m/rad]: on joint 1's position gain, and on the other gains in proportion to their units
    (default: as small as the other requirements allow)"""
    feedforward: Annotated[float | None, Parameter(metavar="SHARE")] = None
    """L of the paper's form, as a share in [0, 1] of L of the consistent form (default: 0, the smallest L)"""
    fastest_pole: Annotated[float | None, Parameter(metavar="RATE")] = None
    """Upper bound on the decay rate [1/s]: frozen at any state of the box, the rigid loop has no pole with a real part
    below -RATE (default: no bound). Semidefinite form: no pole with a modulus above RATE (default: 1.5 times the
    smallest possible value, or what --gamma needs)"""
    common_multiplier: bool = False
    """Use one multiplier for all dropped premises of A, as Theorem 2 prints it (default: one for each)"""
    integral: Annotated[bool, Parameter(negative="--no-integral")] = True
    """Use integral action"""
    control_period: Annotated[float, Parameter(metavar="SECONDS")] = 1e-3
    """Time between two torques [s], at which margins are measured; the proof is in continuous time"""
    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Robot by name (paper, cicese, manutec-r3, planar-3r, ur5, panda), or TOML file of another arm or robot
    (default: Table 1 of the paper)"""

    def run(self) -> int:
        """Design, prove and write the controller; return 1 if no controller meets the requirements."""
        from fuzzyarm.envs.periods import checked_period
        from fuzzyarm.envs.physics.equations import chosen_arm, corners_of
        from fuzzyarm.envs.physics.parameters import ArmParameters
        from fuzzyarm.envs.physics.robot import Robot
        from fuzzyarm.eval.stability.sampled_design import first_with_margins
        from fuzzyarm.synthesis import DesignFailed, describe, describe_scheduled, design_scheduled

        checked_period("control_period", self.control_period)
        arm, ends = chosen_arm(self.robot, None), corners_of(self.robot)
        scheduled = self.theorem == "semidefinite" or (self.theorem is None and isinstance(arm, Robot))
        if isinstance(arm, Robot) and not scheduled:
            raise UsageError(f"--theorem {self.theorem} needs an arm without joint frames; give --theorem semidefinite")
        output_file(self.out, ".json")
        if self.rules is not None and self.keep is not None:
            raise UsageError(f"--rules {self.rules} and --keep {self.keep} both choose the premises; leave out one")
        try:
            if scheduled:
                robot = arm if isinstance(arm, Robot) else Robot.of(arm)
                wanted = _scheduled_specification(self, len(robot))
                with status("bounding the inertia, solving and proving"):
                    found = design_scheduled(wanted, robot)
                controller: Controller | ScheduledController = found.controller
                text = describe_scheduled(found)
            else:
                assert isinstance(arm, ArmParameters)
                candidates = _specifications(self, arm)
                with status("solving and proving"):
                    result = first_with_margins(candidates, arm, self.control_period, list(ends.values()))
                controller, text = result.controller, describe(result)
        except DesignFailed as error:
            say(" ".join(f"fuzzyarm design: {error}; nothing was written".split()), error=True)
            return 1
        controller.save(self.out)
        with status("measuring margins"):
            text += "\n\n" + _margins(controller, self.control_period, ends)
        say(text)
        say(f"\nwritten to {self.out}")
        return 0


def _scheduled_specification(options: Options, joints: int) -> ScheduledSpecification:
    from fuzzyarm.synthesis import ScheduledSpecification

    for option, present in {
        "--alpha max": options.alpha == "max",
        "--gamma min": options.gamma == "min",
        "--gain-bound": options.gain_bound is not None,
        "--common-multiplier": options.common_multiplier,
        "--feedforward": options.feedforward is not None,
        "--no-integral": not options.integral,
    }.items():
        if present:
            raise UsageError(f"{option} does not apply to --theorem semidefinite, the default for robots; leave it out")
    return ScheduledSpecification(
        premises=None if options.keep is None else tuple(map(_premise, filter(None, options.keep.split(",")))),
        rules=min(4, 2 ** (joints - 1)) if options.rules is None else options.rules,
        alpha=options.alpha,  # type: ignore[arg-type]
        gamma=options.gamma,  # type: ignore[arg-type]
        fastest_pole=options.fastest_pole,
    )


def _margins(controller: Controller | ScheduledController, period: float, ends: dict[str, AnyArm]) -> str:
    """Return in words a controller's margins at a control period [s], and its spectral radii on the arms in `ends`."""
    from fuzzyarm.eval.stability.margins import ends_in_words, ends_of, margins_in_words
    from fuzzyarm.eval.stability.sampled_design import why_unstable
    from fuzzyarm.policies import load_policy

    policy = load_policy(controller, control_period=period, allow_unproven=True)  # it was proven just before
    try:
        text = margins_in_words(policy, policy.parameters, period)
        if ends:
            text += f"\n\nThis controller {ends_in_words(ends_of(policy, ends, period))}."
        return text + why_unstable(controller, policy.parameters, period) if "WARNING" in text else text
    except ValueError as error:  # the arm cannot follow its path
        return f"Margins on the elastic arm were not measured: {error}"


def _premise(text: str) -> Premise:
    """Return the premise variable that a text such as "cos q2" or "sin 2q3" names; UsageError for any other text."""
    import re

    from fuzzyarm.fuzzy_policy.scheduled_controller import Premise

    found = re.fullmatch(r"\s*(cos|sin)\s*(2?)q([1-9]\d?)\s*", text)
    if found is None or found[3] == "1":
        raise UsageError(
            f"--keep {text.strip()!r} is not a premise; allowed: cos or sin of q2, 2q2, q3, ..., as in 'cos 2q2'"
        )
    return Premise(int(found[3]) - 1, f"{found[1]} {found[2]}q")


def _specifications(options: Options, arm: ArmParameters) -> list[Specification]:
    """Return the requested specifications, one for each decay rate that may be tried."""
    from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
    from fuzzyarm.synthesis import Specification
    from fuzzyarm.synthesis.specification import ALPHAS, gamma_for

    rules = 4 if options.rules is None else options.rules
    if rules not in NAMED_RULES:
        raise UsageError(f"--rules {rules} is not available; choose from: {', '.join(map(str, NAMED_RULES))}")
    kept = NAMED_RULES[rules] if options.keep is None else tuple(name for name in options.keep.split(",") if name)
    form = "consistent" if options.theorem is None else options.theorem
    if options.feedforward is not None and form != "paper":
        raise UsageError("--feedforward is for --theorem paper only; leave it out, or add --theorem paper")
    fixed = given(options, Specification) | {"kept": kept, "form": form}

    def at(alpha: float | None) -> Specification:
        gamma = None if options.gamma == "min" else options.gamma
        if options.gamma is None:
            gamma = 1000.0 if form == "paper" else gamma_for(arm, ALPHAS[0] if alpha is None else alpha)
        return Specification(**fixed | {"alpha": alpha, "gamma": gamma})

    if options.alpha is not None:
        return [at(None if options.alpha == "max" else options.alpha)]
    rates = ALPHAS if form == "consistent" else ALPHAS[:1]
    pole = options.fastest_pole
    return [at(alpha) for alpha in rates if pole is None or alpha < pole] or [at(ALPHAS[0])]
