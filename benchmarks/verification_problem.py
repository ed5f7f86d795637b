"""Write one closed loop as a benchmark for verification tools: dynamics, controller and specification.

    python benchmarks/verification_problem.py FOLDER

The layout is that of the yearly competition of the verification community (ARCH-COMP): a MATLAB function of the plant,
one of the controller, its data, and the specification in words with the bound that is proven here. The loop is
`computed-torque-tip` on the elastic arm of Table 1 along the paper's circle, 1500 control periods of 1 ms. The bound is
the stored one of `tip_bound.py`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from fuzzyarm.common.arithmetic import at_most
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.dynamics import arm_constants, dry_frictions
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.policies import load_policy
from fuzzyarm.policies.tip_bound import PERIOD, TipClaim, problem_of
from fuzzyarm.proof.tip.plant import PlantSet

POLICY = "computed-torque-tip"
STORED = Path(__file__).parent / "results" / "tip_bound.json"

DYNAMICS = Template("""\
function dx = dynamics(x, u)
% Elastic two-joint arm: x = [theta1 theta2 q1 q2 dtheta1 dtheta2 dq1 dq2], u = motor torques [N m], SI units.
% At a motor velocity of zero the friction is any torque up to the static one (Filippov).
c1 = $c1; c2 = $c2; c3 = $c3; c4 = $c4; c5 = $c5;
j1 = $stiffness1 * (x(1) - x(3)) + $damping1 * (x(5) - x(7));
j2 = $stiffness2 * (x(2) - x(4)) + $damping2 * (x(6) - x(8));
f1 = ($coulomb1 + ($static1 - $coulomb1) * exp(-(x(5) / $stribeck)^2)) * sign(x(5));
f2 = ($coulomb2 + ($static2 - $coulomb2) * exp(-(x(6) / $stribeck)^2)) * sign(x(6));
t1 = j1 + c2 * sin(x(4)) * x(8) * (2 * x(7) + x(8)) - c4 * sin(x(3)) - c5 * sin(x(3) + x(4));
t2 = j2 - c2 * sin(x(4)) * x(7)^2 - c5 * sin(x(3) + x(4));
m11 = c1 + 2 * c2 * cos(x(4)); m12 = c3 + c2 * cos(x(4)); m22 = c3;
d = m11 * m22 - m12^2;
dx = [x(5); x(6); x(7); x(8); ...
  (u(1) - j1 - $viscous1 * x(5) - f1) / $inertia1; (u(2) - j2 - $viscous2 * x(6) - f2) / $inertia2; ...
  (m22 * t1 - m12 * t2) / d; (m11 * t2 - m12 * t1) / d];
""")

CONTROLLER = Template("""\
function [u, xi] = controller(x, xi, r)
% At every sample, held for $period s: x as in dynamics.m (angles and velocities of the motors are measured), xi the
% integral (2), zero at the start, r a row of reference.csv: q_r (2), dq_r (2), ddq_r (2), offset (2).
c1 = $c1; c2 = $c2; c3 = $c3; c4 = $c4; c5 = $c5; w = $bandwidth;
a1 = r(5) - w * (3 * (x(5) - r(3)) + w * (3 * (x(1) - r(1)) + w * xi(1)));
a2 = r(6) - w * (3 * (x(6) - r(4)) + w * (3 * (x(2) - r(2)) + w * xi(2)));
m11 = c1 + 2 * c2 * cos(x(2)); m12 = c3 + c2 * cos(x(2)); m22 = c3;
u1 = (m11 + $inertia1) * a1 + m12 * a2 - c2 * sin(x(2)) * x(6) * (2 * x(5) + x(6)) + c4 * sin(x(1)) + ...
  c5 * sin(x(1) + x(2)) + $viscous1 * x(5) + r(7);
u2 = m12 * a1 + (m22 + $inertia2) * a2 + c2 * sin(x(2)) * x(5)^2 + c5 * sin(x(1) + x(2)) + $viscous2 * x(6) + r(8);
u = [u1; u2];
xi = [xi(1) + $period * (x(1) - r(1)); xi(2) + $period * (x(2) - r(2))];
""")

SPECIFICATION = Template("""\
# Elastic two-joint arm, sampled control, dry friction

