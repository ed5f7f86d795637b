"""A proven bound on the tip error: the claim, the search for a proof, and the statement of the result."""

import contextlib
import dataclasses
import gc
import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.arithmetic import at_most
from fuzzyarm.common.checks import choice, instance, real, reals, whole
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.equations import AnyArm, argument_of, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot, robot_named, shipped_robots
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.default_reference import LONGEST, default_reference
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.envs.scenario.paths import SHAPES
from fuzzyarm.envs.scenario.reference import PathReference
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.policies.spec import any_guest, load_policy, without_guest
from fuzzyarm.proof.tip.centre import Segment
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.laps import LapSet, StartBox
from fuzzyarm.proof.tip.period import TubeClaim
from fuzzyarm.proof.tip.plant import SETS, BallPlant, PlantSet, check_set_name, exactly
from fuzzyarm.proof.tip.sampled_law import SampledLaw
from fuzzyarm.proof.tip.tube import Problem, Tube, TubeStep
from fuzzyarm.proof.tip.zonotope import SOURCES

__all__ = [
    "PERIOD", "LapClaim", "TipBound", "TipClaim", "arm_in_words", "find_bound", "own_duration", "plain", "problem_of",
]  # fmt: skip

_PATHS = tuple(SHAPES)  # paths of the tip by name
_LAPS, _MOST_LAPS = 3, 5  # laps of references for which the law is prepared; most laps of a search
_CLOSED = 1e-9  # largest difference of the references at both ends of a closed path [rad, ...]
PERIOD = 1e-3  # control period [s], the environment's own


@dataclasses.dataclass(frozen=True)
class TipClaim:
    """The law, motion and set of plants for which a bound is claimed.

    Attributes:
        policy: name of the policy; a guest in a shield is replaced by `ANY_GUEST`, as the proof holds for all.
        case: name of the case, whose payload and tip force act.
        set_name: label of the set for its user, see `check_set_name`; results do not depend on it.
        plants: the set.
        path: one of `_PATHS`.
        duration: duration of the motion [s].
        steps: number of control steps of the motion that are bounded; None for all.
        laps: "one"; or "ever": motion and case are repeated endlessly, and all laps are bounded.
        start: box of initial states of the first lap, about the environment's start; None: this start alone.
        arm: arm for which the policy is loaded; None: the arm that the policy's name implies.
        points: a `GivenPath` that replaces `path`, or None.
    """

    policy: str
    case: str = "nominal"
    set_name: str = dataclasses.field(default="", compare=False)
    plants: PlantSet = SETS["table-1"]
    path: str = "circle"
    duration: float = 1.5
    steps: int | None = None
    laps: str = "one"
    start: StartBox | None = None
    arm: AnyArm | None = None
    points: GivenPath | None = None

    def __post_init__(self) -> None:
        """Check every field except the names of policy and case; ValueError names the field and allowed values."""
        kinds: dict[str, type] = {"policy": str, "case": str, "set_name": str, "plants": PlantSet}
        own: dict[str, type] = {"start": StartBox, "arm": _kind_of(self.arm), "points": GivenPath}
        kinds |= {name: kind for name, kind in own.items() if getattr(self, name) is not None}
        for name, kind in kinds.items():
            instance(name, getattr(self, name), kind)
        object.__setattr__(self, "policy", any_guest(self.policy))
        object.__setattr__(self, "set_name", self.set_name or _known(self.plants) or "own")
        check_set_name(self.set_name, self.plants)
        choice("path", self.path, _PATHS)
        real("duration", self.duration, "s", low=PERIOD, high=LONGEST)
        if self.steps is not None:
            whole("steps", self.steps, low=1, high=self.samples)
        if choice("laps", self.laps, ("one", "ever")) == "ever" and self.steps is not None:
            raise ValueError(f"steps = {self.steps}: laps = ever covers whole laps only; leave out steps or laps")

    @property
    def samples(self) -> int:
        """Number of control steps of a lap."""
        return math.ceil(self.duration / PERIOD - 1e-9)

    def reference(self, arm: AnyArm) -> PathReference:
        """Return the motion: the arm's default reference along the path, in the claimed duration."""
        reference = default_reference(arm, self.path) if self.points is None else self.points.reference(arm)
        assert isinstance(reference, PathReference)
        moved: Any = dataclasses.replace(reference, duration=self.duration)  # type: ignore[type-var]
        return moved  # type: ignore[no-any-return]

    def motion(self, count: int) -> str:
        """Return, in words, the initial states, instants, path and case for which a bound over `count` steps holds."""
        total = self.samples
        steps = f"all {total} control steps" if count == total else f"the first {count} of {total} control steps"
        lap = "a lap" if self.laps == "one" else "every lap, for ever,"
        path = self.path if self.points is None else f"path through {len(self.points.points)} points"
        along = f"of {lap} of the {path} in {exactly(self.duration)} s, case {self.case}"
        rest = "rest with the links on the path"
        start = f"from {rest}" if self.start is None else f"from any state with {self.start.in_words()} about {rest}"
        guest = without_guest(self.policy)[1]
        beside = f", whatever a guest adds to the torques within ± {guest} N m" if guest else ""
        return f"at every instant of {steps} {along}, {start}{beside}"

    def named_set(self, arm: AnyArm) -> str:
        """Return the set's name in `SETS`, else its ranges in words; `arm` is the arm in the middle of the set."""
        if self.plants == PlantSet() and arm != ArmParameters():
            return "of one plant"
        return _known(self.plants) or f"with {self.plants.in_words()}"


