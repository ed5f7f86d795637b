"""A proven bound on the tip error: the claim, the search for a proof, and the statement of the result."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fuzzyarm.common.arithmetic import at_most
from fuzzyarm.common.checks import choice, instance, real, whole
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.default_reference import LONGEST, default_reference
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.policies.spec import load_policy
from fuzzyarm.proof.tip.centre import Segment
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.period import TubeClaim
from fuzzyarm.proof.tip.plant import SETS, BallPlant, PlantSet, check_set_name, exactly
from fuzzyarm.proof.tip.sampled_law import SampledLaw
from fuzzyarm.proof.tip.tube import Problem, Step, Tube
from fuzzyarm.proof.tip.zonotope import SOURCES

__all__ = [
    "PATHS", "PERIOD", "TipBound", "TipClaim", "arm_in_words", "find_bound", "own_duration", "plain", "problem_of",
    "two_joint_arm",
]  # fmt: skip

PATHS = ("circle", "lemniscate")  # paths of the tip by name: the paper's circle, and an eight of the same width
PERIOD = 1e-3  # control period [s], the environment's own


@dataclasses.dataclass(frozen=True)
class TipClaim:
    """The law, motion and set of plants for which a bound is claimed.

    Attributes:
        policy: name of the policy.
        case: name of the case, whose payload and tip force act.
        set_name: label of the set for its user, see `check_set_name`; results do not depend on it.
        plants: the set.
        path: one of `PATHS`.
        duration: of the motion [s].
        steps: number of control steps of the motion that are bounded; None for all.
    """

    policy: str
    case: str = "nominal"
    set_name: str = dataclasses.field(default="", compare=False)
    plants: PlantSet = SETS["table-1"]
    path: str = "circle"
    duration: float = 1.5
    steps: int | None = None

    def __post_init__(self) -> None:
        """Check every field except the names of policy and case; ValueError names the field and allowed values."""
        for name, kind in (("policy", str), ("case", str), ("set_name", str), ("plants", PlantSet)):
            instance(name, getattr(self, name), kind)
        object.__setattr__(self, "set_name", self.set_name or _known(self.plants) or "own")
        check_set_name(self.set_name, self.plants)
        choice("path", self.path, PATHS)
        real("duration", self.duration, "s", low=PERIOD, high=LONGEST)
        if self.steps is not None:
            whole("steps", self.steps, low=1, high=math.ceil(self.duration / PERIOD - 1e-9))

    def reference(self, arm: ArmParameters) -> JointReference:
        """Return the motion: the arm's default reference along the path, in the claimed duration."""
        reference = default_reference(arm, self.path)
        assert isinstance(reference, JointReference)
        return dataclasses.replace(reference, duration=self.duration)

    def motion(self, count: int) -> str:
        """Return start, samples, path and case in words, of a bound of `count` samples."""
        total = math.ceil(self.duration / PERIOD - 1e-9)
        samples = f"every one of {total} samples" if count == total else f"the first {count} of {total} samples"
        along = f"of the {self.path} in {exactly(self.duration)} s, case {self.case}"
        return f"at {samples} {along}, from rest with the links on the path"

    def named_set(self, arm: ArmParameters) -> str:
        """Return the name in `SETS` of the set, else its ranges in words; `arm` is the one in its middle."""
        if self.plants == PlantSet() and arm != ArmParameters():
            return "of one plant"
        return _known(self.plants) or f"with {self.plants.in_words()}"


def _known(plants: PlantSet) -> str | None:
    return next((name for name, known in SETS.items() if known == plants), None)


@dataclasses.dataclass(frozen=True)
class TipBound:
    """A proven bound on the tip error."""

    claim: TipClaim  # for which it is proven
    arm: ArmParameters  # in the middle of the set
    tip: np.ndarray  # bound of the tip error at the end of each control step [m]
    # of each of these, the share of each of `SOURCES`, of the uncertain constants and of the centre [m]
    sources: np.ndarray
    steps: tuple[Step, ...]  # the tube; empty if it was not kept
    seconds: float  # duration of the proof

    @property
    def largest(self) -> float:
        """The bound on the tip error over all samples [m]."""
        return float(self.tip.max())

    def spent(self) -> dict[str, float]:
        """Return the contributions of all sources to the largest bound [m], by name."""
        names = [*SOURCES, "uncertain constants", "centre"]
        return dict(zip(names, self.sources[int(self.tip.argmax())].tolist(), strict=True))

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        c, sample = self.claim, int(self.tip.argmax()) + 1
        about = {"policy": c.policy, "case": c.case, "set": c.named_set(self.arm), "path": c.path}
        found = {"duration": c.duration, "proven": True, "bound": self.largest, "sample": sample}
        return {**about, **found, "samples": len(self.tip), "spent": self.spent(), "seconds": self.seconds}

    def to_text(self) -> str:
        """Return the result as text."""
        c, found = self.claim, self.to_dict()
        small = 1e-3 * self.largest
        parts = ", ".join(f"{name} {at_most(1e3 * x, 4)}" for name, x in found["spent"].items() if x > small)
        return (
            f"{plain(c.policy)}: the tip error is at most {at_most(1e3 * self.largest, 4)} mm for set {found['set']} "
            f"({arm_in_words(self.arm)})\n  {c.motion(len(self.tip))}: PROVEN in {self.seconds:.0f} s\n"
            f"  largest at t = {PERIOD * found['sample']:.3f} s; made of, in mm: {parts}"
        )


