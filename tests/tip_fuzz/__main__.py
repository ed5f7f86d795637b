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

from .judge import Outcome, row, tried, written

ROOT = Path(__file__).parents[2]
WRITTEN_EVERY = 100  # tries
RATIOS = ("tip", "tube", "column")


def main() -> int:
    """Return 1 if a plant left an accepted tube, or a try ended in an error."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="how long to try (default: 60)")
    parser.add_argument("--seed", type=int, default=0, help="of all tries (default: 0)")
    parser.add_argument("--first", type=int, default=0, help="number of the first try (default: 0)")
    parser.add_argument("--only", type=int, help="make this one try alone, and keep no figures")
    parser.add_argument("--until-found", action="store_true", help="end with the first finding")
    parser.add_argument("--files", type=Path, help="folder for the bound files of findings (default: none)")
    parser.add_argument("--json", type=Path, default=ROOT / "benchmarks" / "results" / "tip_fuzz.json")
    options = parser.parse_args()
    if options.only is not None:
        return _once(options)
    tally, begun, number = Tally(), time.monotonic(), options.first
    while time.monotonic() - begun < 60.0 * options.minutes:
        found = _try(options, number, tally)
        number += 1
        if number % WRITTEN_EVERY == 0:
            _keep(tally, options, time.monotonic() - begun)
        if found and options.until_found:
            break
    _keep(tally, options, time.monotonic() - begun)
    largest = ", ".join(f"{name} {tally.whole[name]:.4f}" for name in RATIOS)
    print(f"{tally.whole['tries']} tries, {tally.whole['accepted']} accepted in {time.monotonic() - begun:.0f} s")
    print(f"{len(tally.findings)} findings; largest ratios to what is claimed: {largest}")
    return 1 if tally.findings else 0


@dataclasses.dataclass
class Tally:
    """What came of all tries: in all, by how tubes were made, and by what was attacked."""

    whole: dict[str, Any] = dataclasses.field(default_factory=lambda: _nothing())
    parts: dict[str, dict[str, dict[str, Any]]] = dataclasses.field(default_factory=dict)
    findings: list[dict[str, Any]] = dataclasses.field(default_factory=list)

    def add(self, outcome: Outcome) -> None:
        """Count a try."""
        claim, attack = outcome.claim, outcome.attack
        kinds = {
            **{name: str(value) for name, value in dataclasses.asdict(attack).items()},
            "policy": claim.policy,
            "case": claim.case,
            "friction": claim.plants.friction,
            "late": str(claim.plants.late),
        }
        counted = [self.whole]
        for name, value in kinds.items():
            counted.append(self.parts.setdefault(name, {}).setdefault(value, _nothing()))
        for one in counted:
            one["tries"] += 1
            one["accepted"] += outcome.accepted > 0
            one["control_steps"] += outcome.accepted
            for name in RATIOS:
                one[name] = max(one[name], outcome.ratios[name])
        if outcome.finding:
            self.findings.append(row(outcome))


def _nothing() -> dict[str, Any]:
    return {"tries": 0, "accepted": 0, "control_steps": 0, **dict.fromkeys(RATIOS, 0.0)}


def _try(options: argparse.Namespace, number: int, tally: Tally) -> bool:
    """Make one try; return whether anything was found."""
    try:
        outcome = tried(options.seed, number)
    except Exception as error:
        traceback.print_exc()
        tally.findings.append({"seed": options.seed, "number": number, "finding": f"the try ends in {error!r}"})
        return True
    tally.add(outcome)
    if outcome.finding:
        _print(outcome, options)
    return bool(outcome.finding)


def _once(options: argparse.Namespace) -> int:
    outcome = tried(options.seed, options.only)
    print(json.dumps(row(outcome), indent=1))
    if outcome.finding:
        _print(outcome, options)
    return 1 if outcome.finding else 0


def _print(outcome: Outcome, options: argparse.Namespace) -> None:
    print(f"seed {outcome.seed}, try {outcome.number}: {outcome.finding}", flush=True)
    if options.files and outcome.bound:
        options.files.mkdir(parents=True, exist_ok=True)
        path = options.files / f"bound-{outcome.seed}-{outcome.number}.json"
        written(outcome, path)
        print(f"  the file: {path}", flush=True)


def _keep(tally: Tally, options: argparse.Namespace, seconds: float) -> None:
    """Write the figures."""
    from fuzzyarm.common.files import write_atomically
    from fuzzyarm.eval.provenance import current_provenance

    words = ["--minutes", f"{options.minutes:g}", "--seed", str(options.seed)]
    words += ["--first", str(options.first)] if options.first else []
    document = {
        "schema": "fuzzyarm-tip-fuzz/1",
        "command": shlex.join(["python", "-m", "tests.tip_fuzz", *words]),
        **current_provenance(),
        "seed": options.seed,
        "first": options.first,
        "seconds": round(seconds),
        **tally.whole,
        "by": tally.parts,
        "findings": tally.findings,
    }
    write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
