"""Classical laws tuned on the learners' own reward and training distribution, with more simulated time than a training.

    python benchmarks/classical_on_reward.py [--json FILE] [--share S]

Reward and distribution are those of ``ppo-robust`` and ``ppo-residual``: the reward sharpened at 0.3 mm; random plants,
loads, noise and references of ``randomisation="robust"``, as many at a time. The budget of each law is 24000 simulated
seconds, twice what a training of ``ppo-residual`` took and four times that of ``ppo-robust``. What is tuned: of
``fuzzy-4-tip`` alpha, gamma and the fastest pole of its design, so that it stays proven; of ``elastic-observer`` its
four weights. Both begin with a Sobol set around what is shipped and go on with Nelder-Mead from its best points.
Margins are no part of the reward, here as there: they are measured afterwards. Cases 2 and 3 play no part; they are
only reported.

An episode's return is the mean reward of its samples, and zero where it ends early. Every candidate meets the same
arms; the returns in the table are of arms drawn from other seeds. Seeded; forty minutes on one core. Searches that FILE
holds with the same budget are not repeated.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import functools
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from fuzzyarm import Specification, certify, load_policy, metrics_of, run_episode
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.scenario.default_reference import reference_family
from fuzzyarm.envs.scenario.randomisation import find_randomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.rl_baselines.algorithms import find_algorithm
from fuzzyarm.rl_baselines.learning_env import sharpened_reward
from fuzzyarm.synthesis.design_problem import DesignProblem, structure_of
from fuzzyarm.synthesis.designer import to_controller

ARM, PERIOD = ArmParameters(), 1e-3  # control period [s]
TRAINING = find_algorithm("ppo").presets["robust"]
BUDGET = 24e3  # simulated seconds
LANES, SEED, HELD_OUT = TRAINING.lanes, 1, (101, 102)
SOBOL, SEARCHES, FIRST_STEP = 32, 2, math.log(1.5)
COMPARED = ("fuzzy-4-tip", "elastic-observer", "ppo-robust", "ppo-residual")


class Spent(Exception):
    """The budget is spent."""


class Law(NamedTuple):
    """What is tuned of a law: the logarithms of positive numbers, around `shipped`, within a factor of `reach`."""

    name: str
    numbers: tuple[str, ...]
    shipped: tuple[float, ...]
    reach: float
    make: Callable[..., Policy]


class Arms:
    """Arms of the training distribution, with the simulated seconds that were spent on them."""

    def __init__(self, seed: int) -> None:
        """Build the batch once."""
        references = reference_family(ARM, TRAINING.references) + (JointReference(),) * TRAINING.circles
        robust = dataclasses.replace(find_randomisation("robust", ARM), references=references)
        self.envs = FuzzyArmVectorEnv(LANES, case="machining", control_period=PERIOD, threads=1, randomisation=robust)
        self.seed, self.seconds = seed, 0.0

    def mean_return(self, policy: Policy) -> tuple[float, int]:
        """Return the mean return of an episode of each arm, and how many episodes ended early."""
        total, steps, completed = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES, dtype=bool)
        for step in episodes(self.envs, policy, self.envs.reset(seed=self.seed)):
            reward = sharpened_reward(
                step.info["tip_error"], step.info["reward_effort"], 1e-3 * TRAINING.tip_error_scale
            )
            total += np.where(step.running, reward, 0.0)
            steps += step.running
            completed |= step.completed
        self.seconds += PERIOD * float(steps.sum())
        return float(np.where(completed, total / steps, 0.0).mean()), int((~completed).sum())


@functools.cache
def _compiled(structure: Specification) -> DesignProblem:
    return DesignProblem(structure, ARM)


def fuzzy(alpha: float, gamma: float, fastest_pole: float) -> Policy:
    """Return the fuzzy law of four rules with these numbers [1/s, rad/(N m), 1/s]; ValueError if there is none."""
    specification = Specification(alpha=alpha, gamma=gamma, fastest_pole=fastest_pole)
    problem = _compiled(structure_of(specification))
    problem.ask(specification)
    controller = to_controller(problem.model, specification, problem.point())
    return TipPolicy(FuzzyPolicy(controller, PERIOD))


def observer(*weights: float) -> Policy:
    """Return the elastic observer with the four weights that are tuned."""
    return ElasticObserverPolicy(ARM, PERIOD, ObserverWeights(*weights))


def laws() -> list[Law]:
    """Return the laws and where their searches begin."""
    design = load_policy("fuzzy-4").controller  # type: ignore[attr-defined]
    weights = [(field.name, getattr(ObserverWeights(), field.name)) for field in dataclasses.fields(ObserverWeights)][
        :4
    ]
    names, values = zip(*weights, strict=True)
    shipped = (design.alpha, design.gamma, design.fastest_pole)
    return [
        Law("fuzzy-4-tip", ("alpha", "gamma", "fastest_pole"), shipped, 4.0, fuzzy),
        Law("elastic-observer", names, values, 10.0, observer),
    ]


def tuned(law: Law, budget: float) -> tuple[Policy, dict[str, Any]]:
    """Return the best policy found within a budget of simulated seconds, and how it was found."""
    arms, best, tries = Arms(SEED), (-math.inf, np.array(law.shipped)), 0

    def cost(logarithms: np.ndarray) -> float:
        nonlocal best, tries
        if arms.seconds >= budget:
            raise Spent
        tries, numbers = tries + 1, np.exp(logarithms)
        try:
            found = arms.mean_return(law.make(*numbers))[0]
        except ValueError:  # no such design, or no finite torque
            return 1.0
        if found > best[0]:
            best = found, numbers
            print(f"{law.name}: {tries} tries, {arms.seconds:.0f} s, return {found:.4f} at {numbers}", flush=True)
        return -found

    begin, centre = time.perf_counter(), np.log(law.shipped)
    points = qmc.Sobol(len(centre), seed=SEED).random(SOBOL)
    starts = [centre, *(centre + math.log(law.reach) * (2.0 * points - 1.0))]
    with contextlib.suppress(Spent):
        for number, start in enumerate(sorted(starts, key=cost)[:SEARCHES]):
            simplex = start + np.vstack([np.zeros(len(centre)), FIRST_STEP * np.eye(len(centre))])
            left = (budget - arms.seconds) / (arms.seconds / tries) / (SEARCHES - number)
            options = {"initial_simplex": simplex, "maxfev": int(left) + 1}
            minimize(cost, start, method="Nelder-Mead", options=options)
    how = {
        "tries": tries,
        "simulated_s": arms.seconds,
        "wall_s": time.perf_counter() - begin,
        "return_on_tuning_arms": best[0],
        "numbers": dict(zip(law.numbers, map(float, best[1]), strict=True)),
        "shipped": dict(zip(law.numbers, law.shipped, strict=True)),
    }
    return law.make(*best[1]), how


def measured(name: str, policy: Policy) -> dict[str, Any]:
    """Return what a policy gets on held-out arms and in the cases, and its margins."""
    held_out = [Arms(seed).mean_return(policy) for seed in HELD_OUT]
    runs = {case: metrics_of(run_episode(policy, case)) for case in PAPER_CASES}
    period = policy.action_period  # over which the loop of a learned policy is one map
    slower = policy if period == PERIOD else load_policy(name, control_period=period)
    margins = policy_margins(slower, ARM, period)
    return {
        "policy": name,
        "return": float(np.mean([value for value, _ in held_out])),
        "lost": int(sum(lost for _, lost in held_out)),
        "episodes": LANES * len(HELD_OUT),
        "cases": {case: [run["tip_error_rms_mm"], run["tip_error_max_mm"]] for case, run in runs.items()},
        "spectral_radius": margins["spectral_radius"],
    }


def searches_of(path: Path | None, budget: float) -> dict[str, Any]:
    """Return the searches that a result holds, with the commit of each; none of another budget."""
    known = json.loads(path.read_text(encoding="utf-8")) if path and path.is_file() else {}
    if known.get("budget_s") != budget:
        return {}
    made = {"commit": known["commit"], "cpu": known["machine"]["cpu"]}
    return {name: {**made, **how} for name, how in known["searches"].items()}


def main() -> None:
    """Tune both, measure them beside what is shipped, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    parser.add_argument("--share", type=float, default=1.0, help="of the budget (default: 1)")
    options = parser.parse_args()
    rows = [measured(name, load_policy(name)) for name in COMPARED]
    searches = searches_of(options.json, options.share * BUDGET)
    for law in laws():
        if law.name in searches:
            policy = law.make(*searches[law.name]["numbers"].values())
        else:
            policy, searches[law.name] = tuned(law, options.share * BUDGET)
        rows.append(measured(f"{law.name}, tuned on the reward", policy))
        if isinstance(policy, TipPolicy):
            searches[law.name]["proven"] = certify(policy.law.controller).proven  # type: ignore[attr-defined]
    for row in rows:
        cells = ", ".join(f"{case} {rms:.4g} / {largest:.4g}" for case, (rms, largest) in row["cases"].items())
        print(
            f"{row['policy']}: return {row['return']:.4f}, {row['lost']} of {row['episodes']} ended early; {cells} mm"
        )
    if options.json:
        document = {
            "command": "python benchmarks/classical_on_reward.py",
            **current_provenance(),
            "budget_s": options.share * BUDGET,
            "searches": searches,
            "rows": rows,
        }
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
