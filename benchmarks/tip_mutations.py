"""Set each remainder of the tip bound's proof to zero, one at a time, and see that a test fails.

    python benchmarks/tip_mutations.py [--json FILE] [--only TEXT]

The package and its tests are copied to a temporary folder, where one line is changed at a time and the tests of that
part are run. A remainder whose absence no test notices makes the exit code 1. Ten minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.provenance import current_provenance

ROOT = Path(__file__).parent.parent
COMMAND = "python benchmarks/tip_mutations.py"
PROOF, TESTS = Path("fuzzyarm/eval/certified/tip"), Path("tests/eval/certified/tip")


class Mutation(NamedTuple):
    """A change of one line: what it removes, module, old and new text, test file, and which of its tests are run."""

    remainder: str
    module: str
    old: str
    new: str
    tests: str
    chosen: str = ""


MUTATIONS = (
    Mutation(
        "nonlinearity of the links", "remainders.py", "    return total * ROUND_UP\n", "    return 0.0 * total\n",
        "test_enclosures.py",
    ),
    Mutation(
        "products of masses and the links", "remainders.py", "(fixed + _by_link(within))", "fixed",
        "test_enclosures.py", "masses",
    ),
    Mutation(
        "nonlinearity of what a mass adds", "remainders.py",
        "fixed += link_remainder(tube_slopes(self._motion, tube, _NO_FORCE, arm), at, tube)", "fixed += 0.0",
        "test_enclosures.py", "masses",
    ),
    Mutation(
        "what the series of the links leave", "defects.py", "q[ORDER]]", "arb(0)]", "test_enclosures.py", "series",
    ),
    Mutation(
        "what the series of the friction leave", "defects.py", "far[ORDER]]\n", "arb(0)]\n", "test_enclosures.py",
        "series",
    ),
    Mutation(
        "second moment of a disturbance", "transition.py", "0.25 * h * h *", "0.0 * h *", "test_enclosures.py",
        "moment",
    ),
    Mutation(
        "beyond the moments", "transition.py", "    beyond = PARTS", "    beyond = 0.0 * PARTS", "test_enclosures.py",
        "moment",
    ),
    Mutation(
        "push within a period", "transition.py", "push * 1.001", "0.0 * push", "test_enclosures.py", "moment",
    ),
    Mutation(
        "friction that slips", "friction.py",
        "rest = max(abs(falling + self.slope), abs(rising + self.slope)) + uncertain", "rest = 0.0",
        "test_tube_friction.py",
    ),
    Mutation(
        "friction of unknown sign", "friction.py", "return max(map(abs, ends), default=0.0) * (1 + SLACK) + products",
        "return products", "test_tube_friction.py",
    ),
    Mutation(
        "motions that part", "friction.py",
        "grown = start + aside + duration * (torque / self._inertia + rate * aside)", "grown = start",
        "test_tube_friction.py",
    ),
    Mutation(
        "any friction", "friction.py",
        "return (signal_size(self._needed) + self.share[1] * self.static[1]) * (1 + SLACK) + products",
        "return products", "test_tube.py", "any_friction",
    ),
    Mutation("sinc near zero", "laws.py", "size**3 / 30.0 * 1.001", "0.0", "test_ball_laws.py"),
    Mutation(
        "curvature of the law", "response.py", "rest[i] += radius_of(slope, gain[i, j]) * spread[j]", "rest[i] += 0.0",
        "test_tube.py", "sample",
    ),
    Mutation(
        "force of any course", "tube.py", "(1.0, 0.0), [plants.force_course] * 2", "(1.0, 0.0), [0.0] * 2",
        "test_tube.py", "force",
    ),
    Mutation(
        "force that swings", "tube.py", "courses = [plants.force_swing * signal_size(part)",
        "courses = [0.0 * signal_size(part)", "test_tube.py", "force",
    ),
    Mutation(
        "errors of the encoders", "tube.py", "errors = np.repeat(problem.plants.noise, JOINTS)",
        "errors = 0.0 * np.repeat(problem.plants.noise, JOINTS)", "test_tube.py", "encoders",
    ),
    Mutation(
        "uncertain constants along the centre", "period.py",
        "columns[:, :constants] += solution.held @ driven.level + solution.ramp @ driven.slope",
        "columns[:, :constants] += 0.0", "test_tube.py", "corners",
    ),
    Mutation(
        "constants where a velocity is bounded by itself", "constants.py",
        "frictions[torque.channel].plan is Plan.MONOTONE:", "False:", "test_tube.py", "column_of_a_constant",
    ),
    Mutation(
        "what the constants' columns leave", "constants.py", "rest[torque.channel] += torque.rest",
        "rest[torque.channel] += 0.0", "test_tip_segment.py",
    ),
    Mutation(
        "products of constants and the deviation", "period.py",
        "np.array(plant.half(kind)) for kind in _PRODUCTS", "0.0 * np.array(plant.half(kind)) for kind in _PRODUCTS",
        "test_tube.py",
    ),
    Mutation(
        "between the ends of a period", "period.py", "self._period**2 / 8.0 * second", "0.0 * second",
        "test_tip_segment.py", "between",
    ),
    Mutation(
        "change of the centre's end", "tube.py", "        deviations.box[:STATES] += moved", "        pass",
        "test_tip_segment.py",
    ),
    Mutation(
        "deviations of the links", "tip_error.py", "bound = (widest + float(bent)) * ROUND_UP",
        "bound = offset + float(bent)", "test_tube.py",
    ),
    Mutation(
        "second order of the tip", "tip_error.py", "(widest + float(bent)) * ROUND_UP", "widest * ROUND_UP",
        "test_enclosures.py", "tip",
    ),
    Mutation(
        "nonlinearity of the predicted links", "predictor.py", "return np.asarray((fixed + mass @ claimed) * ROUND_UP)",
        "return 0.0 * fixed", "test_observer_law.py", "near",
    ),
    Mutation(
        "predicted friction of any sign", "predictor.py", "return _Kick(free, way, *gains, dt * strong * ROUND_UP,",
        "return _Kick(free, way, *gains, 0.0,", "test_observer_law.py", "kick",
    ),
    Mutation(
        "predicted friction that may stick", "predictor.py", "part = 0.5 * v_r + 0.5 * dt * alpha_r",
        "part = 0.0 * v_r + 0.0 * dt * alpha_r", "test_observer_law.py", "kick",
    ),
    Mutation(
        "predicted friction that slips", "predictor.py", "rest = 0.5 * (high - low) * dt / inertia * vm_r * ROUND_UP +",
        "rest = 0.0 +", "test_observer_law.py", "kick",
    ),
    Mutation(
        "way of a predicted motor that stops", "predictor.py",
        "np.array([0.5 * t, 0.25 * t * t, 0.0]), 0.0, rest * ROUND_UP)",
        "np.array([0.5 * t, 0.25 * t * t, 0.0]), 0.0, 0.0)", "test_observer_law.py", "kick",
    ),
    Mutation(
        "rounding of the predictor", "predictor.py", "ROUNDED = 2.0**-46", "ROUNDED = 0.0", "test_observer_law.py",
        "rounding",
    ),
    Mutation(
        "gains of the observer between angles", "observer_law.py", "    return middle, rows, rest\n",
        "    return middle, rows, 0.0 * rest\n", "test_observer_law.py", "near",
    ),
    Mutation(
        "curvature of the network", "network_law.py", "rest += self._network", "rest = self._network",
        "test_network_law.py", "near",
    ),
    Mutation(
        "floats of the network", "network_law.py", "return np.asarray(1.01 * error)", "return 0.0 * error",
        "test_network_law.py", "floats",
    ),
    Mutation(
        "curvature of the law below a network", "network_law.py",
        "middle, gain, rest = smooth_part(value, tube.slopes, spread)",
        "middle, gain, rest = smooth_part(value, tube.slopes, 0.0 * spread)", "test_network_law.py", "near",
    ),
    Mutation(
        "a bent function beside its tangent", "bends.py", "taylor = (0.5 * self.bend * r * r", "taylor = (0.0 * r",
        "test_network_law.py", "line",
    ),
    Mutation(
        "a bent function between its ends", "bends.py", "return Line(arb(middle), least, radius_of(between, middle))",
        "return Line(arb(middle), least, 0.0)", "test_network_law.py", "line",
    ),
    Mutation(
        "a network that is clipped", "bends.py", "0.0, 0.5 * (high - low) * ROUND_UP)", "0.0, 0.0)",
        "test_network_law.py", "clip",
    ),
    Mutation(
        "merging of columns", "zonotope.py", "    return Q * sizes,", "    return 0.9 * Q * sizes,",
        "test_enclosures.py", "merged",
    ),
)  # fmt: skip
"""Every remainder, with the line that it stands in."""


def survives(folder: Path, mutation: Mutation) -> list[str] | None:
    """Return which tests fail without a remainder; None if none does."""
    module = folder / PROOF / mutation.module
    sound = module.read_text(encoding="utf-8")
    if sound.count(mutation.old) != 1:
        raise SystemExit(f"{mutation.module} does not hold {mutation.old.strip()!r} once; correct MUTATIONS")
    module.write_text(sound.replace(mutation.old, mutation.new), encoding="utf-8")
    words = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-x", "-p", "no:cacheprovider"]
    words += [str(TESTS / mutation.tests), *(["-k", mutation.chosen] if mutation.chosen else [])]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    module.write_text(sound, encoding="utf-8")
    if done.returncode not in (0, 1):
        raise SystemExit(f"the tests did not run: {done.stdout[-500:]}{done.stderr[-500:]}")
    failed = [line.split("::")[1].split(" ")[0] for line in done.stdout.splitlines() if line.startswith("FAILED")]
    return failed or None


def main() -> None:
    """Try every mutation; print a line for each and optionally write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument(
        "--only", default="", help="try those whose remainder contains this, and put them into the file"
    )
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("fuzzyarm", "tests"):
            shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "pyproject.toml", folder)
        for mutation in MUTATIONS:
            if options.only in mutation.remainder:
                failed = survives(folder, mutation)
                print(f"{mutation.remainder}: {', '.join(failed) if failed else 'NO TEST FAILS'}", flush=True)
                rows.append({"remainder": mutation.remainder, "module": mutation.module, "failed": failed})
    if options.json and options.only and options.json.exists():
        before = json.loads(options.json.read_text(encoding="utf-8"))["rows"]
        fresh = {row["remainder"]: row for row in [*before, *rows]}
        rows = [fresh[m.remainder] for m in MUTATIONS if m.remainder in fresh]
    if options.json:
        document = {"command": COMMAND, "rows": rows, **current_provenance()}
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")
    raise SystemExit(0 if all(row["failed"] for row in rows) else 1)


if __name__ == "__main__":
    main()
