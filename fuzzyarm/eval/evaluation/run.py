"""Run every policy in every case with every seed, and write the results."""

import dataclasses
import json
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import choice, distinct, instance, interval, path_of, real, reals, whole
from fuzzyarm.common.files import csv_text, write_atomically
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.periods import checked_period
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of, chosen_arm
from fuzzyarm.envs.physics.parameters import LARGEST, ArmParameters
from fuzzyarm.envs.physics.robot import Robot, robot_named, shipped_robots
from fuzzyarm.envs.scenario.cases import PAPER_CASES, Case, case_for, find_case, with_loads
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.envs.scenario.paths import SHAPES
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.eval.declarations import declarations_of, written_declarations
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import Rollout, record_passes
from fuzzyarm.eval.episodes.rollout_file import digest
from fuzzyarm.eval.provenance import json_text, made_now
from fuzzyarm.eval.stability._linearisation import remark_on
from fuzzyarm.policies import COMPARED, PolicySpec, recorded, resolve_all
from fuzzyarm.policies.declared import Declared
from fuzzyarm.proof.policy_certificate import certificate_of

__all__ = ["SCHEMA", "Evaluation", "EvaluationConfig", "evaluate", "row_of", "write_results"]

SCHEMA = "fuzzyarm-evaluation/1"  # of results.json


