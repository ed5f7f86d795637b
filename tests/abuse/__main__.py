"""Run tries of all surfaces, print what came of them, and keep the figures."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from .apart import run_apart
from .surface import Surface

ROOT = Path(__file__).parents[2]


def main() -> int:
    """Return 1 if something broke."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("surfaces", nargs="*", help="names, or parts of names (default: all)")
    parser.add_argument("--share", type=float, default=1.0, help="of the tries of a whole run (default: 1)")
    parser.add_argument("--first", type=int, default=0, help="number of the first try (default: 0)")
    parser.add_argument("--only", type=int, help="run this one try alone")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--json", type=Path, default=ROOT / "benchmarks" / "results" / "abuse.json")
    parser.add_argument("--resume", action="store_true", help="keep the rows in --json that are whole and unbroken")
    options = parser.parse_args()
    from .surfaces import SURFACES

    chosen = [one for one in SURFACES if not options.surfaces or any(name in one.name for name in options.surfaces)]
    plans = [(one, _numbers(one.count, options)) for one in chosen]
    kept = _kept(plans, options.json) if options.resume else {}
    rows = list(kept.values())
    with ThreadPoolExecutor(options.jobs) as pool:
        for row in pool.map(lambda plan: _row(*plan), (plan for plan in plans if plan[0].name not in kept)):
            rows.append(row)
            if not options.surfaces and options.only is None:
                _keep(rows, options)
    tried, broken = sum(row["tried"] for row in rows), [line for row in rows for line in row["broken"]]
    print(f"{tried} tried, {tried - len(broken)} held, {len(broken)} broken")
    return 1 if broken else 0


def _numbers(count: int, options: argparse.Namespace) -> range:
    if options.only is not None:
        return range(options.only, options.only + 1)
    return range(options.first, options.first + max(1, round(count * options.share)))


def _row(surface: Surface, numbers: range) -> dict[str, Any]:
    return run_apart(surface.name, numbers) | {"group": surface.group}


def _kept(plans: list[tuple[Surface, range]], path: Path) -> dict[str, dict[str, Any]]:
    """Return the rows of an earlier run whose tries were all made and held, by surface."""
    rows = {row["surface"]: row for row in json.loads(path.read_text())["rows"]} if path.exists() else {}
    found = [(rows.get(one.name, {}), len(numbers)) for one, numbers in plans]
    return {row["surface"]: row for row, tries in found if (row.get("tried"), row.get("broken")) == (tries, [])}


def _keep(rows: list[dict[str, Any]], options: argparse.Namespace) -> None:
    """Write the figures."""
    from fuzzyarm.common.files import write_atomically
    from fuzzyarm.eval.provenance import current_provenance

    words = [] if options.share == 1.0 else ["--share", f"{options.share:g}"]
    document = {
        "schema": "fuzzyarm-abuse/1",
        "command": shlex.join(["python", "-m", "tests.abuse", *words]),
        **current_provenance(),
        "rows": rows,
    }
    write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    sys.exit(main())
