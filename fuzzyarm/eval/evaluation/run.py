"""Policies x cases x seeds -> rollouts, one row of metrics each, and files."""

from __future__ import annotations

import csv
import dataclasses
import datetime
import io
import json
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import CASES, find_case
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.envs.scenario.elastic_reference import ElasticReference
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.metrics import metrics
from fuzzyarm.eval.episodes.rollout import Predictor, Rollout, rollout
from fuzzyarm.eval.episodes.rollout_file import digest
from fuzzyarm.eval.provenance import provenance
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy, tip_statement
from fuzzyarm.fuzzy_policy.proof.certificate import statement
from fuzzyarm.policies import COMPARED, resolve_all

SCHEMA = "fuzzyarm-evaluation/1"


@dataclasses.dataclass(frozen=True)
class EvaluationConfig:
    """What is run.

    Attributes:
        policies: names, files, folders or code, see `fuzzyarm.policies.spec`.
        cases: names of cases.
        seeds: number of episodes of each policy in each case, seeded 0, 1, ...
        encoder_noise: standard deviation on motor angles [rad] and velocities [rad/s].
        control_period: [s].
        parameters: the arm, of the plant and of the policies' models.
    """

    policies: tuple[str, ...] = COMPARED
    cases: tuple[str, ...] = tuple(CASES)
    seeds: int = 1
    encoder_noise: tuple[float, float] = (0.0, 0.0)
    control_period: float = 1e-3
    parameters: ArmParameters = dataclasses.field(default_factory=ArmParameters)

    def __post_init__(self) -> None:
        """Check names and numbers before anything runs."""
        for case in self.cases:
            find_case(case)
        for name in ("policies", "cases"):
            given = getattr(self, name)
            if not given or len(set(given)) != len(given):
                raise ValueError(f"{name} = {list(given)} must be one or more different names")
        if self.seeds < 1:
            raise ValueError(f"seeds = {self.seeds} is out of range; allowed: [1, inf)")
        if self.seeds > 1 and not any(self.encoder_noise):
            raise ValueError(
                f"seeds = {self.seeds} would repeat one and the same run: nothing is random without encoder noise"
            )

    def command(self) -> str | None:
        """Return the command line of this configuration; None for an arm or control period that no option names."""
        default = EvaluationConfig()
        if (self.parameters, self.control_period) != (default.parameters, default.control_period):
            return None
        words = ["fuzzyarm", "evaluate"]
        if self.policies != default.policies:
            words += [word for policy in self.policies for word in ("--policy", policy)]
        if self.cases != default.cases:
            words += [word for case in self.cases for word in ("--case", case)]
        if self.seeds != default.seeds:
            words += ["--seeds", str(self.seeds)]
        if any(self.encoder_noise):
            words += ["--encoder-noise", *map(repr, self.encoder_noise)]
        return shlex.join(words)


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """The outcome: rollouts, one row of metrics for each, certificates by policy, and what it was made with.

    `certificates` are in words; `bounds` are their numbers and the controller file they are of, see `certified_bounds`.
    """

    config: EvaluationConfig
    rollouts: list[Rollout]
    rows: list[dict[str, Any]]
    certificates: dict[str, str | None]
    bounds: dict[str, dict[str, Any] | None]
    made_with: dict[str, Any]

    @property
    def complete(self) -> bool:
        """Whether every episode followed the reference to its end."""
        return all(run.completed for run in self.rollouts)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the signals, ready for JSON."""
        config = dataclasses.asdict(self.config) | {"parameters": self.config.parameters.to_dict()}
        return {
            "schema": SCHEMA,
            "config": config,
            **self.made_with,
            "rollouts_sha256": digest(self.rollouts),
            "certificates": self.certificates,
            "certified_bounds": self.bounds,
            "results": self.rows,
        }


def evaluate(config: EvaluationConfig, progress: Callable[[], None] | None = None) -> Evaluation:
    """Run every policy in every case; `progress` is called after each episode.

    Raises:
        ValueError: a policy is unknown, fails or does not fit the robot, or the reference does not fit it.
        OSError: a controller file cannot be read.
    """
    specs = resolve_all(config.policies, run_code=True)
    policies: dict[str, Predictor] = {
        label: spec.load(config.control_period, config.parameters) for label, spec in specs.items()
    }
    reference = JointReference(parameters=config.parameters)
    noise = EncoderNoise(*config.encoder_noise) if any(config.encoder_noise) else None
    rollouts = []
    for case in config.cases:
        env = FuzzyArmEnv(
            disturbance=dataclasses.replace(CASES[case].disturbance, encoder_noise=noise),
            reference=reference,
            parameters=config.parameters,
            control_period=config.control_period,
        )
        for name, policy in policies.items():
            for seed in range(config.seeds):
                try:
                    rollouts.append(rollout(env, policy, policy_name=name, case=case, seed=seed))
                except ValueError as error:  # its action was refused, or it failed
                    raise ValueError(f"policy {name} in case {case}, seed {seed}: {error}") from error
                if progress:
                    progress()
    rows = [
        {"case": run.case, "policy": run.policy, "seed": run.seed, "completed": run.completed, "reason": run.reason}
        | metrics(run)
        for run in rollouts
    ]
    certificates = {name: certificate_text(policy, reference) for name, policy in policies.items()}
    bounds = {name: certified_bounds(policy, reference) for name, policy in policies.items()}
    made_with = {
        "command": config.command(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        **provenance(),
        "policy_files": {label: spec.files() for label, spec in specs.items()},
    }
    return Evaluation(config, rollouts, rows, certificates, bounds, made_with)


def certified_controller(policy: Predictor) -> Controller | None:
    """Return the controller whose certificate holds for a policy; None without a certificate."""
    if isinstance(policy, FuzzyPolicy):
        return policy.controller
    # The proof of the paper's form is of the reference model in the loop, which a tip policy replaces.
    if isinstance(policy, TipPolicy) and isinstance(policy.law, FuzzyPolicy) and policy.law.controller.form != "paper":
        return policy.law.controller
    return None


def certificate_text(policy: Predictor, reference: JointReference) -> str | None:
    """Return what is proven of a policy on a reference, and what is not; None without a certificate."""
    controller = certified_controller(policy)
    if controller is None:
        return None
    return statement(controller) + (f" {tip_statement(reference)}" if isinstance(policy, TipPolicy) else "")


def certified_bounds(policy: Predictor, reference: JointReference) -> dict[str, Any] | None:
    """Return the proven decay rate [1/s] and L2 gain, the form they are of, and the digest of the controller file."""
    controller = certified_controller(policy)
    if controller is None or (isinstance(policy, TipPolicy) and not _bent_in_box(reference)):
        return None
    return {
        "form": controller.form,
        "alpha": controller.alpha,
        "gamma": controller.gamma,
        "controller_digest": json.loads(controller.to_json())["digest"],
    }


def _bent_in_box(reference: JointReference) -> bool:
    """Return whether the motors of a tip policy stay in the box along a reference; else its certificate is void."""
    try:
        ElasticReference(reference)
    except ValueError:
        return False
    return True


def write_results(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write ``results.json`` and ``results.csv``, each whole or not at all; return their paths."""
    json_path, csv_path = folder / "results.json", folder / "results.csv"
    write_atomically(json_path, json.dumps(evaluation.to_dict(), indent=1) + "\n")
    write_atomically(csv_path, _csv(evaluation.rows))
    return [json_path, csv_path]


def _csv(rows: Sequence[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
