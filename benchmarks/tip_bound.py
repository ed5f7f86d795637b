"""Proven bounds of the tip error, and how near simulated plants of each set come to them.

    python benchmarks/tip_bound.py [--json FILE] [--only TEXT] [--plants N]

Each row: a policy, a case, a set of plants and a motion; the proven bound, what it is made of, and the time of the
proof on one core. Then plants of the set are simulated, half of them at corners of the set and half anywhere in it:
what is measured is the largest tip error, and the largest ratio of a tip error to the bound at the same sample. A set
of one plant is integrated event by event, larger ones by the environment's integrator with sub-steps of 25 µs. Any
friction is bang-bang at random frequencies of the loop, with and against the motion. Ratios count where the bound is
above 1 µm. Ten minutes.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Arm, loaded, lump, plant_of
from fuzzyarm.envs.physics.event_integrator import integrate
from fuzzyarm.envs.physics.hold import hold_of
from fuzzyarm.envs.physics.readings import tip_point
from fuzzyarm.envs.physics.records import PerJoint
from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.envs.scenario.cases import find_case
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.envs.scenario.reference import JointReference, quintic_time_law
from fuzzyarm.eval.certified.tip.bound import PERIOD, TipBound, TipClaim, find_bound, problem_of
from fuzzyarm.eval.certified.tip.enclosures import NoBound
from fuzzyarm.eval.certified.tip.plant_set import SETS, PlantSet
from fuzzyarm.eval.provenance import current_provenance

hold = hold_of(two_joints())

COMMAND = "python benchmarks/tip_bound.py"
SUBSTEPS = 40
COUNTED = 1e-6  # [m], smallest bound that a ratio counts for
MAGNIFIED = 25  # errors in the picture
EVERY = 10  # samples of the curves that are stored

_FACTORS = ("mass", "motor_inertia", "stiffness", "damping", "dry_friction", "viscous_friction")


def _own(name: str, policy: str = "fuzzy-4-tip", case: str = "nominal", **parts: Any) -> TipClaim:
    return TipClaim(policy, case, name, PlantSet(**parts))


def _named(policy: str, name: str, **parts: Any) -> TipClaim:
    return TipClaim(policy, "nominal", name, SETS[name], **parts)


CLAIMS = (
    _named("fuzzy-4-tip", "table-1"),
    _named("fuzzy-4", "table-1"),
    _named("computed-torque-tip", "table-1"),
    _named("fuzzy-1-tip", "table-1"),
    _named("fuzzy-32-tip", "table-1"),
    _named("fuzzy-4-tip", "table-1", path="lemniscate", duration=2.0),
    _named("fuzzy-4-tip", "table-1", duration=1.2),
    TipClaim("fuzzy-4-tip", "machining", "table-1", SETS["table-1"]),
    TipClaim("fuzzy-4-tip", "payload", "table-1", SETS["table-1"]),
    _own("force ± 10 %, any course", case="machining", force_swing=0.1),
    _named("fuzzy-4-tip", "any-friction"),
    _named("fuzzy-4-tip", "near"),
    _named("fuzzy-4-tip", "near-late"),
    _named("fuzzy-4", "near"),
    _own("stiffness ± 10 %", stiffness=(0.9, 1.1)),
    _own("masses ± 2 %", mass=(0.98, 1.02)),
    _own("masses ± 5 %", mass=(0.95, 1.05)),
    _own("dry friction ± 50 %", dry_friction=(0.5, 1.5)),
    _own(
        "stiffness ± 10 %, masses ± 5 %, dry friction ± 50 %",
        stiffness=(0.9, 1.1),
        mass=(0.95, 1.05),
        dry_friction=(0.5, 1.5),
    ),
    _own(
        "stiffness ± 5 %, masses ± 1 %, dry friction ± 50 %",
        stiffness=(0.95, 1.05),
        mass=(0.99, 1.01),
        dry_friction=(0.5, 1.5),
    ),
    _own("payload 0 to 0.2 kg", payload=(0.0, 0.2)),
    _own("payload 0 to 0.5 kg", payload=(0.0, 0.5)),
)
"""What is bounded."""


class Plants:
    """Plants of a set in lanes, some at corners of it; with disturbances that the set allows."""

    def __init__(self, bound: TipBound, lanes: int, seed: int) -> None:
        """Draw `lanes` plants for a bound."""
        self.problem, self.claim, self._rng = problem_of(bound.claim), bound.claim, np.random.default_rng(seed)
        self.lanes, plants = lanes, bound.claim.plants
        nominal = plant_of(self.problem.parameters)
        factors = {name: PerJoint(*(self._drawn(getattr(plants, name)) for _ in range(JOINTS))) for name in _FACTORS}
        zero = np.zeros(lanes)
        draw = draw_record(JOINTS)(**factors, payload=zero, force=zero, angle=PerJoint(zero, zero), reference=zero)
        payload = find_case(bound.claim.case).disturbance.payload
        arm = loaded(
            lump(two_joints().varied(nominal, draw)),
            payload.mass,
            payload.radius(self.problem.parameters),
            nominal.gravity,
        )
        arm = loaded(arm, self._drawn(plants.payload), nominal.length[1], nominal.gravity)
        self._static = np.array([arm.static1 + zero, arm.static2 + zero])
        if plants.friction == "any":
            arm = arm._replace(static1=zero, static2=zero, coulomb1=zero, coulomb2=zero)
        self.arm = np.array([np.broadcast_to(x, lanes) for x in arm], dtype=float)
        self.force = self._drawn(plants.force)
        self._rates = self._rng.uniform(2.0, 80.0, (JOINTS, lanes))  # [Hz], of bang-bang friction
        self._phases, self._kind = self._rng.uniform(0.0, 1.0, (JOINTS, lanes)), self._rng.integers(4, size=lanes)

    def _drawn(self, bounds: tuple[float, float]) -> np.ndarray:
        low, high = bounds
        share = self._rng.uniform(size=self.lanes)
        share[::2] = np.round(share[::2])
        return low + (high - low) * share

    def friction(self, state: np.ndarray, t: float) -> np.ndarray:
        """Return the friction torques (2, lanes) [N m] of a set with any friction."""
        waves = np.where((self._rates * t + self._phases) % 1.0 < 0.5, 1.0, -1.0)
        along = np.where(state[4:6] >= 0.0, 1.0, -1.0)
        return self._static * np.choose(self._kind, [waves, along, -along, np.sign(waves + 0.5 * along)])

    def tip_errors(self) -> np.ndarray:
        """Return the tip error (samples, lanes) [m]."""
        problem, plants, lanes = self.problem, self.claim.plants, self.lanes
        policy, table = load_policy(self.claim.policy), problem.schedule
        state = np.repeat(problem.start[:, np.newaxis], lanes, axis=1)
        memory, waiting, errors = None, None, []
        for k in range(table.steps):
            noise = np.repeat(plants.noise, JOINTS)[:, np.newaxis] * self._rng.choice([-1.0, 1.0], (4, lanes))
            measured = state[[0, 1, 4, 5]] + noise
            seen = np.hstack([measured.T, np.repeat(table.references[k : k + 1], lanes, axis=0)])
            asked, memory = policy.predict(seen, memory)
            acting = asked if waiting is None else waiting
            waiting = asked if plants.late else None
            force = table.forces[k][:, np.newaxis] * self.force
            waves = np.where((self._rates * PERIOD * k + self._phases) % 1.0 < 0.5, 1.0, -1.0)
            force *= 1.0 + plants.force_swing * waves[0]
            force[:2] += plants.force_course * waves
            self._hold(state, np.ascontiguousarray(acting.T), force, PERIOD * k)
            tip = tip_point(PerJoint(state[2], state[3]), Arm(*self.arm))
            errors.append(np.hypot(tip.x - table.targets[k + 1, 0], tip.y - table.targets[k + 1, 1]))
        return np.array(errors)

    def _hold(self, state: np.ndarray, torque: np.ndarray, force: np.ndarray, t: float) -> None:
        if self.claim.plants.friction == "law":
            hold(state, torque, force, self.arm, PERIOD / SUBSTEPS, SUBSTEPS)
            return
        parts = 10  # in each of which the friction is held
        for part in range(parts):
            line = np.concatenate([force[:2] + ((part + 0.5) / parts - 0.5) * force[2:], force[2:] / parts])
            now = torque + self.friction(state, t + part * PERIOD / parts)
            hold(state, now, line, self.arm, PERIOD / SUBSTEPS, SUBSTEPS // parts)


def exact_errors(bound: TipBound) -> np.ndarray:
    """Return the tip error (samples, 1) [m] of the only plant of a set, integrated event by event."""
    problem, payload = problem_of(bound.claim), find_case(bound.claim.case).disturbance.payload
    policy, table = load_policy(bound.claim.policy), problem.schedule
    state, memory, errors = problem.start, None, []
    for k in range(table.steps):
        seen = np.concatenate([state[[0, 1, 4, 5]], table.references[k]])
        torque, memory = policy.predict(seen, memory)
        mean, change = table.forces[k, :2], table.forces[k, 2:]
        state = integrate(
            state,
            torque,
            lambda t, m=mean, c=change: m + (t / PERIOD - 0.5) * c,
            problem.parameters,
            payload,
            0.0,
            PERIOD,
        )
        tip = tip_point(PerJoint(state[2], state[3]), problem.plant.middle)
        errors.append([np.hypot(tip.x - table.targets[k + 1, 0], tip.y - table.targets[k + 1, 1])])
    return np.array(errors)


def measured(claim: TipClaim, lanes: int) -> dict[str, Any]:
    """Return the row of a claim."""
    row = {"policy": claim.policy, "case": claim.case, "set": claim.set_name, "path": claim.path}
    row |= {"duration": claim.duration, "plants": claim.plants.to_dict(), "commit": current_provenance()["commit"]}
    begin = time.process_time()
    try:
        bound = find_bound(claim)
    except NoBound as error:
        return row | {"proven": False, "reason": str(error)}
    seconds = time.process_time() - begin
    errors = exact_errors(bound) if claim.plants == PlantSet() else Plants(bound, lanes, seed=0).tip_errors()
    counted = bound.tip > COUNTED
    ratios = errors[counted] / bound.tip[counted, np.newaxis]
    return row | {
        "proven": True,
        "bound_mm": 1e3 * bound.largest,
        "simulated_mm": 1e3 * float(errors.max()),
        "simulated_plants": errors.shape[1],
        "largest_ratio": float(ratios.max()) if ratios.size else None,
        "spent_mm": {name: 1e3 * value for name, value in bound.spent().items()},
        "cpu_seconds": seconds,
        "curve": {
            "time": [PERIOD * (k + 1) for k in range(EVERY - 1, len(bound.tip), EVERY)],
            "bound_mm": [1e3 * float(x) for x in bound.tip[EVERY - 1 :: EVERY]],
            "simulated_mm": [1e3 * float(x) for x in errors.max(axis=1)[EVERY - 1 :: EVERY]],
        },
    }


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the tube around the circle for a set, and bounds with the worst simulated errors over time."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    figure, (plane, over_time) = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    by_name = {_key(row): row for row in rows}
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
    for index, name in enumerate(("table-1", "any-friction", "near")):
        row = by_name["fuzzy-4-tip", "nominal", name, "circle", 1.5]
        times = row["curve"]["time"]
        over_time.semilogy(times, row["curve"]["bound_mm"], color=f"C{index}", label=f"{name}: proven")
        over_time.semilogy(times, row["curve"]["simulated_mm"], ":", color=f"C{index}", label="simulated, worst")
    over_time.set(xlabel="time [s]", ylabel="tip error [mm]", title="fuzzy-4-tip, paper's circle")
    over_time.legend(fontsize="small", ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.15))
    figure.savefig(path, dpi=120)


def _key(row: dict[str, Any]) -> tuple[Any, ...]:
    return row["policy"], row["case"], row["set"], row["path"], row["duration"]


def _key_of(claim: TipClaim) -> tuple[Any, ...]:
    return claim.policy, claim.case, claim.set_name, claim.path, claim.duration


def main() -> None:
    """Measure and print a line for each claim; write them all, or with --only put those measured into the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--only", default="", help="measure the claims whose text contains this")
    parser.add_argument("--plants", type=int, default=400)
    options = parser.parse_args()
    rows = []
    for claim in CLAIMS:
        text = f"{claim.policy} {claim.case} {claim.set_name} {claim.path} {claim.duration:g}"
        if options.only in text:
            row = measured(claim, options.plants)
            shown = {
                k: v
                for k, v in row.items()
                if k in ("bound_mm", "simulated_mm", "largest_ratio", "cpu_seconds", "reason")
            }
            print(text, json.dumps(shown), flush=True)
            rows.append(row)
    if options.json and options.only and options.json.exists():
        before = json.loads(options.json.read_text(encoding="utf-8"))["rows"]
        fresh = {_key(row): row for row in [*before, *rows]}
        rows = [fresh[key] for key in map(_key_of, CLAIMS) if key in fresh]
    if options.json:
        document = {"rows": rows, "plants": options.plants, "command": COMMAND, **current_provenance()}
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")
    if options.figure:
        draw(rows, options.figure)


if __name__ == "__main__":
    main()
