"""Try to find a tube that the checker accepts and a plant that leaves it; print what is found and keep the figures."""

import argparse
import dataclasses
import json
import sys
import time
import traceback
from pathlib import Path

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.provenance import current_provenance

from .judge import RATIOS, row, tried

ROOT = Path(__file__).parents[2]
NOTHING = {"tries": 0, "accepted": 0, "control_steps": 0, **dict.fromkeys(RATIOS, 0.0)}


def main():
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


def _count(outcome, whole, parts):
    """Count a try: in all, by how its tube was made, and by what was attacked."""
    claim, kinds = outcome.claim, dataclasses.asdict(outcome.attack)
    kinds |= {"policy": claim.policy, "case": claim.case, "friction": claim.plants.friction}
    kinds |= {"late": claim.plants.late, "later": bool(outcome.later)}
    counted = (parts.setdefault(name, {}).setdefault(str(value), dict(NOTHING)) for name, value in kinds.items())
    for one in (whole, *counted):
        one["tries"] += 1
        one["accepted"] += outcome.accepted > 0
        one["control_steps"] += outcome.accepted
        for name in RATIOS:
            one[name] = max(one[name], outcome.ratios[name])


def _keep(options, seconds, counted):
    command = f"python -m tests.tip_fuzz --minutes {options.minutes:g} --seed {options.seed}"
    command += f" --first {options.first}" if options.first else ""
    document = {"schema": "fuzzyarm-tip-fuzz/1", "command": command, **current_provenance(), "seed": options.seed}
    document |= {"first": options.first, "seconds": round(seconds), **counted}
    write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
