"""Write the README's tables and pictures from fresh measurements, or from the stored ones.

    python benchmarks/readme.py            measure everything anew, then write (a quarter of an hour)
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
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from learned_tables import training_cells

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.evaluation.ranking import markdown, rank_policies
from fuzzyarm.eval.evaluation.result_table import markdown_table
from fuzzyarm.eval.stability.margins import margin_cells, margin_notes

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results"
SWEPT = ("fuzzy-4", "fuzzy-4-tip", "computed-torque-tip", "elastic-observer", "ppo-residual")
NAMES = (
    "learned_comparison",
    "accuracy",
    "computed_torque_tuning",
    "tip_feedforward",
    "gain_choice",
    "observer_tuning",
    "complexity",
    "synthesis",
    "certified_bounds",
)


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
        subprocess.run([sys.executable, "-m", "fuzzyarm", "bench", "--lanes-sweep", "--out", folder], check=True)
        shutil.copy(Path(folder) / "bench.json", RESULTS / "bench.json")
        shutil.copy(Path(folder) / "throughput.png", ROOT / "docs" / "throughput.png")
        policies = [word for name in SWEPT for word in ("--policy", name)]
        command = [
            sys.executable,
            "-m",
            "fuzzyarm",
            "sweep",
            *policies,
            "--plants",
            "10000",
            "--out",
            f"{folder}/sweep",
        ]
        subprocess.run(command, check=True)
        shutil.copy(Path(folder) / "sweep" / "sweep.json", RESULTS / "sweep.json")
        shutil.copy(Path(folder) / "sweep" / "spread.png", ROOT / "docs" / "sweep.png")
    command = [sys.executable, "-m", "fuzzyarm", "margins", "--out", str(RESULTS / "margins.json")]
    subprocess.run(command, check=True)
    for name in ("mujoco_arm", "soak"):  # these write their results themselves
        subprocess.run([sys.executable, str(ROOT / "benchmarks" / f"{name}.py")], check=True)
    docs = ROOT / "docs"
    extra = {
        "complexity": ["--figure", str(docs / "complexity.png")],
        "synthesis": ["--large"],
        "learned_comparison": ["--figure", str(docs / "learned.png"), "--curves", str(docs / "learning_curves.png")],
    }
    for name in NAMES:
        script = ROOT / "benchmarks" / f"{name}.py"
        command = [sys.executable, str(script), "--json", str(RESULTS / f"{name}.json"), *extra.get(name, [])]
        subprocess.run(command, check=True)
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
    names = ("evaluate", "bench", "margins", "sweep", "soak", "mujoco_arm", *NAMES)
    stored = {name: json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8")) for name in names}
    return {
        "results": f"{markdown_table(stored['evaluate']['results'])}\n\n"
        f"`fuzzyarm evaluate`, 1 kHz, seed 0 (nothing is random in these cases); {_made_with(stored['evaluate'])}\n\n"
        f"{_paper_line(stored['evaluate'])}",
        "tip": _tip_table(stored["tip_feedforward"]),
        "leaderboard": _leaderboard_table(),
        "sweep": _sweep_table(stored["sweep"]),
        "learned": _learned_tables(stored["learned_comparison"]),
        "speed": f"{_speed_table(stored['bench'])}\n\n{_peer_line(stored['mujoco_arm'])} {_soak_line(stored['soak'])}",
        "accuracy": _accuracy_table(stored["accuracy"]),
        "margins": _margins_table(stored["margins"], stored["computed_torque_tuning"]),
        "gains": _gains_table(stored["gain_choice"]),
        "complexity": _complexity_table(stored["complexity"]),
        "synthesis": _synthesis_table(stored["synthesis"]),
        "bounds": _bounds_table(stored["certified_bounds"]),
    }


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a Markdown table, all but the first `left` columns aligned to the right."""
    rule = " --- |" * left + " ---: |" * (len(headings) - left)
    return "\n".join([f"| {' | '.join(headings)} |", f"|{rule}", *(f"| {' | '.join(row)} |" for row in rows)])


