"""The statistics of a sweep: success rates and quantiles with confidence intervals, the worst plants, and their table.

An episode that ended early counts as one whose tip error is larger than any bound. The p-quantile of n errors is the
smallest error that at least n p of the errors do not exceed, and may belong to an episode that ended early.

Confidence intervals have the level 95 % and refer to the distribution from which the plants were drawn (for a grid: to
plants chosen from it at random). Intervals for quantiles are percentile bootstraps, which resample ranks once for
all policies, cases and metrics. Such an interval cannot exceed the largest error. Therefore the interval of the 99 %
quantile covers the true quantile in only 80 % of sweeps with 300 plants, in 92 % with 1000, and in 95 % from 3000 on. A
success rate has Wilson's interval: where all plants succeed, a bootstrap would claim certainty.
"""

import functools
import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rich.console import Console
from scipy.stats import binomtest, bootstrap

from fuzzyarm.common.console import Sheet, print_paragraphs
from fuzzyarm.eval.declarations import read_declarations, written_declarations
from fuzzyarm.eval.episodes.metrics import swept
from fuzzyarm.eval.evaluation._statistics import LEVEL, SEED
from fuzzyarm.eval.provenance import made_now
from fuzzyarm.eval.sweep._distributions import NOISE
from fuzzyarm.eval.sweep._episodes import SweepResults
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.policies.declared import Declared

__all__ = ["SCHEMA", "SUMMARY", "print_sweep", "summarise"]

SCHEMA, SUMMARY = "fuzzyarm-sweep/3", "sweep.json"
"""The format of the files of a sweep, and the name of the summary's file."""
_QUANTILES = (0.5, 0.9, 0.99)  # of the errors over the plants
_RESAMPLES = 2000
_ENDED_EARLY = "ended early"
_Number = float | None  # None: an error larger than any bound, or a missing interval


def summarise(
    config: SweepConfig, results: SweepResults, declared: Mapping[str, Declared | None] | None = None
) -> dict[str, Any]:
    """Return the document that `fuzzyarm sweep --json` prints.

    It contains the provenance, the configuration, the declarations of the policies (without `declared` those of the
    package's policies), and ``rows``. The row of a policy in a case has the ``success`` rate and the quantiles of
    ``max_mm`` and ``rms_mm`` by level, each as value and interval, and in ``worst`` the worst plants. A value of None
    is larger than any bound; a single plant has None for the ends of a quantile's interval.
    """
    pairs = itertools.product(enumerate(config.labels), enumerate(config.cases))
    return {
        "schema": SCHEMA,
        **made_now(config.command()),
        "config": config.to_dict(),
        "titles": config.titles,
        "declared": written_declarations(read_declarations(None, config.policies) if declared is None else declared),
        "method": {
            "plants": config.total,
            "distribution": {name: list(value) for name, value in config.drawn().quantities().items()},
            "noise_unit": [NOISE.position, NOISE.velocity],
            "level": LEVEL,
            "resamples": _RESAMPLES,
        },
        "rows": [
            {"policy": policy, "case": case, **_row(config, results.episodes(p, c))} for (p, policy), (c, case) in pairs
        ],
    }


def _row(config: SweepConfig, episodes: SweepResults) -> dict[str, Any]:
    count, total = int(np.count_nonzero(episodes.errors < config.bound)), len(episodes.completed)
    wilson = binomtest(count, total).proportion_ci(LEVEL, method="wilson")
    names, numbers = episodes.plants.dtype.names or (), episodes.arrays
    return {
        "success": {"value": count / total, "low": float(wilson.low), "high": float(wilson.high)},
        "ended_early": int(np.count_nonzero(~episodes.completed)),
        **{key: _quantiles(episodes.finished(key)) for key in episodes.metrics},
        "worst": [
            {"plant": plant, "seed": config.seed + plant}
            | {name: numbers[name][plant].item() for name in ("completed", "seconds", *episodes.metrics)}
            | {"parameters": dict(zip(names, episodes.plants[plant].item(), strict=True))}
            for plant in _worst(episodes, config.worst).tolist()
        ],
    }


