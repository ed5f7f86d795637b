"""Tries in processes of their own, so that one that ends its process is found and the others go on."""

from __future__ import annotations

import multiprocessing
import sys
from typing import Any

__all__ = ["run_apart"]

MOST_DEATHS = 20  # of a surface, after which its tries are given up


def run_apart(name: str, numbers: range) -> dict[str, Any]:
    """Run the tries of a surface in a process of its own; one that ends the process is broken, and the rest goes on."""
    total: dict[str, Any] = {"surface": name, "tried": 0, "refused": 0, "accepted": 0, "broken": []}
    first = numbers.start
    deaths = 0
    while first < numbers.stop and deaths < MOST_DEATHS:
        here, there = multiprocessing.get_context("spawn").Pipe(duplex=False)
        process = multiprocessing.get_context("spawn").Process(target=_work, args=(name, first, numbers.stop, there))
        process.start()
        there.close()
        last, tally = first, None
        try:
            while True:
                received = here.recv()
                if isinstance(received, dict):
                    tally = received
                    break
                last = received
        except EOFError:
            pass
        process.join()
        if tally is None:
            total["broken"].append(f"{name} --only {last}: ended the process with {process.exitcode}")
            total["tried"] += last + 1 - first
            first, deaths = last + 1, deaths + 1
            continue
        for key in ("tried", "refused", "accepted", "broken"):
            total[key] += tally[key]
        first = numbers.stop
    print(*total["broken"], sep="\n", end="\n" * bool(total["broken"]), file=sys.stderr)
    print(f"{name}: {total['tried']} tried, {len(total['broken'])} broken", file=sys.stderr, flush=True)
    return total


def _work(name: str, first: int, stop: int, results: Any) -> None:
    from .surface import try_all
    from .surfaces import SURFACES

    surface = next(one for one in SURFACES if one.name == name)
    tally = try_all(surface, range(first, stop), results.send)
    results.send(vars(tally))