def plain(name: str) -> str:
    """Return a name or path in ASCII, with other letters escaped, since some look alike."""
    return ascii(name)[1:-1]


def arm_in_words(arm: ArmParameters) -> str:
    """Return an arm in words: Table 1's, or one with all the numbers that differ from Table 1."""
    own = {f: getattr(arm, f.name) for f in dataclasses.fields(arm) if getattr(arm, f.name) != f.default}
    numbers = ", ".join(f"{f.name} = {value} {f.metadata['unit']}" for f, value in own.items())
    return f"an arm with {numbers} instead of Table 1's" if own else "the arm of Table 1"


def own_duration(policy: str) -> float:
    """Return the duration [s] of the default circle of a policy's arm, 1.5 s for the arm of Table 1."""
    return default_reference(load_policy(policy, control_period=PERIOD).parameters).duration


def two_joint_arm(policy: Policy) -> ArmParameters:
    """Return the arm of a policy; `NoBound` unless it is a two-joint arm."""
    parameters = policy.parameters
    if not isinstance(parameters, ArmParameters):
        raise NoBound(f"there is no bound for a robot of {len(parameters)} joints; choose the two-joint arm")
    return parameters


def problem_of(claim: TipClaim, policy: Policy | None = None) -> Problem:
    """Return the problem that proves a claim; `policy` replaces the one of the claim's name, for one without a name."""
    policy = load_policy(claim.policy, control_period=PERIOD) if policy is None else policy
    parameters = two_joint_arm(policy)
    case, reference = case_for(claim.case, parameters), claim.reference(parameters)
    schedule = Schedule.build(reference, case.disturbance, PERIOD, axes=2)
    if claim.steps is not None:
        schedule = dataclasses.replace(schedule, table=schedule.table[: claim.steps + 1])
    if case.disturbance.torque_bias is not None or case.disturbance.encoder_noise is not None:
        raise NoBound(f"case {claim.case}: a torque bias or Gaussian noise of the encoders has no bound here")
    plant = BallPlant.of(parameters, case.disturbance, claim.plants)
    law = SampledLaw(policy, schedule.references)
    _, info = FuzzyArmEnv(claim.case, parameters=parameters, reference=reference).reset()
    start = np.concatenate([info[name] for name in ("q_motor", "q_link", "dq_motor", "dq_link")])
    return Problem(parameters, start, schedule, PERIOD, law, claim.plants, plant)


def find_bound(
    claim: TipClaim,
    advance: Callable[[], object] = lambda: None,
    claims: Sequence[Sequence[tuple[Segment, TubeClaim]]] | None = None,
    policy: Policy | None = None,
) -> TipBound:
    """Return a proven bound for a claim.

    Args:
        claim: the claim to prove.
        advance: called after each control step.
        claims: tubes of a file, to be confirmed; None to search for them.
        policy: the policy object if it has no name; None to load it by the claim's name.

    Raises:
        NoBound: there is no bound; the message says when and why it fails.
        ValueError: a name is unknown, or the case's tip force or payload does not fit the arm.
    """
    begin = time.perf_counter()
    problem = problem_of(instance("claim", claim, TipClaim), policy)
    steps: list[Step] = []
    try:
        with np.errstate(all="ignore"):  # what is too large is no number, and fails each check
            for step in Tube(problem, claims):
                steps.append(step)
                advance()
    except (ValueError, ArithmeticError) as error:
        raise NoBound(f"{plain(claim.policy)}: no bound beyond t = {PERIOD * len(steps):.3f} s: {error}") from None
    tip, sources = np.array([s.tip for s in steps]), np.array([s.sources for s in steps])
    return TipBound(claim, problem.parameters, tip, sources, tuple(steps), time.perf_counter() - begin)