def _kind_of(arm: object) -> type:
    return Robot if isinstance(arm, Robot) else ArmParameters


def _known(plants: PlantSet) -> str | None:
    return next((name for name, known in SETS.items() if known == plants), None)


class LapClaim(NamedTuple):
    """A file's claim for a lap: the segments of each control step with their tubes, and the set where it begins."""

    steps: Sequence[Sequence[tuple[Segment, TubeClaim]]]
    begin: LapSet | None = None  # of a later lap; None for the first


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Lap:
    """A proven bound on the tip error of a lap."""

    tip: np.ndarray  # bound on the tip error at the end of each control step [m]
    whole: np.ndarray  # the same at every instant of each control step [m]
    # for each entry of `tip`, the parts due to each of `SOURCES`, the uncertain constants and the centre [m]
    sources: np.ndarray
    steps: tuple[TubeStep, ...]  # the tube; empty if it was not kept
    begin: LapSet | None = None  # set in which a later lap begins


@dataclasses.dataclass(frozen=True, kw_only=True)
class TipBound(_Lap):
    """Proven bounds on the tip error: of the first lap in the fields of `_Lap`, of others in `later`."""

    claim: TipClaim  # the claim for which it is proven
    arm: AnyArm  # the arm in the middle of the set
    seconds: float  # duration of the proof
    later: tuple[_Lap, ...] = ()  # the second lap and so on; the last entry holds for all further laps

    @property
    def all_laps(self) -> tuple[_Lap, ...]:
        """The first lap and the later ones; the last holds for all further laps."""
        return (self, *self.later)

    @property
    def largest(self) -> float:
        """The bound on the tip error at every instant of all laps [m]."""
        return float(max(lap.whole.max() for lap in self.all_laps))

    def worst(self) -> tuple[int, int]:
        """Return the lap and the sample, both from 1, at which the bound at samples is largest."""
        lap = int(np.argmax([lap.tip.max() for lap in self.all_laps]))
        return lap + 1, int(self.all_laps[lap].tip.argmax()) + 1

    def spent(self) -> dict[str, float]:
        """Return the contributions of all sources to the largest bound at a sample [m], by name."""
        lap, sample = self.worst()
        names = [*SOURCES, "uncertain constants", "centre"]
        return dict(zip(names, self.all_laps[lap - 1].sources[sample - 1].tolist(), strict=True))

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        c, (lap, sample) = self.claim, self.worst()
        about = {"policy": c.policy, "case": c.case, "set": c.named_set(self.arm), "path": c.path}
        found = {"duration": c.duration, "proven": True, "bound": self.largest, "lap": lap, "sample": sample}
        laps = [float(one.whole.max()) for one in self.all_laps]
        return {
            **about,
            **found,
            "laps": laps,
            "samples": len(self.tip),
            "spent": self.spent(),
            "seconds": self.seconds,
        }

    def to_text(self) -> str:
        """Return the result as text."""
        c, found = self.claim, self.to_dict()
        small = 1e-3 * self.largest
        parts = ", ".join(f"{name} {at_most(1e3 * x, 4)}" for name, x in found["spent"].items() if x > small)
        laps = [f"lap {n} {at_most(1e3 * x, 4)}" for n, x in enumerate(found["laps"], 1)]
        within = f"\n  at most, in mm: {', '.join(laps)} and all later laps" if self.later else ""
        return (
            f"{plain(c.policy)}: the tip error is at most {at_most(1e3 * self.largest, 4)} mm for set {found['set']} "
            f"({arm_in_words(self.arm)})\n  {c.motion(len(self.tip))}: PROVEN in {self.seconds:.0f} s{within}\n"
            f"  largest error of a sample, at t = {PERIOD * found['sample']:.3f} s; its parts, in mm: {parts}"
        )