def _complexity_table(document: dict[str, Any]) -> str:
    headings = ["rules", "γ at equal gain [µrad/(N m)]", "gain at equal γ [kN m/rad]", "solve + proof [s]"]
    headings += ["step [µs]", "file [kB]", "tip error max, Case 1 / 2 / 3 [mm]", "loop gain to, 1 ms later"]
    rows = [
        [
            str(row["rules"]),
            f"{1e6 * row['gamma']:.0f}",
            f"{1e-3 * row['gain']:.1f}",
            f"{row['synthesis_s'] + row['proof_s']:.2f}",
            f"{row['predict_us']:.1f}",
            f"{1e-3 * row['file_bytes']:.1f}",
            " / ".join(f"{row['tip_error_max_mm'][case]:.1f}" for case in ("nominal", "machining", "payload")),
            f"{row['gain_margin_upper_delayed']:.2f}",
        ]
        for row in document["rows"]
    ]
    return f"{_table(headings, rows)}\n\n`{document['command']}`; {_made_with(document)}"


def _synthesis_table(document: dict[str, Any]) -> str:
    headings = ["form", "rules", "paper's N_var / N_row", "full problem", "reduced", "cvxpy [s]", "Clarabel on it [s]"]
    headings += ["ours: build + solve [s]", "ratio", "proof [s]"]
    rows = [
        [
            row["form"],
            str(row["rules"]),
            *(f"{row[key]['variables']} / {row[key]['rows']}" for key in ("paper_formula", "full", "reduced")),
            f"{row['cvxpy_compile_s']:.2f}",
            f"{row['cvxpy_solve_s']:.2f}",
            f"{row['build_s'] + row['solve_s']:.2f}",
            f"{row['ratio']:.1f}",
            f"{row['proof_s']:.2f}",
        ]
        for row in document["rows"]
    ]
    return (
        f"{_table(headings, rows)}\n\nVariables / rows of the cones; one thread; the paper's formula is that of its "
        f"Table 2. `{document['command']}`; {_made_with(document)}"
    )


def _bounds_table(document: dict[str, Any]) -> str:
    headings = [
        "policy",
        "α certified [1/s]",
        "slowest decay observed",
        "γ certified [rad/(N m)]",
        "largest L2 gain observed",
    ]
    rows = []
    for name, bound in document["bounds"].items():
        decay, gain = bound["decay_per_s"], bound["gain_rad_per_Nm"]
        observed = f"{gain['observed']:.2e} ({gain['observed'] / gain['certified']:.0%})"
        rows.append([name, f"{decay['certified']:g}", f"{decay['observed']:.1f}", f"{gain['certified']:.2e}", observed])
    return (
        f"{_table(headings, rows)}\n\nOn the rigid arm in continuous time, which is what the certificates are about: "
        "the slowest decay of V and the largest gain over a library of disturbances and the worst found by search. "
        f"`{document['command']}`; {_made_with(document)}"
    )


def _speed_table(bench: dict[str, Any]) -> str:
    headings = ["", "lanes", "threads", "numbers", "thousand steps/s", "tip error [µm]", "times as fast as"]
    rows = []
    for row in bench["rows"]:
        speed, error = row["steps_per_s"], row["tip_error_um"]
        peers = [f"{peer} {ratio['median']:.3g}" for peer, ratio in row["ratios"].items()]
        cells = [row["name"], str(row["lanes"]), str(row["threads"]), row["dtype"]]
        measured = "not measured" if speed is None else f"{1e-3 * speed['median']:.0f}"
        rows.append([*cells, measured, "" if error is None else f"{error:.2g}", ", ".join(peers)])
    method = bench["method"]
    missing = sorted({f"{row['name']}: {row['reason']}" for row in bench["rows"] if row["reason"]})
    return (
        f"{_table(headings, rows)}\n\nMedians of {method['rounds']} rounds of {method['seconds']:g} s in which "
        f"everyone takes turns. {' '.join(f'Not measured: {line}.' for line in missing)} A further lane takes "
        f"{bench['memory_per_lane']['bytes']:.0f} bytes. `{bench['command']}`; {_made_with(bench)}"
    )


def _peer_line(mujoco: dict[str, Any]) -> str:
    """Say how the two simulations agree where their friction models are the same."""
    frictionless, coulomb = mujoco["frictionless"], mujoco["Coulomb"]
    finest = min(row["tip_error_um"] for row in frictionless["mujoco"])
    return (
        "Against the event integrator, without friction / with Coulomb friction alone, our tip error is "
        f"{frictionless['our_tip_error_um']:.2f} / {coulomb['our_tip_error_um']:.2f} µm, and MuJoCo's goes down to "
        f"{finest:.1g} / {min(row['tip_error_um'] for row in coulomb['mujoco']):.2g} µm as its step shrinks "
        f"(`{mujoco['command']}`)."
    )


