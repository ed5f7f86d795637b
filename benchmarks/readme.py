"""Write the README's tables and pictures from fresh measurements, or from the stored ones.

    python benchmarks/readme.py            measure everything anew, then write (a minute or two)
    python benchmarks/readme.py --stored   only write again from benchmarks/results

Run with a clean checkout, so that the recorded commit is the one that was measured.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from fuzzyarm.eval.table import markdown_table

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results"


def main() -> None:
    """Measure unless told otherwise, then write the README."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stored", action="store_true", help="do not measure")
    if not parser.parse_args().stored:
        measure()
    readme = ROOT / "README.md"
    readme.write_text(fill(readme.read_text(encoding="utf-8")), encoding="utf-8")


def measure() -> None:
    """Run each benchmark and keep its JSON; keep the overview and a picture of the arm."""
    RESULTS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "fuzzyarm", "evaluate", "--out", folder], check=True)
        shutil.copy(Path(folder) / "results.json", RESULTS / "evaluate.json")
        shutil.copy(Path(folder) / "overview.png", ROOT / "docs" / "overview.png")
    for name in ("accuracy", "computed_torque_tuning"):
        script = ROOT / "benchmarks" / f"{name}.py"
        subprocess.run([sys.executable, str(script), "--json", str(RESULTS / f"{name}.json")], check=True)
    subprocess.run([sys.executable, str(ROOT / "examples" / "picture.py"), str(ROOT / "docs" / "arm.png")], check=True)


def fill(text: str) -> str:
    """Return the README with each marked section replaced."""
    for name, content in sections().items():
        begin, end = f"<!-- {name}: begin (python benchmarks/readme.py) -->", f"<!-- {name}: end -->"
        before, rest = text.split(begin)
        text = before + begin + "\n" + content + "\n" + end + rest.split(end)[1]
    return text


def sections() -> dict[str, str]:
    """Return the marked sections from the stored results."""
    evaluation, accuracy, tuning = (
        json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
        for name in ("evaluate", "accuracy", "computed_torque_tuning")
    )
    return {
        "results": f"{markdown_table(evaluation['results'])}\n\n"
        f"`fuzzyarm evaluate`, 1 kHz, seed 0 (nothing is random in these cases); {_made_with(evaluation)}",
        "accuracy": _accuracy_table(accuracy),
        "margins": _margins_table(tuning),
    }


def _accuracy_table(document: dict[str, Any]) -> str:
    differences = document["max_tip_difference_um"]
    steps = list(next(iter(differences.values())))
    lines = ["| case | " + " | ".join(f"h = {1e3 * float(h):g} ms [µm]" for h in steps) + " |"]
    lines.append("| --- |" + " ---: |" * len(steps))
    lines += [f"| {case} | " + " | ".join(f"{row[h]:.3f}" for h in steps) + " |" for case, row in differences.items()]
    return "\n".join(lines) + f"\n\n`python benchmarks/accuracy.py`; {_made_with(document)}"


def _margins_table(document: dict[str, Any]) -> str:
    chosen = f"{document['chosen_bandwidth']:g} rad/s"
    names = {"fuzzy-4": "fuzzy-4", chosen: f"computed-torque ({chosen})"}
    columns = {
        "joint_error_rms_mrad": ("joint rms [mrad]", "{:.3f}"),
        "radius": ("spectral radius", "{:.4f}"),
        "radius_delayed": ("1 ms later", "{:.4f}"),
        "gain_margin_lower": ("loop gain from", "{:.2f}"),
        "gain_margin_upper": ("to", "{:.2f}"),
        "gain_margin_upper_delayed": ("to, 1 ms later", "{:.2f}"),
    }
    lines = ["| policy | " + " | ".join(heading for heading, _ in columns.values()) + " |"]
    lines.append("| --- |" + " ---: |" * len(columns))
    for row in document["rows"]:
        if row["policy"] in names:
            cells = [form.format(row[key]) for key, (_, form) in columns.items()]
            lines.append(f"| {names[row['policy']]} | {' | '.join(cells)} |")
    limit, delayed = document["stability_limit"]["no_extra_delay"], document["stability_limit"]["one_sample"]
    return (
        "\n".join(lines)
        + f"\n\nComputed torque becomes unstable at {limit:.0f} rad/s, at {delayed:.0f} rad/s with 1 ms of "
        f"extra delay. `python benchmarks/computed_torque_tuning.py`; {_made_with(document)}"
    )


def _made_with(document: dict[str, Any]) -> str:
    """Return machine and versions in one line."""
    versions, machine = document["versions"], document["machine"]
    libraries = ", ".join(f"{name} {versions[name]}" for name in ("numpy", "numba", "clarabel"))
    commit = (document["commit"] or "unknown")[:10]
    return f"{machine['cpu']}, {machine['cores']} cores, Python {versions['python']}, {libraries}, commit {commit}."


if __name__ == "__main__":
    main()