def plain(name: str) -> str:
    """Return a name or path in ASCII; other characters are escaped, since some look like ASCII letters."""
    return ascii(name)[1:-1]


def arm_in_words(arm: AnyArm) -> str:
    """Return an arm in words.

    For two joints: the values that differ from the paper's Table 1. For a robot: its name, or a digest if not shipped.
    """
    if isinstance(arm, Robot):
        known = next((name for name in shipped_robots() if robot_named(name).digest == arm.digest), None)
        return f"the robot {known}" if known else f"a robot of {len(arm)} joints, numbers {arm.digest[:16]}"
    own = {f: getattr(arm, f.name) for f in dataclasses.fields(arm) if getattr(arm, f.name) != f.default}
    numbers = ", ".join(f"{f.name} = {value} {f.metadata['unit']}" for f, value in own.items())
    return f"an arm with {numbers} instead of Table 1's" if own else "the arm of Table 1"


def own_duration(policy: str, arm: AnyArm | None, path: str, points: GivenPath | None) -> float:
    """Return the duration [s] that `fuzzyarm evaluate` gives a motion along `points` or, if None, along `path`.

    `arm` None stands for the policy's own arm.
    """
    choice("path", path, _PATHS)
    arm = load_policy(without_guest(policy)[0], control_period=PERIOD, robot=arm).parameters
    return (default_reference(arm, path) if points is None else points.reference(arm)).duration