@dataclasses.dataclass(frozen=True)
class EvaluationConfig:
    """The configuration of an evaluation.

    `robot` may also be given as a name, a file or the parameters of a two-joint arm; the field is then the robot, or
    None for a two-joint arm, which becomes `parameters`.
    """

    policies: tuple[str, ...] = COMPARED  # names, files, folders or code, see `fuzzyarm.policies.spec`
    cases: tuple[str, ...] = PAPER_CASES  # names
    seeds: int = 1  # number of episodes of each policy in each case, seeded 0, 1, ...
    encoder_noise: tuple[float, float] = (0.0, 0.0)  # standard deviation on motor angles [rad] and velocities [rad/s]
    control_period: float = 1e-3  # time between two actions [s]
    # The two-joint arm, for the plant and for the policies' models, and another robot in its place.
    parameters: ArmParameters = dataclasses.field(default_factory=ArmParameters)
    robot: Robot | None = None
    path: str = "circle"  # name of the path of the tip, see `default_reference`
    points: GivenPath | None = None  # a path given by points, instead of `path`
    force: tuple[float, float] | None = None  # smallest and largest machining force [N]; None: scaled, see `cases`
    payload: float | None = None  # carried mass [kg]; None: scaled, see `cases`
    passes: int = 1  # episodes one after the other, of which the last counts; policies may learn in between

    def __post_init__(self) -> None:
        """Check names and numbers before anything runs."""
        distinct("policies", self.policies)
        distinct("cases", self.cases)
        for case in self.cases:
            find_case(case)
        whole("seeds", self.seeds, low=1)
        whole("passes", self.passes, low=1, high=1000)
        EncoderNoise(*reals("encoder_noise", self.encoder_noise, 2))
        checked_period("control_period", self.control_period)
        instance("parameters", self.parameters, ArmParameters)
        if self.robot is not None:
            arm = chosen_arm(self.robot, None)
            two_joints = isinstance(arm, ArmParameters)
            object.__setattr__(self, "parameters", arm if two_joints else self.parameters)
            object.__setattr__(self, "robot", None if two_joints else arm)
        choice("path", self.path, tuple(SHAPES))
        if self.points is not None:
            instance("points", self.points, GivenPath)
        if self.force is not None:
            interval("force", self.force, "N", low=0.0, high=LARGEST)
        if self.payload is not None:
            real("payload", self.payload, "kg", above=0.0, high=LARGEST)
        if self.seeds > 1 and not any(self.encoder_noise):
            raise ValueError(
                f"seeds = {self.seeds} would repeat one run, because no encoder noise is set; use seeds = 1"
            )

    @property
    def arm(self) -> AnyArm:
        """The arm that is evaluated: the robot, or else the two-joint arm."""
        return self.parameters if self.robot is None else self.robot

    @property
    def arm_in_words(self) -> str:
        """The arm in words: a robot with its digest, or the parameters that differ from Table 1 of the paper."""
        if self.robot is not None:
            return f"{self.robot.name}, {len(self.robot)} joints, digest {self.robot.digest}"
        paper, own = ArmParameters().to_dict(), self.parameters.to_dict()
        changed = {name: value for name, value in own.items() if value != paper[name]}
        same = ", ".join(name for name in paper if name not in changed) or "nothing"
        return f"{json.dumps(changed)}; as in Table 1 of the paper: {same}" if changed else "Table 1 of the paper"

    @property
    def titles(self) -> dict[str, str]:
        """The titles of the cases by name, with the loads for this arm."""
        return {case: self.case(case, None).title for case in self.cases}

    def reference(self) -> Reference:
        """Return the reference motion.

        Raises:
            ValueError: the arm cannot follow it.
        """
        return default_reference(self.arm, self.path) if self.points is None else self.points.reference(self.arm)

    def case(self, name: str, duration: float | None) -> Case:
        """Return the case `name` for this arm; `force` and `payload`, if set, replace its loads.

        Its machining force, if scaled, lasts `duration` [s]; None: as long as in the case.
        """
        case = case_for(name, self.arm)
        if (self.force, self.payload) == (None, None) and (duration is None or not case.scales):
            return case
        return with_loads(case, force=self.force, payload=self.payload, duration=duration if case.scales else None)

    def command(self, *, placeholders: bool = False) -> str | None:
        """Return the command line of this configuration; None if no option can express its arm or path.

        With `placeholders` the word FILE stands for the file of such an arm or of a path given by points. Policies are
        named as in results files, see `policies.recorded`.
        """
        default = EvaluationConfig()
        words, files = ["fuzzyarm", "evaluate"], []
        if (
            self.robot is not None
            and self.robot.name in shipped_robots()
            and self.robot == robot_named(self.robot.name)
        ):
            words += ["--robot", self.robot.name]
        elif self.robot is not None or self.parameters != default.parameters:
            files += ["--robot", "FILE"]
        if self.points is not None:
            files += ["--path", "FILE"]
        if files and not placeholders:
            return None
        for option, names, usual in (
            ("--policy", [*map(recorded, self.policies)], default.policies), ("--case", self.cases, default.cases)
        ):  # fmt: skip
            words += [word for name in names for word in (option, name)] if tuple(names) != usual else []
        for name in ("seeds", "encoder_noise", "control_period", "path", "force", "payload", "passes"):
            value = getattr(self, name)
            if value != getattr(default, name):
                words += [f"--{name.replace('_', '-')}", *map(str, value if isinstance(value, tuple) else [value])]
        return shlex.join([*words, *files])


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """The outcome of an evaluation: rollouts, a row of metrics for each, certificates by policy, and provenance."""

    config: EvaluationConfig
    rollouts: list[Rollout]
    rows: list[dict[str, Any]]
    certificates: dict[str, str | None]  # in words, `PolicyCertificate.text`
    bounds: dict[str, dict[str, Any] | None]  # in numbers, `PolicyCertificate.bounds`
    made_with: dict[str, Any]
    declared: dict[str, Declared | None]  # what each was chosen for, knows, sees and remembers; None: not declared
    remarks: tuple[str, ...] = ()  # a line about each policy that is at a torque limit for long, or unstable

    @property
    def complete(self) -> bool:
        """Whether every episode followed the reference to its end."""
        return all(run.completed for run in self.rollouts)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the signals, ready for JSON; it contains no absolute path."""
        config = dataclasses.asdict(self.config) | {
            "policies": tuple(map(recorded, self.config.policies)),
            "parameters": self.config.parameters.to_dict(),
        }
        for name, default in {"robot": None, "points": None, "force": None, "payload": None, "passes": 1}.items():
            if config[name] == default:
                del config[name]
        return {
            "schema": SCHEMA,
            "config": config,
            "arm": self.config.arm_in_words,
            **self.made_with,
            "rollouts_sha256": digest(self.rollouts),
            "certificates": self.certificates,
            "certified_bounds": self.bounds,
            "declared": written_declarations(self.declared),
            "results": self.rows,
        }


def evaluate(config: EvaluationConfig, progress: Callable[[], None] = lambda: None) -> Evaluation:
    """Run every policy in every case; `progress` is called after each episode.

    Raises:
        ValueError: a policy is unknown or fails, or the policy or the reference does not fit the robot.
        OSError: a controller file cannot be read.
    """
    specs = resolve_all(instance("config", config, EvaluationConfig).policies, run_code=True)
    policies = {label: _loaded(spec, config, label) for label, spec in specs.items()}
    declarations = declarations_of(specs, policies, config.arm, config.passes)
    reference: Any = config.reference()
    noise = EncoderNoise(*config.encoder_noise) if any(config.encoder_noise) else None
    rollouts, rows = [], []
    for case in config.cases:
        env = FuzzyArmEnv(
            disturbance=dataclasses.replace(config.case(case, reference.duration).disturbance, encoder_noise=noise),
            reference=reference,
            parameters=config.parameters if config.robot is None else None,
            robot=config.robot,
            control_period=config.control_period,
        )
        for name, policy in policies.items():
            for seed in range(config.seeds):
                try:
                    runs = record_passes(env, policy, config.passes, policy_name=name, case=case, seed=seed)
                except ValueError as error:  # its action was refused, or it failed
                    raise ValueError(f"policy {name} in case {case}, seed {seed}: {error}") from error
                rollouts.append(dataclasses.replace(runs[-1], seed=seed))
                rows.append(row_of(rollouts[-1], runs))
                progress()
    proofs = {name: certificate_of(policy, reference) for name, policy in policies.items()}
    certificates = {name: None if proof is None else proof.text for name, proof in proofs.items()}
    bounds = {name: None if proof is None else proof.bounds for name, proof in proofs.items()}
    made_with = made_now(config.command()) | {"policy_files": {label: spec.files() for label, spec in specs.items()}}
    remarks = (
        remark_on(name, policy, config.arm, config.control_period, _saturated(rollouts, name, config.arm))
        for name, policy in policies.items()
    )
    lines = tuple(filter(None, remarks))
    return Evaluation(config, rollouts, rows, certificates, bounds, made_with, declarations, lines)


def _saturated(rollouts: Sequence[Rollout], name: str, arm: AnyArm) -> float:
    """Return the fraction [1] of a policy's control steps in which a motor is at its torque limit."""
    limit = bounds_of(arm).torque
    return float(np.mean(np.concatenate([(abs(r.torque) >= limit).any(axis=1) for r in rollouts if r.policy == name])))


