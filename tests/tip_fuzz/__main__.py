"""Try to find a tube that the checker accepts and a plant that leaves it; print what is found and keep the figures."""

from __future__ import annotations

import argparse
import dataclasses
import json
import shlex
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.provenance import current_provenance

from .judge import Outcome, row, tried

ROOT = Path(__file__).parents[2]
RATIOS = ("tip", "tube", "column")
NOTHING = {"tries": 0, "accepted": 0, "control_steps": 0, **dict.fromkeys(RATIOS, 0.0)}


def main() -> int:
    """Return 1 if a plant left an accepted tube, or a try ended in an error."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="how long to try (default: 60)")
    parser.add_argument("--seed", type=int, default=0, help="of all tries (default: 0)")
    parser.add_argument("--first", type=int, default=0, help="number of the first try (default: 0)")
    parser.add_argument("--only", type=int, help="make this one try alone, and keep no figures")
    parser.add_argument("--json", type=Path, default=ROOT / "benchmarks" / "results" / "tip_fuzz.json")
    options = parser.parse_args()
    if options.only is not None:
        outcome = tried(options.seed, options.only)
        print(json.dumps(row(outcome), indent=1))
        return 1 if outcome.finding else 0
    whole, parts, findings = dict(NOTHING), {}, []
    begun, number, seconds = time.monotonic(), options.first, 0.0
    while number == options.first or seconds < 60.0 * options.minutes:
        try:
            outcome = tried(options.seed, number)
            _count(outcome, whole, parts)
            if outcome.finding:
                print(f"seed {options.seed}, try {number}: {outcome.finding}", flush=True)
                findings.append(row(outcome))
        except Exception as error:
            traceback.print_exc()
            findings.append({"seed": options.seed, "number": number, "finding": f"the try ends in {error!r}"})
        number, seconds = number + 1, time.monotonic() - begun
    _keep(options, seconds, {**whole, "by": parts, "findings": findings})
    largest = ", ".join(f"{name} {whole[name]:.4f}" for name in RATIOS)
    print(f"{whole['tries']} tries, {whole['accepted']} accepted in {seconds:.0f} s")
    print(f"{len(findings)} findings; largest ratios to what is claimed: {largest}")
    return 1 if findings else 0


def _count(outcome: Outcome, whole: dict[str, Any], parts: dict[str, dict[str, dict[str, Any]]]) -> None:
    """Count a try: in all, by how its tube was made, and by what was attacked."""
    claim = outcome.claim
    kinds = {name: str(value) for name, value in dataclasses.asdict(outcome.attack).items()}
    kinds |= {"policy": claim.policy, "case": claim.case}
    kinds |= {"friction": claim.plants.friction, "late": str(claim.plants.late), "later": str(bool(outcome.later))}
    counted = (parts.setdefault(name, {}).setdefault(value, dict(NOTHING)) for name, value in kinds.items())
    for one in (whole, *counted):
        one["tries"] += 1
        one["accepted"] += outcome.accepted > 0
        one["control_steps"] += outcome.accepted
        for name in RATIOS:
            one[name] = max(one[name], outcome.ratios[name])


def _keep(options: argparse.Namespace, seconds: float, counted: dict[str, Any]) -> None:
    """Write the figures."""
    words = ["--minutes", f"{options.minutes:g}", "--seed", str(options.seed)]
    words += ["--first", str(options.first)] if options.first else []
    command = shlex.join(["python", "-m", "tests.tip_fuzz", *words])
    document = {"schema": "fuzzyarm-tip-fuzz/1", "command": command, **current_provenance(), "seed": options.seed}
    document |= {"first": options.first, "seconds": round(seconds), **counted}
    write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