def problem_of(claim: TipClaim, policy: Policy | None = None) -> Problem:
    """Return the proof problem of a claim; `policy`, which needs no name, replaces the policy that the claim names."""
    law, guest = without_guest(claim.policy)
    policy = load_policy(law, control_period=PERIOD, robot=claim.arm) if policy is None else policy
    parameters, joints = policy.parameters, policy.joints
    case, reference = case_for(claim.case, parameters), claim.reference(parameters)
    schedule = Schedule.build(reference, case.disturbance, PERIOD, equations_of(parameters).axes)
    if claim.steps is not None:
        schedule = dataclasses.replace(schedule, table=schedule.table[: claim.steps + 1])
    if case.disturbance.torque_bias is not None or case.disturbance.encoder_noise is not None:
        raise NoBound(
            f"case {claim.case} has torque bias or Gaussian encoder noise, which no bound covers; choose another case"
        )
    plant = BallPlant.of(parameters, case.disturbance, claim.plants)
    references = schedule.references
    if claim.laps == "ever":
        gap = float(np.abs(references[-1] - references[0]).max())
        if gap > _CLOSED:
            raise ValueError(
                f"laps = ever needs a closed path, but the references at its ends differ by {gap:.3g} (rad, rad/s or "
                f"rad/s²); allowed: at most {_CLOSED}"
            )
        references = np.vstack([references[:-1]] * _LAPS + [references[:1]])
    sampled = SampledLaw(policy, references)
    if claim.laps == "ever" and not sampled.repeats(schedule.steps):
        raise NoBound(
            "this law remembers references for longer than a lap, so its second and third laps differ; choose "
            "laps = one (--laps one)"
        )
    _, info = FuzzyArmEnv(claim.case, reference=reference, **argument_of(parameters)).reset()
    start = np.concatenate([info[name] for name in ("q_motor", "q_link", "dq_motor", "dq_link")])
    if claim.start is not None:
        claim.start.columns(joints, 4 * joints + sampled.memory, sampled.memory)
    margin = reals("margin", guest, joints, "N m", above=0.0) if guest else (0.0,) * joints
    return Problem(parameters, start, reference, schedule, PERIOD, sampled, claim.plants, plant, claim.start, margin)


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """Context without garbage collection, which takes a tenth of a proof's time although a proof makes no cycles."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@_uncollected()
def find_bound(
    claim: TipClaim,
    advance: Callable[[], object] = lambda: None,
    claims: Sequence[LapClaim] | None = None,
    policy: Policy | None = None,
) -> TipBound:
    """Return a proven bound for a claim.

    Args:
        claim: the claim to prove.
        advance: called after each control step.
        claims: the claims of a file for its laps, to be confirmed; None to search for tubes.
        policy: the policy object if it has no name; None to load it by the claim's name.

    Raises:
        NoBound: no bound was found; the message says at which instant and why the proof fails.
        ValueError: a name is unknown, or the case's tip force or payload does not fit the arm.
    """
    begin = time.perf_counter()
    problem = problem_of(instance("claim", claim, TipClaim), policy)
    name, laps, ever = plain(claim.policy), list[_Lap](), claim.laps == "ever"
    start: LapSet | None = None
    for number in range(1, _MOST_LAPS + 1):
        tube = Tube(problem, None if claims is None else claims[number - 1].steps, start)
        laps.append(
            _lap(tube, f"{name}: no bound beyond lap {number}, " if ever else f"{name}: no bound beyond ", advance)
        )
        if not ever:
            break
        last = start is not None and (claims is None or number == len(claims))
        after = start if last else None if claims is None else claims[number].begin
        with np.errstate(all="ignore"):
            filled = math.inf if after is None else tube.state.filled(after)
        if claims is not None and not filled <= 1.0:
            raise NoBound(
                f"{name}: the set in which lap {number} ends is not inside the set in which the next lap begins: its "
                f"relative size is {filled:.4g}; allowed: at most 1"
            )
        if last and filled <= 1.0:
            break
        start = tube.state.around() if claims is None else after
    else:
        raise NoBound(
            f"{name}: the set in which lap {_MOST_LAPS} ends is not inside the set in which this lap begins: its "
            f"relative size is {filled:.4g}; allowed: at most 1"
        )
    if claims is not None and len(claims) != len(laps):
        raise NoBound(f"{name}: the file contains {len(claims)} laps, but the proof needs {len(laps)}")
    first = {field.name: getattr(laps[0], field.name) for field in dataclasses.fields(_Lap)}
    seconds = time.perf_counter() - begin
    return TipBound(**first, claim=claim, arm=problem.parameters, seconds=seconds, later=tuple(laps[1:]))


def _lap(tube: Tube, name: str, advance: Callable[[], object]) -> _Lap:
    """Return a lap's bound, else raise `NoBound`, its message beginning with `name`; call `advance` after each step."""
    steps: list[TubeStep] = []
    try:
        with np.errstate(all="ignore"):  # values that overflow become inf or nan, which fail every check
            for step in tube:
                steps.append(step)
                advance()
    except (ValueError, ArithmeticError) as error:
        raise NoBound(f"{name}t = {PERIOD * len(steps):.3f} s: {error}") from None
    tip, whole, sources = (np.array([getattr(s, name) for s in steps]) for name in ("tip", "whole", "sources"))
    return _Lap(tip=tip, whole=whole, sources=sources, steps=tuple(steps), begin=tube.begin)
