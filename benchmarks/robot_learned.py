"""What was learned for a robot, beside the policy that it shifts: tip errors in the three cases, and stability margins.

    python benchmarks/robot_learned.py ur5 benchmarks/learned/ppo-ur5-* [--json FILE]

Each folder is the ``--out`` of a finished ``fuzzyarm train ppo --robot``. Trainings of one configuration with several
seeds are told apart by the seed. Nothing is chosen here: the last policy of each training counts.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from measuring import options_of, printed, write

from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy
from fuzzyarm.policies import load_policy
from fuzzyarm.rl_baselines._case_evaluation import evaluate_cases

PERIOD = 1e-3  # s
OF_THE_RUN = ("seed", "steps_done", "tensorboard")  # what the seeds of one configuration may differ in


def compared(name: str, folders: list[Path]) -> dict[str, Any]:
    """Return the document of the trainings in some folders for a shipped robot; ValueError if they do not fit."""
    robot, rows, trainings, bases = robot_named(name), [], [], set()
    for folder in folders:
        policy = load_policy(folder / "policy", robot=name)
        if not isinstance(policy, LearnedPolicy):
            raise ValueError(f"{folder} holds no policy of fuzzyarm train ppo")
        bundle = policy.bundle
        bases.add(bundle.action.base)
        trainings.append({key: value for key, value in bundle.training.items() if key not in OF_THE_RUN})
        margins = policy_margins(policy, robot, PERIOD)
        rows.append(
            {
                "policy": f"ppo-{name}",
                "seed": bundle.seed,
                "steps": bundle.training["steps_done"],
                **json.loads((folder / "run.json").read_text()),
                **evaluate_cases(policy, robot),
                "radius": margins["spectral_radius"]["nominal"],
                "radius_half_a_sample_later": margins["spectral_radius"]["half a sample later"],
            }
        )
    if any(training != trainings[0] for training in trainings):
        raise ValueError("the trainings differ in more than the seed; compare one configuration at a time")
    for base in sorted(base for base in bases if base is not None):
        rows.insert(0, {"policy": base, **evaluate_cases(load_policy(base, robot=name), robot)})
    return {
        "robot": name,
        "training": trainings[0],
        "rows": rows,
    }


def main() -> None:
    """Compare, and write the result."""
    parser = options_of(__doc__)
    parser.add_argument("robot")
    parser.add_argument("folders", type=Path, nargs="+")
    given = parser.parse_args()
    (document,) = printed([compared(given.robot, given.folders)])
    write(given.json, f"robot_learned.py {given.robot} {' '.join(map(str, given.folders))}", **document)


if __name__ == "__main__":
    main()
