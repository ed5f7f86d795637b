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
PROOF, TESTS = Path("fuzzyarm/proof/tip"), Path("tests/proof/tip")


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
        "what the series of the links leave", "defects.py", "q[_ORDER]]", "arb(0)]", "test_enclosures.py", "series",
    ),
    Mutation(
        "what the series of the friction leave", "defects.py", "far[_ORDER]]\n", "arb(0)]\n", "test_enclosures.py",
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
        "return (self._needed_size + self.share[1] * self.static[1]) * (1 + SLACK) + products",
        "return products", "test_tube.py", "any_friction",
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
        "constants where a velocity is bounded by itself", "remainders.py",
        "if friction.plan is Plan.MONOTONE:", "if False:", "test_tube.py", "column_of_a_constant",
    ),
    Mutation(
        "what the constants' columns leave", "remainders.py", "self.rest[channel] += rest_size(torque) +",
        "self.rest[channel] += 0.0 * rest_size(torque) + 0.0 *", "test_tip_segment.py",
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
        "change of the centre's end", "tube.py",
        "        deviations.box[:STATES] += list(map(radius_of, before, after.tolist()))", "        pass",
        "test_tip_segment.py",
    ),
    Mutation(
        "deviations of the links", "tube.py", "bound = (widest + float(bent)) * ROUND_UP",
        "bound = offset + float(bent)", "test_tube.py",
    ),
    Mutation(
        "second order of the tip", "tube.py", "(widest + float(bent)) * ROUND_UP", "widest * ROUND_UP",
        "test_enclosures.py", "tip",
    ),
    Mutation(
        "what a product of the law leaves", "affine.py", "a * b, row, size, rest).widened(crossed, fresh=True)",
        "a * b, row, size, rest)", "test_affine.py", "any_point",
    ),
    Mutation(
        "what a square leaves", "affine.py", "row, size, rest).widened(0.5 * crossed, fresh=True)", "row, size, rest)",
        "test_affine.py", "any_point",
    ),
    Mutation(
        "curvature of a function", "affine.py", "((high - low) + radius_of(slope, tangent) * r)",
        "(0.0 * (high - low) + radius_of(slope, tangent) * r)", "test_affine.py", "any_point",
    ),
    Mutation(
        "a function between its ends", "affine.py", "return Line(arb(middle), slope, radius_of(values, middle))",
        "return Line(arb(middle), slope, 0.0)", "test_affine.py", "any_point",
    ),
    Mutation(
        "corner of a maximum", "affine.py", "    return line.widened(0.5 * most, fresh=True)", "    return line",
        "test_affine.py", "any_point",
    ),
    Mutation(
        "a number beyond both of its limits", "affine.py",
        "return level.widened(0.5 * (most - least) * ROUND_UP, fresh=True)", "return level", "test_affine.py",
        "any_point",
    ),
    Mutation(
        "rounding of the law", "affine.py", "ROUND = 2.0**-50", "ROUND = 0.0", "test_affine.py", "any_point",
    ),
    Mutation(
        "floats of a product with a matrix", "affine.py", "+ (len(given) + 2) * 0.5 * ROUND * terms", "+ 0.0 * terms",
        "test_affine.py", "matrix",
    ),
    Mutation(
        "predicted friction of any sign", "affine.py", "(v + h * a).widened(h * strong * UP, fresh=True)",
        "(v + h * a)", "test_affine.py", "motor",
    ),
    Mutation(
        "predicted friction that may stick", "affine.py", "    left = 0.5 * dv + 0.5 * h * da + h * df",
        "    left = 0.0", "test_affine.py", "motor",
    ),
    Mutation(
        "way of a predicted motor that may stick", "affine.py", "0.25 * h * h, lost + h * floats)",
        "0.25 * h * h, h * floats)", "test_affine.py", "motor",
    ),
    Mutation(
        "way of a predicted motor that stops", "affine.py", "0.25 * t * t, left + h * floats)",
        "0.25 * t * t, h * floats)", "test_affine.py", "motor",
    ),
    Mutation(
        "small columns that are condensed", "zonotope.py", "columns[:, order[-FEW:]], rest]",
        "columns[:, order[-FEW:]]]", "test_affine.py", "condensed",
    ),
    Mutation(
        "rows of a table that may differ", "affine.py", "abs(one.middle - middle) + far + one.rest", "0.0 * far",
        "test_affine.py", "points_of_a_table",
    ),
    Mutation(
        "unknowns that are not worth columns", "sampled_law.py", "rest += np.abs(own[:, small]).sum(axis=1)",
        "rest += 0.0", "test_sampled_law.py", "near_a_point",
    ),
    Mutation(
        "box of what a law is given", "sampled_law.py", "rest = rest + np.abs(inner) @ space.base.box", "rest = rest",
        "test_sampled_law.py", "box",
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
