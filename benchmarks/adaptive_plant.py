"""The adaptive observer on a second plant that shares no code with its filter.

    python benchmarks/adaptive_plant.py [--json FILE]

The filter predicts with the simulator's own sub-step, which might flatter it. Here the arm is written out anew from
equations (1) to (3): classical Runge-Kutta with steps of `STEP`, dry friction smoothed by tanh(v/`SMOOTHING`), the
machining force from its own formula. The policy acts on its samples. Beside each error stands that in the simulator.
About a minute on one core.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit

from fuzzyarm import load_policy, run_episode
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.provenance import current_provenance

ARM = ArmParameters()
PERIOD, STEP, SMOOTHING = 1e-3, 4e-6, 1e-3  # s, s, rad/s
CASES = {"nominal": (0.0, 0.0), "machining": (1.0, 0.0), "payload": (0.0, 5.0)}
"""Share of the machining force, and payload at the tip [kg]."""
POLICIES = ("adaptive-observer", "elastic-observer", "fuzzy-4-tip")
ENDS = 0.1  # s


class Plant(NamedTuple):
    """What the equations take, in the units of `ArmParameters`; a number for each joint where it is a pair."""

    length: tuple[float, float]
    inertia: tuple[float, float, float]
    gravity: tuple[float, float]
    stiffness: tuple[float, float]
    damping: tuple[float, float]
    motor_inertia: tuple[float, float]
    viscous: tuple[float, float]
    coulomb: tuple[float, float]
    static: tuple[float, float]
    stribeck: float
    smoothing: float


THETA, Q, DTHETA, DQ = range(4)
"""Rows of a state (4, 2) [rad, rad/s], a column for each joint."""


@njit
def rate(x, torque, force, a, out):
    """Fill ẋ (4, 2) of a state x, with a `Plant` a."""
    (q1, q2), (v1, v2) = (x[Q, 0], x[Q, 1]), (x[DQ, 0], x[DQ, 1])
    (l1, l2), (c1, c2, c3), (c4, c5) = a.length, a.inertia, a.gravity
    bend1 = a.stiffness[0] * (x[THETA, 0] - q1) + a.damping[0] * (x[DTHETA, 0] - v1)
    bend2 = a.stiffness[1] * (x[THETA, 1] - q2) + a.damping[1] * (x[DTHETA, 1] - v2)
    m11, m12 = c1 + 2.0 * c2 * math.cos(q2), c3 + c2 * math.cos(q2)
    h = c2 * math.sin(q2)
    jx1, jy1 = -l1 * math.sin(q1) - l2 * math.sin(q1 + q2), l1 * math.cos(q1) + l2 * math.cos(q1 + q2)
    jx2, jy2 = -l2 * math.sin(q1 + q2), l2 * math.cos(q1 + q2)
    right1 = bend1 + h * v2 * (2.0 * v1 + v2) - c4 * math.sin(q1) - c5 * math.sin(q1 + q2)
    right2 = bend2 - h * v1 * v1 - c5 * math.sin(q1 + q2)
    right1 += jx1 * force[0] + jy1 * force[1]
    right2 += jx2 * force[0] + jy2 * force[1]
    determinant = m11 * c3 - m12 * m12
    out[THETA], out[Q] = x[DTHETA], x[DQ]
    for j in range(2):
        v = x[DTHETA, j]
        slip = a.coulomb[j] + (a.static[j] - a.coulomb[j]) * math.exp(-((v / a.stribeck) ** 2))
        bend = bend1 if j == 0 else bend2
        driving = torque[j] - bend - a.viscous[j] * v - slip * math.tanh(v / a.smoothing)
        out[DTHETA, j] = driving / a.motor_inertia[j]
    out[DQ, 0] = (c3 * right1 - m12 * right2) / determinant
    out[DQ, 1] = (m11 * right2 - m12 * right1) / determinant


@njit
def advance(x, torque, force_ends, a, step, count):
    """Advance x by `count` Runge-Kutta steps; the force goes in a line between its ends (2, 2)."""
    k1, k2, k3, k4, force = np.empty((4, 2)), np.empty((4, 2)), np.empty((4, 2)), np.empty((4, 2)), np.empty(2)
    for n in range(count):
        force[:] = force_ends[0] + (n + 0.5) / count * (force_ends[1] - force_ends[0])
        rate(x, torque, force, a, k1)
        rate(x + 0.5 * step * k1, torque, force, a, k2)
        rate(x + 0.5 * step * k2, torque, force, a, k3)
        rate(x + step * k3, torque, force, a, k4)
        x += step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def plant(payload: float) -> Plant:
    """Return the arm with a payload [kg] at the tip."""
    (l1, l2), (m1, m2), (r1, r2), (i1, i2) = ARM.length, ARM.mass, ARM.mass_center, ARM.inertia
    c3 = m2 * r2**2 + i2 + payload * l2**2
    return Plant(
        length=ARM.length,
        inertia=(m1 * r1**2 + i1 + (m2 + payload) * l1**2 + c3, l1 * (m2 * r2 + payload * l2), c3),
        gravity=(ARM.gravity * (m1 * r1 + (m2 + payload) * l1), ARM.gravity * (m2 * r2 + payload * l2)),
        stiffness=ARM.stiffness,
        damping=ARM.damping,
        motor_inertia=ARM.motor_inertia,
        viscous=ARM.viscous_friction,
        coulomb=ARM.coulomb_friction,
        static=ARM.static_friction,
        stribeck=ARM.stribeck_velocity,
        smoothing=SMOOTHING,
    )


def machining(time: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Return the force (n, 2) of Case 2 at times (n,) for tip velocities (n, 2) of the reference."""
    size = 138.0 + 80.0 * np.sin(np.pi * time / 1.5)
    return -(size / np.maximum(np.linalg.norm(velocity, axis=1), 0.01))[:, np.newaxis] * velocity


