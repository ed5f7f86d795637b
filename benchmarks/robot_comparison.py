"""Everything about one robot: the trade-off of its rules, policies in the three cases, their margins, a sweep.

    python benchmarks/robot_comparison.py ur5 [--plants N] [--rules 1 2 4] [--json FILE]
    python benchmarks/robot_comparison.py panda --friction 10 [--json FILE]

Controllers of the semidefinite form are designed with 1, 2 and 4 rules (two joints: 1 and 2, as they have one premise),
at the default decay rate; γ is also given at the decay rate and the fastest pole of the first. The one with the
smallest certified gain γ [rad/(N m)] joins computed-torque and elastic-observer in the three cases, in the table of
margins and in a sweep of 1,000 plants drawn around the robot. Nothing is tuned on the cases.

With --friction the policies for any robot run in the cases alone: on the robot as it is, and on one whose friction
(static, Coulomb and viscous) is so many times as large. They know the friction of the robot that they run on.
"""

from __future__ import annotations

import dataclasses
import tempfile
import time
from pathlib import Path
from typing import Any

from measuring import options_of, printed, write

from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate
from fuzzyarm.eval.stability.margins import MarginsConfig, measure_margins, policy_margins
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.run import Sweep
from fuzzyarm.fuzzy_policy.laws.scheduled import ScheduledPolicy
from fuzzyarm.fuzzy_policy.scheduled_controller import ScheduledController
from fuzzyarm.policies import ANY_ROBOT
from fuzzyarm.synthesis import ScheduledSpecification, design_scheduled
from fuzzyarm.synthesis._scalar_design import best_feedback

PERIOD = 1e-3  # s
METRICS = ("tip_error_max_mm", "tip_error_rms_mm", "completed")


def gain_at(c: ScheduledController, alpha: float, pole: float) -> float | None:
    """Return γ [rad/(N m)] that the bounds of a controller allow at a decay rate and a fastest pole [1/s], or None.

    The bounds of the inertia are proven with the controller; this feedback is checked in floating point.
    """
    found = best_feedback(c.kappa, alpha + float(c.rates @ c.speeds), pole)
    return None if found is None else found.gamma / c.floor


def designed(robot: Robot, rules: int) -> tuple[ScheduledController, dict[str, Any]]:
    """Return a controller and its row of the trade-off."""
    begin = time.perf_counter()
    found = design_scheduled(ScheduledSpecification(rules=rules), robot)
    seconds, c = time.perf_counter() - begin, found.controller
    row = {
        "rules": c.rules,
        "premises": [premise.name for premise in c.premises],
        "kappa": c.kappa,
        "alpha": c.alpha,
        "fastest_pole": c.fastest_pole,
        "gamma": c.gamma / c.floor,
        **dict(zip(("k_p", "k_d", "k_i"), c.feedback.tolist(), strict=True)),
        "seconds": seconds,
        **policy_margins(ScheduledPolicy(c, PERIOD), robot, PERIOD),
    }
    return c, row


def compare(name: str, rules: list[int] | None, plants: int) -> dict[str, Any]:
    """Return the document of a shipped robot."""
    robot = robot_named(name)
    rules = rules or [1, 2, 4][: len(robot)]
    with tempfile.TemporaryDirectory() as folder:
        designs = [designed(robot, number) for number in rules]
        first = designs[0][1]
        for c, row in designs:
            row["gamma_at_first_pole"] = gain_at(c, first["alpha"], first["fastest_pole"])
        best, row = min(designs, key=lambda pair: float(pair[1]["gamma"]))
        path = Path(folder) / f"fuzzy-{row['rules']}-{name}.json"
        best.save(path)
        policies = (*ANY_ROBOT, str(path), f"{path}-tip")
        evaluation = evaluate(EvaluationConfig(policies=policies, robot=robot))
        margins = measure_margins(MarginsConfig(policies, name))
        config = SweepConfig(policies=policies, robot=robot, plants=plants, chunk=min(plants, 250))
        sweep = Sweep.begin(Path(folder) / "sweep", config)
        for _ in sweep.run(Engine(jobs=1)):
            pass
        swept, _ = sweep.summarise()
    return {
        "robot": name,
        "plants": plants,
        "titles": evaluation.config.titles,
        "tradeoff": [row for _, row in designs],
        "cases": [{key: row[key] for key in ("case", "policy", "seed", *METRICS)} for row in evaluation.rows],
        "margins": margins["rows"],
        "sweep": [{key: value for key, value in row.items() if key != "worst"} for row in swept["rows"]],
        "bound": config.bound,
    }


def with_friction(robot: Robot, factor: float) -> Robot:
    """Return a robot whose motors have a multiple of its friction."""
    joints = []
    for joint in robot.joints:
        names = ("static_friction", "coulomb_friction", "viscous_friction")
        drive = dataclasses.replace(joint.drive, **{name: factor * getattr(joint.drive, name) for name in names})
        joints.append(dataclasses.replace(joint, drive=drive))
    return dataclasses.replace(robot, joints=tuple(joints))


def compare_friction(name: str, factor: float) -> dict[str, Any]:
    """Return the cases of a shipped robot with its own friction, and with a multiple of it."""
    rows = []
    for times in (1.0, factor):
        found = evaluate(EvaluationConfig(policies=ANY_ROBOT, robot=with_friction(robot_named(name), times)))
        rows += [{"friction": times, **{key: row[key] for key in ("case", "policy", *METRICS)}} for row in found.rows]
    return {
        "robot": name,
        "titles": found.config.titles,
        "rows": rows,
    }


def main() -> None:
    """Compare, and write the result."""
    parser = options_of(__doc__)
    parser.add_argument("robot")
    parser.add_argument("--rules", type=int, nargs="+", help="default: 1 2 4; two joints: 1 2")
    parser.add_argument("--plants", type=int, default=1000)
    parser.add_argument("--friction", type=float, help="a multiple of the robot's friction")
    given = parser.parse_args()
    if given.friction is None:
        words, document = f"--plants {given.plants}", compare(given.robot, given.rules, given.plants)
    else:
        words, document = f"--friction {given.friction:g}", compare_friction(given.robot, given.friction)
    write(given.json, f"robot_comparison.py {given.robot} {words}", **printed([document])[0])


if __name__ == "__main__":
    main()
