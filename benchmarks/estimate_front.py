"""The front between accuracy and margin of `learned-observer`: how much of its network to use, and what that bears.

    python benchmarks/estimate_front.py [--plants N] [--json FILE]

The residual torque of the shipped network is multiplied by a share s, that is, its output layers V, G and D are: s = 0
is the law without a network, s = 1 the shipped policy. At rest the network is silent and the linear loop is the same
for every s, so the margins are measured in motion. Development plants of `loads`, none of them held out, follow the
reference with torques that arrive late by multiples of half a sample, or with a factor on the torques of both motors
that no law is told of. Per condition: quantiles of the largest and of the rms tip errors, the median change of the
torque per period, and how many episodes fail, that is, end early or err once by more than `FAILED_MM`. Beside that, the
largest tip errors on the two plants of 10,000 of `all` on which the shipped policy errs by most, see `TAIL`; no share
was chosen by them. `elastic-observer` and `adaptive-observer` stand beside.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from learned_observer import ADAPTIVE, BASE, LEARNED
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import TipErrors, episodes
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.episodes import run_plants
from fuzzyarm.eval.sweep.plants import CONTROL_PERIOD, Plants
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.fuzzy_policy.policy import Policy, Predictor

SEED = 50_000  # the first of the development plants, as in `estimate_parts`
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25)
LATENESS = (0.5, 1.0, 1.5, 2.0, 3.0)  # samples
FACTORS = (0.67, 0.8, 1.25, 1.5, 2.0)  # on the torque
LOADED = PAPER_CASES[1:]
QUANTILES = (0.5, 0.9)
FAILED_MM = 15.0
TAIL, TAIL_SEED, TAIL_CASE = (2474, 7660), 200_000, PAPER_CASES[0]
"""The plants whose largest errors are the two largest in `results/learned_all.json`, both two periods late."""
SHOWN = (("3 samples late", 3.0, 1.0), ("torques × 1.5", 0.0, 1.5), ("torques × 2", 0.0, 2.0))  # in the figure


class Channel:
    """A policy at every second call, its torques `late` (lanes,) half samples later and times `factor` (lanes,).

    It is for an environment with half the control period. The first torque acts as if commanded before, too.

    Attributes:
        squares: sum over the periods of the squared change of the policy's torque (lanes,) [N² m²].
    """

    def __init__(self, policy: Predictor, late: np.ndarray, factor: np.ndarray) -> None:
        """Wrap a policy."""
        self._policy, self._late, self._factor = policy, late, factor[:, np.newaxis]
        self._calls, self._lanes, self._depth = 0, np.arange(len(late)), int(late.max()) + 1
        self._begins, self.squares = np.zeros(len(late), dtype=bool), np.zeros(len(late))

    def predict(
        self, observation: np.ndarray, state: Any, episode_start: np.ndarray, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Return the torque that acts now (lanes, 2) [N m], and the state of the policy."""
        self._begins = self._begins | episode_start
        if self._calls % 2 == 0:
            torque, state = self._policy.predict(observation, state, self._begins)
            self._begins = np.zeros_like(self._begins)
            if self._calls == 0:
                self._torque, self._sent = torque, np.repeat(torque[np.newaxis], self._depth, axis=0)
            self.squares += ((torque - self._torque) ** 2).sum(axis=1)
            self._torque = torque
        self._sent[self._calls % self._depth] = self._torque
        arrived = self._sent[(self._calls - self._late) % self._depth, self._lanes]
        self._calls += 1
        return self._factor * arrived, state


# Labels that would cover others, by case and share [points].
ASIDE = {("machining", 0.25): (6, -11), ("machining", 0.5): (-8, -13)}


@dataclasses.dataclass(frozen=True)
class Condition:
    """A case with late torques [samples] and a factor on them."""

    case: str
    late: float = 0.0
    factor: float = 1.0


CONDITIONS = (
    *(Condition(case) for case in PAPER_CASES),
    *(Condition(case, late=late) for late in LATENESS for case in LOADED),
    *(Condition(case, factor=factor) for factor in FACTORS for case in LOADED),
)


def with_share(share: float) -> LearnedObserverPolicy:
    """Return the shipped policy with its network's residual torque times a share."""
    policy = load_policy(LEARNED)
    assert isinstance(policy, LearnedObserverPolicy)
    network = policy.network
    return policy.with_network(
        dataclasses.replace(network, **{name: share * getattr(network, name) for name in ("V", "G", "D")})
    )


def measured(policy: Policy, plants: int) -> list[dict[str, Any]]:
    """Return a row of numbers for each of `CONDITIONS`; null where an episode ended early."""
    config = SweepConfig((BASE,), distribution="loads", plants=plants, seed=SEED)
    drawn, repeats = Plants.draw(config, range(plants)), len(CONDITIONS)
    envs = FuzzyArmVectorEnv(
        repeats * plants,
        case=[one.case for one in CONDITIONS for _ in range(plants)],
        control_period=CONTROL_PERIOD / 2,
        randomisation=config.drawn(),
        threads=1,
    )
    late = np.repeat([round(2 * one.late) for one in CONDITIONS], plants)
    channel = Channel(policy, late, np.repeat([one.factor for one in CONDITIONS], plants))
    errors = TipErrors(envs.num_envs)
    for step in episodes(envs, channel, drawn.begin(envs)):
        errors.add(step)
    lost = ~np.asarray(errors.completed, dtype=bool)
    largest, rms, change = (
        np.where(lost, np.inf, found).reshape(repeats, plants)
        for found in (1e3 * errors.largest, 1e3 * errors.rms, np.sqrt(channel.squares / (errors.steps / 2)))
    )
    return [
        dataclasses.asdict(one)
        | {
            "largest_mm": quantiles_of(largest[k], QUANTILES),
            "rms_mm": quantiles_of(rms[k], QUANTILES),
            "torque_rate": quantiles_of(change[k], (0.5,))[0],
            "failed": int(np.count_nonzero(largest[k] > FAILED_MM)),
            "lost": int(np.count_nonzero(np.isinf(largest[k]))),
        }
        for k, one in enumerate(CONDITIONS)
    ]


