"""Arms that are not the paper's, from their parameters to the comparison: tuned, with margins, evaluated.

    python benchmarks/own_arms.py [--arms NAME...] [--folder DIR] [--jobs N] [--json FILE]

Each arm is tuned into a folder of its own and evaluated in the three cases with its scaled loads. With --folder the
folders are kept, and what is finished there is not done again. Two minutes an arm, on two cores.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from measuring import options_of, printed, write

from fuzzyarm.common.console import progress
from fuzzyarm.envs.physics.equations import AnyArm, chosen_arm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate
from fuzzyarm.eval.tuning.run import begin, resumed_arm, tune
from fuzzyarm.policies import policies_of

ARMS: dict[str, AnyArm] = {
    "soft": ArmParameters(length=(0.5, 0.4), stiffness=(8e3, 5e3)),
    "long": ArmParameters(length=(0.6, 0.45), stiffness=(3e4, 6e3)),
    "planar-3r": chosen_arm("planar-3r", None),
}
"""By name: the arm of the tutorial; a longer one, half as stiff as Table 1; and three joints."""


def tuned(name: str, folder: Path, jobs: int | None) -> dict[str, Any]:
    """Return the row of an arm, which is tuned into a folder."""
    arm = ARMS[name]
    if folder.is_dir():
        resumed_arm(folder, arm)
    else:
        folder.mkdir(parents=True)
        begin(arm, folder)
    made = tune(arm, folder, engine=Engine(jobs=jobs), bar=progress, finished=print)
    parameters = {"parameters": arm} if isinstance(arm, ArmParameters) else {"robot": arm}
    config = EvaluationConfig(policies=policies_of(str(folder)) or (), **parameters)
    rows = evaluate(config).rows
    return {
        "arm": name,
        "decisions": {finding.policy: finding.chosen for finding in made.findings},
        "tried": {finding.policy: finding.tried for finding in made.findings},
        "spectral_radius": {row["policy"]: row["spectral_radius"] for row in made.margins["rows"]},
        "loop_gain": {row["policy"]: row["loop_gain"] for row in made.margins["rows"]},
        "titles": config.titles,
        "results": [
            {key: row[key] for key in ("case", "policy", "completed", "tip_error_max_mm", "tip_error_rms_mm")}
            for row in rows
        ],
    }


def main() -> None:
    """Tune, evaluate, print and optionally write."""
    parser = options_of(__doc__)
    parser.add_argument("--folder", type=Path, metavar="DIR", help="keep the folders of the arms here")
    parser.add_argument("--jobs", type=int, metavar="N", help="number of processes (default: one per core)")
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS), help="which (default: all)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        rows = printed(tuned(arm, (options.folder or Path(name)) / arm, options.jobs) for arm in options.arms)
    chosen = "" if options.arms == list(ARMS) else f" --arms {' '.join(options.arms)}"
    write(options.json, f"own_arms.py{chosen}", rows=rows)


if __name__ == "__main__":
    main()