def row_of(run: Rollout, passes: Sequence[Rollout] = ()) -> dict[str, Any]:
    """Return the row of results of an episode; with several passes, it also has the tip errors of each pass."""
    row = {name: getattr(run, name) for name in ("case", "policy", "seed", "completed", "reason")}
    row |= metrics_of(run) | ({"note": run.note} if run.note else {})
    if len(passes) > 1:
        for number, earlier in enumerate(passes, start=1):
            row[f"pass_{number}_max_mm"] = 1e3 * float(earlier.tip_error.max())
            row[f"pass_{number}_rms_mm"] = 1e3 * float(np.sqrt(np.mean(np.square(earlier.tip_error))))
    return row


def _loaded(spec: PolicySpec, config: EvaluationConfig, label: str) -> Any:
    """Return the policy of `spec` for the arm of `config`; ValueError, naming `label`, if it supports no such arm."""
    arm: Any = config.arm
    try:
        return spec.load(config.control_period, arm)
    except TypeError as error:
        if config.robot is None:
            raise
        raise ValueError(
            f"policy {label} supports only the two-joint arm, not {config.robot.name}: leave it out, or evaluate "
            "without a robot"
        ) from error


def write_results(evaluation: Evaluation, folder: str | Path) -> list[Path]:
    """Write ``results.json`` and ``results.csv`` into a folder, each whole or not at all; return their paths."""
    document, folder = instance("evaluation", evaluation, Evaluation).to_dict(), path_of("folder", folder)
    texts = {folder / "results.json": json_text(document), folder / "results.csv": csv_text(evaluation.rows)}
    for path, text in texts.items():
        write_atomically(path, text)
    return list(texts)