def _worst(episodes: SweepResults, count: int) -> np.ndarray:
    """Return the indices (count,) of the worst plants: early ends, earliest first, then by decreasing error."""
    ended = np.where(episodes.completed, np.inf, episodes.seconds)
    return np.lexsort((-episodes.metrics["max_mm"], ended))[:count]


def _quantiles(values: np.ndarray) -> dict[str, dict[str, _Number]]:
    """Return the value, low and high of each of the `_QUANTILES` of values (n,), by level; None in place of inf."""
    ordered = [value if math.isfinite(value) else None for value in np.sort(values).tolist()]
    ranks, *ends = _quantile_ranks(len(ordered))
    found = {f"{p:g}": {"value": ordered[rank]} for p, rank in zip(_QUANTILES, ranks, strict=True)}
    for name, bounds in zip(("low", "high"), ends, strict=True):
        for quantile, bound in zip(found.values(), bounds, strict=True):
            quantile[name] = None if len(ordered) == 1 else ordered[bound]
    return found


@functools.cache
def _quantile_ranks(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the ranks (3,), from 0, of `_QUANTILES` among `count` values in ascending order.

    Two more arrays (3,) have the ranks of the low and of the high ends of their confidence intervals.
    """
    ranks = np.array([math.ceil(p * count - 1e-9) - 1 for p in _QUANTILES])
    if count == 1:
        return ranks, ranks, ranks

    def of_sample(sample: np.ndarray, axis: int) -> np.ndarray:
        ordered = np.partition(np.moveaxis(sample, axis, -1), ranks, axis=-1)
        return np.moveaxis(ordered[..., ranks], -1, 0)

    interval = bootstrap(
        (np.arange(count, dtype=float),),
        of_sample,
        n_resamples=_RESAMPLES,
        batch=max(1, 1_000_000 // count),
        vectorized=True,
        confidence_level=LEVEL,
        method="percentile",
        rng=np.random.default_rng(SEED),
    ).confidence_interval
    return ranks, np.floor(interval.low).astype(int), np.ceil(interval.high).astype(int)


def print_sweep(document: dict[str, Any], console: Console) -> None:
    """Print the document of `summarise` as a table of its rows, with an explanation."""
    config, terminal = document["config"], console.is_terminal
    # On a terminal each word of a heading has a line of its own; a number stays beside its unit.
    space = "\N{NO-BREAK SPACE}" if terminal else " "
    headings = ["policy", f"success, below {config['bound']:g}{space}mm [%]"]
    columns = [
        (key, one, f"{p:g}") for key, one in swept().items() for p in (_QUANTILES if key == "max_mm" else (0.5,))
    ]
    headings += [f"{one.words}, {100 * float(level):g}{space}% [{one.unit}]" for _, one, level in columns]
    rows = sorted(document["rows"], key=lambda row: config["cases"].index(row["case"]))
    cells = [
        [
            row["policy"],
            _cell({name: 100.0 * share for name, share in row["success"].items()}, "{:.2f}".format, terminal),
            *(_cell(row[key][level], one.text, terminal) for key, one, level in columns),
        ]
        for row in rows
    ]
    Sheet(headings, cells, groups=[document["titles"][row["case"]] for row in rows]).print(console)
    note = (
        f"{document['method']['plants']} plants, the same for every policy and case. In brackets, confidence "
        f"intervals of 95 %. '{_ENDED_EARLY}' counts as larger than any error."
    )
    print_paragraphs(console, [note])


def _cell(found: dict[str, _Number], form: Callable[[float], str], terminal: bool) -> str:
    """Return a table cell: the value and the interval in `found`, formatted by `form`; two lines if `terminal`."""
    value, low, high = (
        _ENDED_EARLY if number is None else form(number) for number in map(found.get, ("value", "low", "high"))
    )
    if found["low"] is None and found["value"] is not None:
        return value  # a single plant has no interval
    interval = "" if value == low == high == _ENDED_EARLY else f"({low} to {high})"
    return f"{value}\n{interval}" if terminal else f"{value} {interval}".rstrip()
