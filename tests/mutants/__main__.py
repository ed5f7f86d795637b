"""Run the mapped tests of every mutant in a copy of the repository, and keep what came of them."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import queue
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from .listed import MUTANTS, Mutant

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "mutants.json"
LONGEST = 600  # s of a mutant's tests, after which it counts as dead: something waits for ever


def main() -> int:
    """Return 1 if a mutant lives that has no argument beside it, or if the tests fail without any."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="names, or parts of names (default: all, and the results are kept)")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    chosen = [one for one in MUTANTS if not options.names or any(name in one.name for name in options.names)]
    begin, copies = time.monotonic(), queue.SimpleQueue[Path]()
    with contextlib.ExitStack() as stack, ThreadPoolExecutor(options.jobs) as pool:
        for _ in range(options.jobs):
            copies.put(stack.enter_context(_copy()))
        for tests in dict.fromkeys(one.tests for one in chosen):
            pool.submit(_unchanged, copies, tests)  # the first in the line: they also compile
        rows = list(pool.map(lambda one: _row(copies, one), chosen))
    failing = sorted(_failing)
    lived = [row["name"] for row in rows if row["outcome"] == "lived"]
    print(
        f"{len(rows)} mutants, {len(lived)} live: {', '.join(lived) or '-'}; {(time.monotonic() - begin) / 60:.0f} min"
    )
    print(*(f"fails without any mutant: {tests}" for tests in failing), sep="\n")
    if not options.names and not failing:
        _keep(rows)
    return 1 if lived or failing else 0


_failing: set[str] = set()


@contextlib.contextmanager
def _copy() -> Iterator[Path]:
    """A copy of the files of the repository, and of machine code beside them."""
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True)
    files = [*listed.stdout.splitlines(), *(str(path.relative_to(ROOT)) for path in ROOT.glob("fuzzyarm/**/*.nb?"))]
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        for file in files:
            if (ROOT / file).is_file():
                (Path(folder) / file).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / file, Path(folder) / file)
        yield Path(folder)


def _tested(copy: Path, tests: str) -> tuple[int | None, str]:
    """Return the exit code of pytest, None where it does not end, and the test that failed first."""
    words = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-q", "-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            [*words, *shlex.split(tests)], cwd=copy, env=environment, capture_output=True, text=True, timeout=LONGEST
        )
    except subprocess.TimeoutExpired:
        return None, ""
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    return done.returncode, failed[1] if failed else done.stdout[-300:]


def _unchanged(copies: queue.SimpleQueue[Path], tests: str) -> None:
    copy = copies.get()
    code, said = _tested(copy, tests)
    copies.put(copy)
    if code != 0:
        print(f"without any mutant: {tests}: {said}", flush=True)
        _failing.add(tests)


def _row(copies: queue.SimpleQueue[Path], mutant: Mutant) -> dict[str, Any]:
    copy, begin = copies.get(), time.monotonic()
    path = copy / "fuzzyarm" / mutant.file
    good = path.read_text(encoding="utf-8")
    if good.count(mutant.old) != 1:
        raise SystemExit(f"{mutant.name}: its text stands {good.count(mutant.old)} times in {mutant.file}")
    path.write_text(good.replace(mutant.old, mutant.new), encoding="utf-8")
    code, said = _tested(copy, mutant.tests)
    path.write_text(good, encoding="utf-8")
    copies.put(copy)
    outcome = "died" if code != 0 else "equivalent" if mutant.equivalent else "lived"
    row = {**mutant._asdict(), "outcome": outcome, "by": said if code != 0 else "", "seconds": time.monotonic() - begin}
    print(f"{mutant.name}: {outcome} {row['by'].splitlines()[-1] if row['by'] else ''}", flush=True)
    return row


def _keep(rows: list[dict[str, Any]]) -> None:
    from fuzzyarm.common.files import write_atomically
    from fuzzyarm.eval.provenance import current_provenance

    document = {"schema": "fuzzyarm-mutants/1", "command": "python -m tests.mutants", **current_provenance()}
    write_atomically(RESULTS, json.dumps(document | {"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
