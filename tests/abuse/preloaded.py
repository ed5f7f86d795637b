"""What the processes of commands have loaded before they begin."""

import importlib

__all__: list[str] = []

for _name in (
    "fuzzyarm.cli",
    "fuzzyarm.eval.evaluation.run",
    "fuzzyarm.eval.evaluation.figures",
    "fuzzyarm.eval.sweep.run",
    "fuzzyarm.eval.sweep.figures",
    "fuzzyarm.rl_baselines.progress",
    "fuzzyarm.rl_baselines.training",
    "fuzzyarm.synthesis",
    "fuzzyarm.eval.report.page",
    "stable_baselines3",
):
    importlib.import_module(_name)
