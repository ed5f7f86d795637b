"""Proven bounds of the tip error, and how near simulated plants of each set come to them.

    python benchmarks/tip_bound.py [--json FILE] [--only TEXT] [--plants N]
    python benchmarks/tip_bound.py --files DIR [--only TEXT]

Each row: a policy, a case, a set of plants and a motion; the proven bound, what it is made of, and the time of the
proof on one core. Then plants of the set are simulated, half of them at corners of the set and half anywhere in it:
what is measured is the largest tip error, and the largest ratio of a tip error to the bound at the same sample. A set
of one plant is integrated event by event, larger ones by the environment in sub-steps of 25 µs, a robot in 2 µs. Any
friction is bang-bang at random frequencies of the loop, with and against the motion. Ratios count where the bound is
above 1 µm. Three quarters of an hour on one core.

With --files, only the files of the bounds, which `fuzzyarm verify` checks, are made, on all cores. Exit code 1 if one
differs from the stored one.
"""

from __future__ import annotations

import dataclasses
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from matplotlib.figure import Figure
from measuring import made_now, options_of, printed, stored, write_rows
from tip_plants import Plants, random_genes

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import tip_point
from fuzzyarm.envs.physics.event_integrator import integrate
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.cases import find_case
from fuzzyarm.envs.scenario.reference import JointReference, quintic_time_law
from fuzzyarm.policies.tip_bound import PERIOD, TipBound, TipClaim, find_bound, problem_of
from fuzzyarm.policies.tip_cells import _bounds_of_cell as bounds_of_cell
from fuzzyarm.policies.tip_cells import _Division as Division
from fuzzyarm.policies.tip_cells import bounds_of_cells, cells
from fuzzyarm.policies.tip_files import save_bound, save_cells
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.plant import SETS, PlantSet

COUNTED = 1e-6  # [m], smallest bound that a ratio counts for
WIDE, LOADS = "stiffness ± 10 %, masses ± 5 %, dry friction ± 50 %", "payload 0 to 5 kg"
MAGNIFIED = 25  # errors in the picture
AGREES = 2e-5  # relative: bounds of the same proof; solvers and sums round otherwise on another processor, up to 5e-6
EVERY = 10  # samples of the curves that are stored


def _own(name: str, policy: str = "fuzzy-4-tip", case: str = "nominal", **parts: Any) -> TipClaim:
    return TipClaim(policy, case, name.replace("±", "+-"), PlantSet(**parts))


def set_of(claim: TipClaim) -> str:
    """Return what the set of a claim is called in the tables; labels of claims are ASCII."""
    return claim.set_name.replace("+-", "±").replace(" urad", " µrad")


def _named(policy: str, name: str, **parts: Any) -> TipClaim:
    return TipClaim(policy, "nominal", name, SETS[name], **parts)


MARGINS = ("1,0.5", "2,1", "4,2", "16,8")  # of guests [N m]
GUESTS, SMOOTH_GUESTS = (f"shield:{law}:any:{MARGINS[2]}" for law in ("fuzzy-4-tip", "smooth-observer"))