def _soak_line(soak: dict[str, Any]) -> str:
    """Say what the soak saw."""
    parts = []
    for row in soak["rows"]:
        memory = [value for value in row["resident_MB"] if value is not None]
        growth = memory[-1] - memory[len(memory) // 4] if memory else float("nan")
        parts.append(
            f"{row['actions']}: {row['env_steps']:.3g} env-steps, {row['episodes']} episodes, {row['seconds']:.0f} s, "
            f"memory {growth:+.1f} MB over the last three quarters"
        )
    return f"Soak, without a number that is not finite: {'; '.join(parts)} (`python benchmarks/soak.py`)."


def _accuracy_table(document: dict[str, Any]) -> str:
    differences = document["max_tip_difference_um"]
    steps = list(next(iter(differences.values())))
    headings = ["case", *(f"h = {1e3 * float(h):g} ms [µm]" for h in steps)]
    rows = [[case, *(f"{row[h]:.3f}" for h in steps)] for case, row in differences.items()]
    return f"{_table(headings, rows)}\n\nThe default is h = 0.2 ms. `{document['command']}`; {_made_with(document)}"


def _paper_line(document: dict[str, Any]) -> str:
    """Return the motor-side circularity of the policy that stands for the paper's, beside the paper's figures."""
    rows = {row["case"]: row for row in document["results"] if row["policy"] == "fuzzy-4"}
    ranges = (
        f"[{rows[case]['circularity_motor_min_mm']:+.2f}, {rows[case]['circularity_motor_max_mm']:+.2f}] mm in Case {k}"
        for k, case in enumerate(("nominal", "machining", "payload"), start=1)
    )
    return (
        "Beside the paper, which reports circularity errors of 1.3 mm (Case 1) and -2.3 to 4.4 mm (Case 2) for its "
        "4-rule controller without saying on which side: with the motor angles, as if the joints were rigid, `fuzzy-4` "
        f"has {', '.join(ranges)}. That tells how well the motors are led, not where the tip is."
    )


def _tip_table(document: dict[str, Any]) -> str:
    cases = {"nominal": "Case 1", "machining": "Case 2", "payload": "Case 3"}
    wrong = f"Case 1, stiffness {100 * document['wrong']:.0f} % off"
    headings = ["law", "variant", *(f"{name}: max / rms [mm]" for name in (*cases.values(), wrong))]
    rows = [
        [row["law"], row["variant"]]
        + [f"{row[key]['max_mm']:#.3g} / {row[key]['rms_mm']:#.3g}" for key in (*cases, "stiffness_wrong")]
        for row in document["rows"]
    ]
    return f"{_table(headings, rows, left=2)}\n\n`{document['command']}`; {_made_with(document)}"


def _learned_tables(document: dict[str, Any]) -> str:
    """Return a table of the largest errors, one of the rms errors, and one of the trainings."""
    titles = {task["name"]: task["title"].removeprefix("Case 1, ").partition(":")[0] for task in document["tasks"]}
    policies = list(dict.fromkeys(row["policy"] for row in document["rows"]))
    cells = {(row["policy"], row["task"]): row for row in document["rows"]}
    parts = []
    for key, heading in (("tip_error_max_mm", "largest tip error [mm]"), ("tip_error_rms_mm", "rms tip error [mm]")):
        rows = [[name, *(_learned_cell(cells[name, task], key) for task in titles)] for name in policies]
        parts.append(_table([heading, *titles.values()], rows))
    method = document["method"]
    parts.append(
        "Beside the cases other circles and an eight, without load. Of learned policies the interquartile mean over "
        f"the seeds with its {100 * method['interval']['level']:.0f} % bootstrap interval, without those that failed: "
        f"{method['failed']['rule'].partition(';')[0]}. `{document['command']}`; {_made_with(document)}"
    )
    parts.append(_table(*training_cells(document)))
    return "\n\n".join(parts)


def _learned_cell(row: dict[str, Any], key: str) -> str:
    """Return an error [mm] with its interval if it has one, and how many seeds failed if any did."""
    failed = f"{row['failed']} of {row['episodes']} failed" if row["failed"] else ""
    if row[key] is None:
        return failed
    mean, low, high = ("" if value is None else _two_digits(value) for value in row[key].values())
    interval = f" ({low} to {high})" if low else ""
    return f"{mean}{interval}{', ' if failed else ''}{failed}"


def _leaderboard_table() -> str:
    """Return what `fuzzyarm leaderboard --markdown` prints of the stored evaluation, without where each row is from."""
    lines = markdown(rank_policies([RESULTS / "evaluate.json"])).splitlines()
    return "\n".join(f"{line.rpartition(' | ')[0]} |" if line.startswith("|") else line for line in lines)


def _sweep_table(document: dict[str, Any]) -> str:
    """Return success and quantiles of the largest tip error, a row per policy and case."""
    headings = ["case", "policy", f"below {document['config']['bound']:g} mm [%]"]
    headings += [f"largest tip error, {q} % of plants [mm]" for q in (50, 99)]
    rows = [
        [
            CASES[row["case"]].title,
            row["policy"],
            _interval(row["success"], lambda value: f"{100 * value:.2f}"),
            *(_interval(row["max_mm"][key], lambda value: f"{value:#.3g}") for key in ("0.5", "0.99")),
        ]
        for case in CASES
        for row in document["rows"]
        if row["case"] == case
    ]
    return f"{_table(headings, rows, left=2)}\n\nIntervals of 95 %. `{document['command']}`; {_made_with(document)}"


def _interval(found: dict[str, float | None], text: Callable[[float], str]) -> str:
    """Return a value with its interval; words where there is no number."""
    value, low, high = (None if number is None else text(number) for number in found.values())
    if value is None:
        return "ended early"
    return value if low is None or high is None else f"{value} ({low} to {high})"


def _two_digits(value: float) -> str:
    return f"{value:#.2g}".removesuffix(".")


def _gains_table(document: dict[str, Any]) -> str:
    """Return the 4-rule designs without a bound of the fastest pole and with the chosen one."""
    chosen = document["chosen"][0]
    columns = {
        "gamma": ("γ [rad/(N m)]", "{:.1e}"),
        "largest_gain": ("largest gain [kN m/rad]", "{:.1f}"),
        "fastest_rigid_pole": ("fastest rigid pole [1/s]", "{:.0f}"),
        "radius": ("radius", "{:.4f}"),
        "radius_2_samples_later": ("2 samples later", "{:.4f}"),
        "radius_worst_condition": ("worst condition", "{:.5f}"),
        "gain_margin_upper": ("loop gain to", "{:.2f}"),
        "gain_margin_upper_1_sample_later": ("to, 1 sample later", "{:.2f}"),
        "case_1_joint_error_rms_mrad": ("motors' rms, Case 1 [mrad]", "{:.3f}"),
        "case_2_joint_error_rms_mrad": ("Case 2", "{:.3f}"),
    }
    shown = [row for row in document["rows"] if row["rules"] == 4 and 1e-4 <= row["gamma"] <= 2.5e-4]
    rows = []
    for row in (row for row in shown if row["fastest_pole"] in (None, chosen["fastest_pole"])):
        bound = "none" if row["fastest_pole"] is None else f"{row['fastest_pole']:g}"
        mark = " (shipped)" if all(row[key] == chosen[key] for key in ("gamma", "fastest_pole")) else ""
        values = {**row, "largest_gain": 1e-3 * row["largest_gain"]}
        rows.append([bound + mark, *(form.format(values[key]) for key, (_, form) in columns.items())])
    headings = ["bound [1/s]", *(heading for heading, _ in columns.values())]
    return f"{_table(headings, rows)}\n\n`{document['command']}` (its JSON has the whole grid); {_made_with(document)}"


def _margins_table(document: dict[str, Any], tuning: dict[str, Any]) -> str:
    headings, cells = margin_cells(document["rows"])
    limit, delayed = tuning["stability_limit"]["no_extra_delay"], tuning["stability_limit"]["one_sample"]
    return (
        f"{_table(headings, cells)}\n\n{' '.join(margin_notes(document)[:2])} `{document['command']}`; "
        f"{_made_with(document)}\n\nComputed torque becomes unstable at {limit:.0f} rad/s, at {delayed:.0f} rad/s with "
        f"1 ms of extra delay. `{tuning['command']}`; {_made_with(tuning)}"
    )


def _made_with(document: dict[str, Any]) -> str:
    """Return machine and versions in one line."""
    versions, machine = document["versions"], document["machine"]
    libraries = ", ".join(f"{name} {versions[name]}" for name in ("numpy", "numba", "clarabel"))
    commit, _, changes = (document["commit"] or "unknown").partition("+")
    commit = commit[:10] + (f" with {changes}" if changes else "")
    return f"{machine['cpu']}, {machine['cores']} cores, Python {versions['python']}, {libraries}, commit {commit}."


if __name__ == "__main__":
    main()
