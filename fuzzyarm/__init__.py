"""FuzzyArm: a two-joint robot arm for tracking tasks, and controllers with machine-checked proofs.

Importing the package registers ``FuzzyArm-v0`` and ``FuzzyArmLearn-v0`` with Gymnasium and loads no heavy module: the
other names below are loaded at their first use.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING

from gymnasium.envs.registration import registry

from fuzzyarm.common.registry import lazily
from fuzzyarm.envs.spec_json import Spec
from fuzzyarm.policies import load_policy

if TYPE_CHECKING:
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.envs.physics.robot import Robot, robot_named
    from fuzzyarm.eval.bench.run import BenchConfig, run_bench
    from fuzzyarm.eval.engine import Engine
    from fuzzyarm.eval.episodes.metrics import metrics_of
    from fuzzyarm.eval.episodes.rollout import Rollout, run_episode
    from fuzzyarm.eval.evaluation.figures import write_figures
    from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate, write_results
    from fuzzyarm.eval.report.page import write_report
    from fuzzyarm.eval.stability.margins import MarginsConfig, measure_margins
    from fuzzyarm.eval.sweep.config import SweepConfig
    from fuzzyarm.eval.sweep.run import Sweep
    from fuzzyarm.eval.tuning.run import tune_arm
    from fuzzyarm.export.c_files import export_c
    from fuzzyarm.export.sheet import sheet_of
    from fuzzyarm.fuzzy_policy.controller import Controller
    from fuzzyarm.fuzzy_policy.ts_model import TSModel
    from fuzzyarm.identification.reading import read_log
    from fuzzyarm.identification.result import identify
    from fuzzyarm.policies import add_policy
    from fuzzyarm.policies.tip_bound import TipClaim, find_bound
    from fuzzyarm.policies.tip_files import save_bound
    from fuzzyarm.proof.certificate import certify
    from fuzzyarm.proof.verification import verify_file
    from fuzzyarm.synthesis import (
        Design,
        DesignFailed,
        DesignProblem,
        ScheduledSpecification,
        Specification,
        design,
        design_scheduled,
    )

__all__ = [
    "ArmParameters",
    "BenchConfig",
    "Controller",
    "Design",
    "DesignFailed",
    "DesignProblem",
    "Engine",
    "EvaluationConfig",
    "MarginsConfig",
    "Robot",
    "Rollout",
    "ScheduledSpecification",
    "Specification",
    "Sweep",
    "SweepConfig",
    "TSModel",
    "TipClaim",
    "__version__",
    "add_policy",
    "certify",
    "design",
    "design_scheduled",
    "evaluate",
    "export_c",
    "find_bound",
    "identify",
    "load_policy",
    "measure_margins",
    "metrics_of",
    "read_log",
    "robot_named",
    "run_bench",
    "run_episode",
    "save_bound",
    "sheet_of",
    "tune_arm",
    "verify_file",
    "write_figures",
    "write_report",
    "write_results",
]
__version__ = version("fuzzyarm")

_HOMES = {
    name: home
    for home, names in {
        "envs.physics.parameters": "ArmParameters",
        "envs.physics.robot": "Robot robot_named",
        "eval.bench.run": "BenchConfig run_bench",
        "eval.engine": "Engine",
        "eval.episodes.metrics": "metrics_of",
        "eval.episodes.rollout": "Rollout run_episode",
        "eval.evaluation.figures": "write_figures",
        "eval.evaluation.run": "EvaluationConfig evaluate write_results",
        "eval.report.page": "write_report",
        "eval.stability.margins": "MarginsConfig measure_margins",
        "eval.sweep.config": "SweepConfig",
        "eval.sweep.run": "Sweep",
        "eval.tuning.run": "tune_arm",
        "export.c_files": "export_c",
        "export.sheet": "sheet_of",
        "fuzzy_policy.controller": "Controller",
        "fuzzy_policy.ts_model": "TSModel",
        "identification.reading": "read_log",
        "identification.result": "identify",
        "policies": "add_policy",
        "policies.tip_bound": "TipClaim find_bound",
        "policies.tip_files": "save_bound",
        "proof.certificate": "certify",
        "proof.verification": "verify_file",
        "synthesis": "Design DesignFailed DesignProblem ScheduledSpecification Specification design design_scheduled",
    }.items()
    for name in names.split()
}
__getattr__ = lazily(__name__, _HOMES)

# The environment itself refuses steps outside an episode and checks actions: Gymnasium's wrappers for that would only
# cost time on every step.
for _id, _single, _batch in (
    ("FuzzyArm-v0", "envs.fuzzy_arm:FuzzyArmEnv", "envs.vector:FuzzyArmVectorEnv"),
    (
        "FuzzyArmLearn-v0",
        "rl_baselines.learning_task:FuzzyArmLearnEnv",
        "rl_baselines.learning_task:FuzzyArmLearnVectorEnv",
    ),
):
    registry[_id] = Spec(
        id=_id,
        entry_point=f"fuzzyarm.{_single}",
        vector_entry_point=f"fuzzyarm.{_batch}",
        order_enforce=False,
        disable_env_checker=True,
    )