CLAIMS = (
    _named("fuzzy-4-tip", "table-1", laps="ever"),
    _named("fuzzy-4", "table-1"),
    _named("computed-torque", "table-1"),
    _named("computed-torque-tip", "table-1"),
    _named("fuzzy-1-tip", "table-1"),
    _named("fuzzy-4-tip", "table-1", path="lemniscate", duration=2.0),
    TipClaim("fuzzy-4-tip", "machining", "table-1", SETS["table-1"]),
    _own("force ± 10 %, any course", case="machining", force_swing=0.1),
    _named("fuzzy-4-tip", "any-friction"),
    _named("fuzzy-4-tip", "near", laps="ever"),
    _named("fuzzy-4-tip", "near-late"),
    _named("fuzzy-4", "near", laps="ever"),
    _named("fuzzy-4-sampled-tip", "table-1", laps="ever"),
    _named("fuzzy-4-sampled-tip", "near", laps="ever"),
    _own("stiffness ± 10 %", stiffness=(0.9, 1.1)),
    _own(WIDE, stiffness=(0.9, 1.1), mass=(0.95, 1.05), dry_friction=(0.5, 1.5)),
    _own("payload 0 to 0.5 kg", payload=(0.0, 0.5)),
    _own(LOADS, payload=(0.0, 5.0)),
    _named("elastic-observer", "table-1"),
    _named("smooth-observer", "table-1", laps="ever"),
    _named("smooth-observer", "any-friction"),
    _named("smooth-observer", "near", laps="ever"),
    _named("ppo-robust", "table-1"),
    _own("payload 0 to 50 g", "ppo-robust", payload=(0.0, 0.05)),
    _named("ppo-residual", "table-1"),
    _own("payload 0 to 10 g", "ppo-residual", payload=(0.0, 0.01)),
    *(_named(f"shield:fuzzy-4-tip:any:{margin}", "table-1") for margin in MARGINS),
    _named(GUESTS, "near"),
    _own(LOADS, SMOOTH_GUESTS, payload=(0.0, 5.0)),
    TipClaim("computed-torque-tip", set_name="planar-3r", arm=robot_named("planar-3r"), duration=1.9, laps="ever"),
)
"""What is bounded."""

CELLS: dict[str, list[Division]] = {
    f"fuzzy-4-tip {LOADS}": [("payload", 8)],
    f"fuzzy-4-tip {WIDE}": [("mass-2", 4)],
    f"{SMOOTH_GUESTS} {LOADS}": [("payload", 10)],
}
"""Sets of policies that are divided: the fields, and into how many parts; cells without a tube are halved."""
DRAWN_SETS = ("table-1", "any-friction", "near", LOADS, WIDE)
DRAWN_POLICIES = (
    ("fuzzy-4-tip", "any-friction"),
    ("smooth-observer", "any-friction"),
    ("smooth-observer", "table-1"),
    ("ppo-robust", "table-1"),
    ("ppo-residual", "table-1"),
)


def cells_of(claim: TipClaim) -> list[Division] | None:
    """Return how the set of a claim is divided; None if it is not."""
    return CELLS.get(f"{claim.policy} {set_of(claim)}")


def bounded(claim: TipClaim) -> tuple[TipBound, np.ndarray, int]:
    """Return the bound of a claim, or of its worst cell, the bound (samples,) [m] at each sample, and the cells."""
    divisions = cells_of(claim)
    if divisions is None:
        found = find_bound(claim)
        return found, found.tip, 1
    fields, worst, tip, count = [name for name, _ in divisions], None, np.zeros(1), 0
    for part in cells(claim.plants, divisions):
        for bound in bounds_of_cell(dataclasses.replace(claim, plants=part), claim.plants, fields):
            worst = bound if worst is None or bound.largest > worst.largest else worst
            tip, count = np.maximum(tip, bound.tip), count + 1
            print(f"  cell {count}: {1e3 * bound.largest:.4g} mm", flush=True)
    assert worst is not None
    return worst, tip, count


