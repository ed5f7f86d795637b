"""`fuzzyarm identify` on simulated elastic arms (how often its intervals cover the truth) and on recorded logs.

    python benchmarks/identification.py [--arms N] [--logs FOLDER] [--json FILE]

Each arm is drawn at random, and recorded four times for 8 s with computed torque of an arm whose parameters are 0.7 to
1.4 times the true ones, from which the search begins too; encoder noise 1e-4 rad and 1e-2 rad/s, 1 kHz. FOLDER has logs
of DFKI's double pendulum, as in github.com/dfki-ric-underactuated-lab/double_pendulum, data/experiment_records, with
`design_A.0` or `design_C.1` (or `design_A0`, `design_C1`) in their paths; the search begins with two rods of 0.6 kg.
"""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
from measuring import options_of, printed, write

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.identification._rigid import UNKNOWNS, arm_of, start_of
from fuzzyarm.identification.excitation import _Excitation, rehearsed
from fuzzyarm.identification.reading import read_log
from fuzzyarm.identification.result import identify

NOISE, LOGS, DURATION, BANDWIDTH = EncoderNoise(1e-4, 1e-2), 4, 8.0, 12.0  # s, rad/s
# Published beside the logs: L, m, r, I about the centers, I of the rotors, f_v, Γ_fc; their friction is c atan(100 v).
MODELS = {
    "A0": ((0.3, 0.2), (0.5594, 0.6043), (0.3, 0.1838), (0.0031, 0.0035), 2 * (2.76e-3,), 2 * (1e-3,), (0.146, 0.1225)),
    "C1": ((0.2, 0.3), (0.5235, 0.6256), (0.2, 0.2557), (0.011, 0.01), 2 * (2.26e-3,), 2 * (1e-3,), (0.2513, 0.1885)),
}


def arm(L: Any, m: Any, r: Any, inertia: Any, rotor: Any, viscous: Any, coulomb: Any, **rest: Any) -> ArmParameters:
    """Return the arm with these numbers, two of each, and those of `rest`, by the names of `ArmParameters`."""
    pairs = {"length": L, "mass": m, "mass_center": r, "inertia": inertia, "motor_inertia": rotor} | rest
    pairs |= {"viscous_friction": viscous, "coulomb_friction": coulomb}
    return ArmParameters(**{"static_friction": tuple(coulomb)} | {name: tuple(pair) for name, pair in pairs.items()})


def drawn(rng: np.random.Generator) -> ArmParameters:
    """Return an arm of 1 to 20 kg whose joints resonate at 8 to 25 Hz."""
    L, m = rng.uniform(0.2, 0.6, 2), 10.0 ** rng.uniform(-0.3, 1.0, 2) * [1.0, 0.7]
    r, inertia = rng.uniform(0.4, 0.95, 2) * L, m * L * L / 12.0 * rng.uniform(0.5, 1.5, 2)
    c3 = m[1] * r[1] ** 2 + inertia[1]
    links = np.array([m[0] * r[0] ** 2 + inertia[0] + m[1] * L[0] ** 2 + c3, c3])
    rotor = links * rng.uniform(0.05, [0.4, 0.6])
    hold = 9.81 * np.array([m[0] * r[0] + m[1] * (L[0] + r[1]), m[1] * r[1]])
    coulomb, reduced = hold * rng.uniform(0.02, 0.12, 2), rotor * links / (rotor + links)
    k = (2.0 * np.pi * rng.uniform(8.0, 25.0, 2)) ** 2 * reduced
    rest = {"stiffness": k, "damping": 0.06 * np.sqrt(k * reduced), "torque_limit": 20.0 * hold}
    rest |= {"static_friction": 1.2 * coulomb, "velocity_limit": (30.0, 30.0)}
    return arm(L, m, r, inertia, rotor, hold * rng.uniform(0.0, 0.03, 2), coulomb, **rest)


def simulated_arm(seed: int) -> dict[str, Any]:
    """Return what is found of one drawn arm, and which intervals cover the truth."""
    rng, logs = np.random.default_rng([seed, 3]), []
    truth = drawn(rng)
    start = arm_of(start_of(truth) * rng.uniform(0.7, 1.4, len(UNKNOWNS)), truth)
    for k in range(LOGS):
        sine, cosine = 0.3 * rng.normal(size=(2, 4, 2)) / np.arange(1, 5)[:, np.newaxis]
        motion = _Excitation(np.array([0.0, 0.5]), sine, cosine, 0.25, DURATION, start).fitted()
        logs.append(rehearsed(motion, truth, start, k, NOISE, BANDWIDTH))
    begin = time.process_time()
    found = identify(logs, start)
    seconds = time.process_time() - begin
    values = dict(zip([one.name for one in UNKNOWNS], start_of(truth).tolist(), strict=True))
    values["inertia[0] + motor_inertia[0]"] = values["inertia[0]"] + values["motor_inertia[0]"]
    rows = [row for row in found.rows() if row["low"] is not None]
    covered = {row["name"]: row["low"] <= values[row["name"]] <= row["high"] for row in rows}
    told = [row["value"] / values[row["name"]] for row in rows if row["name"].startswith("stiffness")]
    return {"covered": covered, "stiffness": told, "held_out": found.held_out, "seconds": seconds}


def recorded(folder: Path) -> list[dict[str, Any]]:
    """Return a row for each design in a folder: held-out errors of the published model and of ours [mrad]."""
    paths: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("**/*.csv")):
        if (name := re.search(r"design_([AC])\.?(\d)", str(path))) and name[1] + name[2] in MODELS:
            paths.setdefault(name[1] + name[2], []).append(path)
    rows = []
    for name, ones in paths.items():
        logs, model = [log for path in ones for log in read_log(path)], MODELS[name]
        L, rest = (
            np.array(model[0]),
            {"stiffness": (1500.0, 300.0), "damping": (0.4, 0.4), "torque_limit": (10.0, 10.0)},
        )
        rods = arm(L, (0.6, 0.6), 0.75 * L, 0.05 * L**2, (2e-3, 2e-3), (0.0, 0.0), (0.1, 0.1), **rest)
        begin = time.process_time()
        ours = identify(logs, rods).held_out
        seconds = time.process_time() - begin
        published = identify(logs, arm(*model, **rest)).held_out["start"]
        rows.append({"design": name, "logs": len(logs), "seconds": seconds, "ours": ours, "published": published})
    return rows


def main() -> None:
    """Measure, and write the result."""
    parser = options_of(__doc__)
    parser.add_argument("--arms", type=int, default=40)
    parser.add_argument("--logs", type=Path)
    given = parser.parse_args()
    rows = printed(recorded(given.logs)) if given.logs else []
    arms = printed(simulated_arm(seed) for seed in range(given.arms))
    write(given.json, f"identification.py --arms {given.arms} --logs LOGS", arms=arms, recorded=rows)


if __name__ == "__main__":
    main()