def on_tail(policy: Policy) -> list[float | None]:
    """Return the largest tip errors on the plants of `TAIL` [mm]; None where the episode ended early."""
    config = SweepConfig((BASE,), (TAIL_CASE,), distribution="all", plants=10_000, seed=TAIL_SEED)
    found = run_plants(config, {LEARNED: policy}, TAIL)
    return [
        float(worst) if done else None
        for worst, done in zip(found.metrics["max_mm"][0, 0], found.completed[0, 0], strict=True)
    ]


def quantiles_of(values: np.ndarray, shares: tuple[float, ...]) -> list[float | None]:
    """Return quantiles of values (plants,), None where one is not finite."""
    found = np.quantile(values, shares, method="inverted_cdf")
    return [float(value) if np.isfinite(value) else None for value in found]


def row_of(rows: list[dict[str, Any]], case: str, late: float = 0.0, factor: float = 1.0) -> dict[str, Any]:
    """Return the row of a condition."""
    return next(row for row in rows if (row["case"], row["late"], row["factor"]) == (case, late, factor))


def draw(document: dict[str, Any]) -> Figure:
    """Return errors over the change of the torque one sample late, and the failed episodes, for every share."""
    figure = Figure(figsize=(9.0, 3.6))
    front, failures = figure.subplots(1, 2)
    shares = [document["policies"][f"{share:g}"] for share in SHARES]
    front.margins(0.15)
    for case, label in zip(LOADED, ("Case 2", "Case 3"), strict=True):
        rates = [row_of(rows, case, late=1.0)["torque_rate"] for rows in shares]
        errors = [row_of(rows, case)["largest_mm"][0] for rows in shares]
        front.plot(rates, errors, "o-", markersize=4, markeredgewidth=0.0, label=label)
        for share, rate, error in zip(SHARES, rates, errors, strict=True):
            place = ASIDE.get((case, share), (6, 4))
            front.annotate(f"{share:g}", (rate, error), place, textcoords="offset points", fontsize=8)
    front.set_xlabel("change of the torque one sample late [N m/ms]")
    front.set_ylabel("median of the largest tip error [mm]")
    front.set_ylim(bottom=0.0)
    front.legend(frameon=False, title="numbers: share of the network")
    for label, late, factor in SHOWN:
        counts = [sum(row_of(rows, case, late, factor)["failed"] for case in LOADED) for rows in shares]
        failures.plot(SHARES, counts, "o-", markersize=4, markeredgewidth=0.0, label=label)
    failures.margins(x=0.04)
    failures.set_xlabel("share of the network")
    failures.set_ylabel(f"failed episodes of {len(LOADED) * document['plants']}")
    failures.set_ylim(bottom=0.0)
    failures.legend(frameon=False)
    return figure


def main() -> None:
    """Measure, print, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", type=int, default=25)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    arguments = parser.parse_args()
    policies: dict[str, Policy] = {BASE: load_policy(BASE), ADAPTIVE: load_policy(ADAPTIVE)}
    policies |= {f"{share:g}": with_share(share) for share in SHARES}
    rows: dict[str, list[dict[str, Any]]] = {}
    tail = {name: on_tail(policy) for name, policy in policies.items()}
    document = {
        "schema": "fuzzyarm-estimate-front/2",
        **current_provenance(),
        "first_plant_seed": SEED,
        "plants": arguments.plants,
        "quantiles": list(QUANTILES),
        "failed_above_mm": FAILED_MM,
        "shares": list(SHARES),
        "tail": {"plants": list(TAIL), "first_plant_seed": TAIL_SEED, "case": TAIL_CASE, "largest_mm": tail},
        "policies": rows,
    }
    table = Table("policy or share", "late, factor", *(f"{case}: largest, mm; N m/ms; failed" for case in PAPER_CASES))
    for name, policy in policies.items():
        rows[name] = measured(policy, arguments.plants)
        for late, factor in dict.fromkeys((one.late, one.factor) for one in CONDITIONS):
            found = [row for row in rows[name] if (row["late"], row["factor"]) == (late, factor)]
            cells = (f"{row['largest_mm']}; {row['torque_rate']}; {row['failed']}" for row in found)
            table.add_row(name, f"{late:g}, {factor:g}", *([""] if late or factor != 1.0 else []), *cells)
        if arguments.json:
            write_atomically(arguments.json, json.dumps(document, indent=1) + "\n")
    Console(width=180).print(table, tail)


if __name__ == "__main__":
    main()