def tip(q: np.ndarray) -> np.ndarray:
    """Return the tip [m]."""
    (l1, l2), both = ARM.length, q[0] + q[1]
    return np.array([l1 * math.cos(q[0]) + l2 * math.cos(both), l1 * math.sin(q[0]) + l2 * math.sin(both)])


def follow(name: str, share: float, payload: float) -> np.ndarray:
    """Return the tip errors [mm] of one episode."""
    reference, policy, a = JointReference(parameters=ARM), load_policy(name), plant(payload)
    time = PERIOD * np.arange(round(reference.duration / PERIOD) + 1)
    motion, path = reference.sample(time), reference.tip(time)
    force = share * machining(time, path.velocity)
    gravity1, gravity2 = plant(0.0).gravity
    q = motion.q[0]
    held2 = gravity2 * math.sin(q[0] + q[1])
    bent = np.array([gravity1 * math.sin(q[0]) + held2, held2]) / ARM.stiffness
    x, state, errors = np.stack([q + bent, q, np.zeros(2), np.zeros(2)]), None, []
    for k in range(len(time) - 1):
        seen = np.concatenate([x[THETA], x[DTHETA], motion.q[k], motion.dq[k], motion.ddq[k]])
        torque, state = policy.predict(seen, state)
        advance(x, torque, force[k : k + 2], a, STEP, round(PERIOD / STEP))
        errors.append(1e3 * np.linalg.norm(tip(x[Q]) - path.position[k + 1]))
    return np.array(errors)


def errors_of(errors: np.ndarray) -> dict[str, float]:
    """Return what is stored of tip errors [mm] (samples,)."""
    ends = round(ENDS / PERIOD)
    return {
        "max_mm": float(errors.max()),
        "max_but_ends_mm": float(errors[ends:-ends].max()),
        "rms_mm": float(np.sqrt(np.mean(errors**2))),
    }


def main() -> None:
    """Run, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    rows = []
    for name in POLICIES:
        for case, load in CASES.items():
            found = {
                "plant": errors_of(follow(name, *load)),
                "simulator": errors_of(1e3 * run_episode(name, case).tip_error),
            }
            rows.append({"policy": name, "case": case, **found})
            for where, row in found.items():
                print(f"{name:18} {case:10} {where:10}", *(f"{error:8.4f}" for error in row.values()), flush=True)
    if options.json:
        document = {
            "command": "python benchmarks/adaptive_plant.py",
            **current_provenance(),
            "step_s": STEP,
            "smoothing_rad_s": SMOOTHING,
            "rows": rows,
        }
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
