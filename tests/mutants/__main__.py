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
        tests = dict.fromkeys(one.tests for one in chosen)
        whole = {words: pool.submit(_tested, copies, words) for words in tests}  # first, since they also compile
        rows = list(pool.map(lambda one: _row(copies, one), chosen))
    failing = [
        f"fails without any mutant: {words}: {one.result()[1]}" for words, one in whole.items() if one.result()[0]
    ]
    lived, minutes = [row["name"] for row in rows if row["outcome"] == "lived"], (time.monotonic() - begin) / 60
    print(f"{len(rows)} mutants, {len(lived)} live: {', '.join(lived) or '-'}; {minutes:.0f} min", *failing, sep="\n")
    if not options.names and not failing:
        _keep(rows)
    return 1 if lived or failing else 0


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


def _tested(copies: queue.SimpleQueue[Path], tests: str, mutant: Mutant | None = None) -> tuple[int, str]:
    """Return the exit code of pytest, 1 where it does not end, and the test that failed first, if any did."""
    copy = copies.get()
    path = copy / "fuzzyarm" / (mutant.file if mutant else "__init__.py")
    good = path.read_text(encoding="utf-8")
    if mutant and good.count(mutant.old) != 1:
        raise SystemExit(f"{mutant.name}: its text stands {good.count(mutant.old)} times in {mutant.file}")
    path.write_text(good.replace(mutant.old, mutant.new) if mutant else good, encoding="utf-8")
    words = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-q", "-p", "no:cacheprovider", *shlex.split(tests)]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(words, cwd=copy, env=environment, capture_output=True, text=True, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return 1, ""
    finally:
        path.write_text(good, encoding="utf-8")
        copies.put(copy)
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    return done.returncode, failed[1] if failed else done.stdout[-300:] if done.returncode else ""


def _row(copies: queue.SimpleQueue[Path], mutant: Mutant) -> dict[str, Any]:
    begin = time.monotonic()
    code, said = _tested(copies, mutant.tests, mutant)
    outcome = "died" if code != 0 else "equivalent" if mutant.equivalent else "lived"
    row = {**mutant._asdict(), "outcome": outcome, "by": said, "seconds": time.monotonic() - begin}
    print(f"{mutant.name}: {outcome} {said.splitlines()[-1] if said else ''}", flush=True)
    return row


def _keep(rows: list[dict[str, Any]]) -> None:
    from fuzzyarm.common.files import write_atomically
    from fuzzyarm.eval.provenance import current_provenance

    document = {"schema": "fuzzyarm-mutants/1", "command": "python -m tests.mutants", **current_provenance()}
    write_atomically(RESULTS, json.dumps(document | {"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