def exact_errors(
    claim: TipClaim, parameters: ArmParameters | None = None, payload: float = 0.0, force: float = 1.0
) -> np.ndarray:
    """Return the tip error (samples, 1) [m] of one plant of a set, integrated event by event.

    Args:
        claim: whose motion, case and lateness count.
        parameters: of the plant; None: those of Table 1, which the policy knows.
        payload: mass at the tip beside the case's own [kg].
        force: factor of the case's tip force.
    """
    problem, carried = problem_of(claim), find_case(claim.case).disturbance.payload
    if payload:
        carried = Payload(payload)
    policy, table = load_policy(claim.policy), problem.schedule
    state, memory, waiting, errors = problem.start, None, None, []
    for k in range(table.steps):
        seen = np.concatenate([state[[0, 1, 4, 5]], table.references[k]])
        asked, memory = policy.predict(seen, memory)
        acting = asked if waiting is None else waiting
        waiting = asked if claim.plants.late else None
        mean, change = force * table.forces[k, :2], force * table.forces[k, 2:]
        state = integrate(
            state,
            acting,
            lambda t, m=mean, c=change: m + (t / PERIOD - 0.5) * c,
            parameters or problem.parameters,
            carried,
            0.0,
            PERIOD,
        )
        tip = tip_point(PerJoint(state[2], state[3]), problem.plant.middle)
        errors.append([np.hypot(tip.x - table.targets[k + 1, 0], tip.y - table.targets[k + 1, 1])])
    return np.array(errors)


def episode_errors(claim: TipClaim) -> np.ndarray:
    """Return the tip error (samples, 1) [m] of a robot in the environment, with sub-steps of 2 µs."""
    policy, env = load_policy(claim.policy, robot=claim.arm), FuzzyArmEnv(robot=claim.arm, substep=PERIOD / 512)
    (seen, info), memory, errors = env.reset(seed=0), None, []
    for _ in range(claim.samples):
        torque, memory = policy.predict(seen, memory)
        seen, *_, info = env.step(np.asarray(torque))
        errors.append([info["tip_error"]])
    return np.array(errors)


def measured(claim: TipClaim, lanes: int) -> dict[str, Any]:
    """Return the row of a claim."""
    row = {"policy": claim.policy, "case": claim.case, "set": set_of(claim), "path": claim.path}
    row |= {"duration": claim.duration, "laps": claim.laps, "plants": claim.plants.to_dict(), **made_now()}
    begin = time.process_time()
    try:
        bound, tip, count = bounded(claim)
    except NoBound as error:
        return row | {"proven": False, "reason": str(error)}
    seconds = time.process_time() - begin
    errors = (
        episode_errors(claim)
        if claim.arm is not None
        else exact_errors(claim)
        if claim.plants == PlantSet() and not any(problem_of(claim).guest)
        else Plants(claim, random_genes(lanes, np.random.default_rng(0))).tip_errors()
    )
    counted = tip > COUNTED
    ratios = errors[counted] / tip[counted, np.newaxis]
    return row | {
        "proven": True,
        "cells": count,
        "bound_mm": 1e3 * bound.largest,
        "simulated_mm": 1e3 * float(errors.max()),
        "simulated_plants": errors.shape[1],
        "largest_ratio": float(ratios.max()) if ratios.size else None,
        "spent_mm": {name: 1e3 * value for name, value in bound.spent().items()},
        "cpu_seconds": seconds,
        "curve": {
            "time": [PERIOD * (k + 1) for k in range(EVERY - 1, len(tip), EVERY)],
            "bound_mm": [1e3 * float(x) for x in tip[EVERY - 1 :: EVERY]],
            "simulated_mm": [1e3 * float(x) for x in errors.max(axis=1)[EVERY - 1 :: EVERY]],
        },
    }


def write_file(claim: TipClaim, out: Path) -> float:
    """Write the file of a bound, or one file for each cell and one for the whole set; return the bound [mm]."""
    divisions = cells_of(claim)
    if divisions is None:
        found = find_bound(claim)
        save_bound(found, out)
        return 1e3 * found.largest
    parts = [part for cell in bounds_of_cells(claim, divisions, -1, out) for part in cell]
    save_cells(claim, parts, out)
    return 1e3 * max(part.bound for part in parts)


