"""Make the arm of docs/try.md: plant and two exported laws as WebAssembly, in docs/_static/arm.js.

    python benchmarks/browser_arm.py

needs ``pip install ziglang``, whose clang and linker make WebAssembly without a system's tools. The plant is recorded
from the functions that the environment steps, the laws are those of ``fuzzyarm export c``; the reference goes over as
Chebyshev coefficients, whose error is 1e-13 rad, and the machining force as a table. `tests/docs` compares the errors
with the package's.
"""

from __future__ import annotations

import base64
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from fuzzyarm import load_policy
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.integrator import held_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import places
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.export._c_text import MODEL, Recorded
from fuzzyarm.export.c_files import c_name, sources_of
from fuzzyarm.numbers.functions import zeros

LAWS = ("fuzzy-4-tip", "elastic-observer")
PERIOD, SUBSTEPS, DEGREE, NODES = 1e-3, 5, 140, 400
HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "_static" / "arm.js"


def plant_sources(arm: ArmParameters) -> dict[str, str]:
    """Return the plant as C: two torques [N m] and the line of the tip force [N] in, the place of the tip [m] out."""
    physics = equations_of(arm)
    nominal, place, held = physics.plant_of(arm), physics.payload_place(Payload(), arm), held_of(physics)

    def step(given: Sequence[Any], memory: Any) -> tuple[Any, Any]:
        state, payload = memory
        constants = physics.constants(nominal, payload, place, 0.0)
        torque, mean, change = physics.PerJoint(*given[:2]), given[2:4], given[4:6]
        state = held(state, torque, mean, change, constants, PERIOD / SUBSTEPS, float(SUBSTEPS))
        return (state, payload), physics.tip(state.link, constants)

    names = ["torque1", "torque2", "mean_x", "mean_y", "change_x", "change_y"]
    program = Recorded(step, (names, (0.0,) * 6), (zeros(places(physics.State)), 0.0), 2, MODEL, "browser_arm.step")
    return {"plant.h": program.header_text("plant", [], "double"), "plant.c": program.source_text("plant", "double")}


def law_sources() -> dict[str, str]:
    """Return the laws as C, and a header that calls one by its number."""
    files, names = {}, [c_name(law) for law in LAWS]
    for law in LAWS:
        files |= sources_of(law, load_policy(law), "double")
    lines = [f'#include "{name}.h"\nstatic {name}_state of_{name};' for name in names]
    for verb, arguments, given in (("init", "int law", ""), ("step", "int law, const double *o, double *u", ", o, u")):
        calls = [f"    if (law == {k}) {name}_{verb}(&of_{name}{given});" for k, name in enumerate(names)]
        lines += [f"static void law_{verb}({arguments})\n{{", *calls, "}"]
    return files | {"laws.h": "\n".join(lines) + "\n"}


def motion_source(arm: ArmParameters) -> str:
    """Return the reference, the force of Case 2 and the first state as a header."""
    reference = default_reference(arm)
    x = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    times = 0.5 * reference.duration * (x + 1.0)
    q = chebyshev.chebfit(x, reference.sample(times).q, DEGREE)
    rate = 2.0 / reference.duration
    parts = [rate**k * np.pad(chebyshev.chebder(q, k), ((0, k), (0, 0))) for k in range(3)]
    tip = chebyshev.chebfit(x, reference.tip(times).position, DEGREE)
    forces = Schedule.build(reference, CASES["machining"].disturbance, PERIOD).forces
    _, info = FuzzyArmEnv().reset(seed=0)
    start = [*info["q_motor"], *info["q_link"], *info["dq_motor"], *info["dq_link"]]
    tables = {
        "double REFERENCE[6][DEGREE + 1]": np.concatenate(parts, axis=1).T,
        "double TIP[2][DEGREE + 1]": tip.T,
        "float FORCE[STEPS][4]": forces.astype(np.float32),
        "double START[8]": np.array(start),
    }
    head = f"enum {{ DEGREE = {DEGREE}, STEPS = {len(forces)} }};\n"
    return head + "".join(f"static const {name} = {_braces(table)};\n" for name, table in tables.items())


def _braces(table: np.ndarray) -> str:
    if table.ndim:
        return "{" + ", ".join(map(_braces, table)) + "}"
    return repr(float(table)) + "f" * (table.dtype == np.float32)


def main() -> None:
    """Compile, and write the page's part."""
    arm = ArmParameters()
    files = {**plant_sources(arm), **law_sources(), "motion.h": motion_source(arm)}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        sources = [HERE / "browser_arm.c", *(folder / file for file in files if file.endswith(".c"))]
        exports = [f"-Wl,--export={symbol}" for symbol in ("start", "step", "shown")]
        options = ["-target", "wasm32-freestanding", "-Os", "-ffp-contract=off", "-std=c99", "-nostdlib", f"-I{folder}"]
        linking = ["-Wl,--no-entry", "-Wl,--strip-all", *exports, "-o", str(folder / "arm.wasm")]
        command = [sys.executable, "-m", "ziglang", "cc", *options, *map(str, sources), *linking]
        subprocess.run(command, check=True)
        coded = base64.b64encode((folder / "arm.wasm").read_bytes()).decode()
    PAGE.write_text(f'"use strict";\n// Made by python benchmarks/browser_arm.py.\nconst ARM = "{coded}";\n')
    print(f"{PAGE.name}: {PAGE.stat().st_size} bytes")


if __name__ == "__main__":
    main()