- `dynamics.m`: 8 states, 2 inputs; nonlinear, stiff, with dry friction, discontinuous in two states.
- `controller.m`: sampled every $period s, held; `reference.csv` has a row for each sample, `target.csv` the point
  (x, y) that is asked for at the end of each period.
- Initial state, exactly: $start; integral zero.
- Specification: at the end of each of the $steps periods, the tip
  p = ($length1 cos q1 + $length2 cos(q1 + q2), $length1 sin q1 + $length2 sin(q1 + q2)) is within X of its row of
  `target.csv`, and no torque exceeds $limit1 and $limit2 N m.
- Proven by FuzzyArm (`fuzzyarm prove --policy $policy`): X = $bound mm, in $seconds s on one core ($machine).
  Harder instances are its sets `near` and `any-friction`.
""")


def _constants() -> dict[str, str]:
    arm = arm_constants(ArmParameters())
    numbers = {name: getattr(arm, name) for name in ("c1", "c2", "c3", "c4", "c5")}
    for joint in (1, 2):
        for name in ("stiffness", "damping", "viscous", "length"):
            numbers[f"{name}{joint}"] = getattr(arm, f"{name}{joint}")
        dry = dry_frictions(arm)[joint - 1]
        numbers[f"coulomb{joint}"], numbers[f"static{joint}"] = dry.coulomb_friction, dry.static_friction
        numbers[f"inertia{joint}"] = getattr(arm, f"motor_inertia{joint}")
    numbers["stribeck"] = arm.dry_friction1.stribeck_velocity
    return {name: repr(float(value)) for name, value in numbers.items()}


def files() -> dict[str, str]:
    """Return the text of each file by its name."""
    problem = problem_of(TipClaim(POLICY, "nominal", "table-1", PlantSet()))
    document = json.loads(STORED.read_text(encoding="utf-8"))
    circle = {"policy": POLICY, "case": "nominal", "set": "table-1", "path": "circle", "duration": 1.5}
    row = next(row for row in document["rows"] if {key: row[key] for key in circle} == circle)
    steps, limits = problem.schedule.steps, problem.parameters.torque_limit
    policy = load_policy(POLICY)
    rows = told(policy, problem.schedule.references[:steps])
    values = _constants() | {
        "period": repr(PERIOD),
        "bandwidth": repr(float(policy.law.bandwidth)),  # type: ignore[attr-defined]
        "start": "[" + ", ".join(map(repr, problem.start.tolist())) + "]",
        "steps": str(steps),
        "limit1": f"{limits[0]:g}",
        "limit2": f"{limits[1]:g}",
        "policy": POLICY,
        "bound": at_most(row["bound_mm"], 4),
        "seconds": f"{row['cpu_seconds']:.0f}",
        "machine": document["machine"]["cpu"],
    }
    return {
        "dynamics.m": DYNAMICS.substitute(values),
        "controller.m": CONTROLLER.substitute(values),
        "README.md": SPECIFICATION.substitute(values),
        "reference.csv": _table(rows),
        "target.csv": _table(problem.schedule.targets[1:, :2]),
    }


def told(policy: Any, references: np.ndarray) -> np.ndarray:
    """Return θ_d, θ̇_d, θ̈_d and what `TipPolicy` adds to its law's torque (samples, 8), from references (samples, 6)."""
    memory, nothing = np.zeros((1, policy.memory_size)), np.zeros((1, policy.law.memory_size))
    target, torque, own, rows = np.empty((1, 6)), np.empty((1, 2)), np.empty((1, 2)), []
    for row in references:
        seen = np.concatenate([row[:4], row])[np.newaxis]
        policy._target.advance(seen, memory[:, nothing.shape[1] :], target, torque)
        policy.law.act(np.concatenate([target[:, :4], target], axis=1), nothing.copy(), own)
        rows.append([*target[0], *(torque - own)[0]])
    return np.array(rows)


def _table(rows: np.ndarray) -> str:
    return "\n".join(",".join(map(repr, row)) for row in rows.tolist()) + "\n"


def main() -> None:
    """Write the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files().items():
        write_atomically(folder / name, text)
    print(f"written to {folder}: {', '.join(sorted(path.name for path in folder.iterdir()))}")


if __name__ == "__main__":
    main()
