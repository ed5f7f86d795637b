"""What the processes of commands have loaded before they begin."""

import importlib

__all__: list[str] = []

_NAMES = (
    "fuzzyarm.cli", "fuzzyarm.cli._commands.train", "fuzzyarm.eval.dataset.store", "fuzzyarm.eval.evaluation.figures",
    "fuzzyarm.eval.evaluation.run", "fuzzyarm.eval.report.page", "fuzzyarm.eval.stability.margins",
    "fuzzyarm.eval.sweep._figures", "fuzzyarm.eval.sweep.run", "fuzzyarm.eval.tuning.run", "fuzzyarm.export.c_files",
    "fuzzyarm.export.fmu", "fuzzyarm.export.onnx_file", "fuzzyarm.identification.result",
    "fuzzyarm.policies.tip_files", "fuzzyarm.rl_baselines.training", "fuzzyarm.synthesis", "minari",
    "stable_baselines3",
)  # fmt: skip
for _name in _NAMES:
    importlib.import_module(_name)

from fuzzyarm import run_episode  # noqa: E402

run_episode("fuzzy-1")  # which reads the machine code