def draw(document: dict[str, Any]) -> Figure:
    """Return the tube around the circle for a set, and bounds with the worst simulated errors over time."""
    figure = Figure(figsize=(13.0, 4.6))
    plane, sets, policies = figure.subplots(1, 3)
    by_name = {_key(row): row for row in document["rows"]}
    shown = by_name["fuzzy-4-tip", "nominal", "near", "circle", 1.5]
    curve, reference = shown["curve"], JointReference()
    points = reference.path.points(quintic_time_law(np.array(curve["time"]), reference.duration)[0])[0]
    outwards = (points - np.array(reference.path.center)) / reference.path.radius
    for name, key, style in (("proven", "bound_mm", "-"), ("simulated, worst", "simulated_mm", ":")):
        offset = 1e-3 * MAGNIFIED * np.array(curve[key])[:, np.newaxis] * outwards
        for side in (1.0, -1.0):
            line = points + side * offset
            plane.plot(line[:, 1], -line[:, 0], style, color="C0", label=name if side > 0.0 else None)
    plane.plot(points[:, 1], -points[:, 0], color="0.6", linewidth=0.8, label="path")
    plane.set(title=f"fuzzy-4-tip, set near, errors {MAGNIFIED} times", xlabel="y [m]", ylabel="-x [m]", aspect="equal")
    plane.legend(loc="center")
    for axes, title, keys in (
        (sets, "fuzzy-4-tip, by set", [("fuzzy-4-tip", name) for name in DRAWN_SETS]),
        (policies, "by policy and set", DRAWN_POLICIES),
    ):
        for index, (policy, name) in enumerate(keys):
            curve = by_name[policy, "nominal", name, "circle", 1.5]["curve"]
            words = name if axes is sets else f"{policy}, {name}"
            axes.semilogy(curve["time"], curve["bound_mm"], color=f"C{index}", label=words)
            axes.semilogy(curve["time"], curve["simulated_mm"], ":", color=f"C{index}")
        axes.set(
            xlabel="time [s]", ylabel="tip error [mm]", title=f"{title} (dotted: simulated, worst)", ylim=(1e-6, 20)
        )
        axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.15))
    return figure


def text_of(claim: TipClaim) -> str:
    """Return the text of a claim by which `--only` chooses."""
    return f"{claim.policy} {claim.case} {set_of(claim)} {claim.path} {claim.duration:g}"


def _key(row: dict[str, Any]) -> tuple[Any, ...]:
    return row["policy"], row["case"], row["set"], row["path"], row["duration"]


def _key_of(claim: TipClaim) -> tuple[Any, ...]:
    return claim.policy, claim.case, set_of(claim), claim.path, claim.duration


def main() -> None:
    """Measure and print a line for each claim; write them all, or with --only put those measured into the file."""
    parser = options_of(__doc__)
    parser.add_argument("--files", type=Path, metavar="DIR")
    parser.add_argument("--only", default="", help="measure the claims whose text contains this")
    parser.add_argument("--plants", type=int, default=400)
    options = parser.parse_args()
    chosen = {f"{number:02}.json": claim for number, claim in enumerate(CLAIMS) if options.only in text_of(claim)}
    if options.files:
        options.files.mkdir(parents=True, exist_ok=True)
        known, moved = {_key(row): row["bound_mm"] for row in stored("tip_bound")["rows"]}, 0
        for jobs in (-1, 1):  # a process for each core; then those by cells, each of which has such processes itself
            parts = [(x, options.files / name) for name, x in chosen.items() if (cells_of(x) is None) == (jobs < 0)]
            made = Parallel(n_jobs=jobs, return_as="generator")(delayed(write_file)(*part) for part in parts)
            for (claim, _), bound in zip(parts, made, strict=True):
                before = known[_key_of(claim)]
                moved += not math.isclose(bound, before, rel_tol=AGREES)
                print(f"{text_of(claim)}: {bound:.9g} mm, stored {before:.9g} mm", flush=True)
        raise SystemExit(bool(moved))
    rows = printed(measured(claim, options.plants) for claim in chosen.values())
    keys = [*map(_key_of, CLAIMS)]
    write_rows(options.json, "tip_bound.py", rows, keys, _key, plants=options.plants)


if __name__ == "__main__":
    main()
