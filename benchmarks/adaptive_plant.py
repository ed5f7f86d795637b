"""The adaptive observer on a second plant that shares no code with its filter.

    python benchmarks/adaptive_plant.py [--json FILE]

The filter predicts with the simulator's own sub-step, which might flatter it. Here the arm is written out again from
equations (1) to (3): classical Runge-Kutta with steps of `STEP`, dry friction smoothed by tanh(v/`SMOOTHING`), the
machining force from its own formula. The policy acts on its samples. Beside each error stands that in the simulator.
About a minute on one core.
"""

from __future__ import annotations

import argparse
import functools
import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fuzzyarm import load_policy, run_episode
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.elementwise import gaussian, sine_cosine
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.fuzzy_policy.laws.learned.network import hyperbolic_tangent
from fuzzyarm.numbers.functions import flat, like, repeat, zeros
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

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


def rate(x, torque, force, a):
    """Return ẋ, pairs in the order of a state x, with a `Plant` a."""
    (theta, (q1, q2), dtheta, (v1, v2)), (l1, l2) = x, a.length
    (c1, c2, c3), (c4, c5), ((s1, k1), (s2, k2), (s12, k12)) = a.inertia, a.gravity, map(sine_cosine, (q1, q2, q1 + q2))
    bend1 = a.stiffness[0] * (theta[0] - q1) + a.damping[0] * (dtheta[0] - v1)
    bend2 = a.stiffness[1] * (theta[1] - q2) + a.damping[1] * (dtheta[1] - v2)
    m11, m12, h = c1 + 2.0 * c2 * k2, c3 + c2 * k2, c2 * s2
    right1 = bend1 + h * v2 * (2.0 * v1 + v2) - c4 * s1 - c5 * s12
    right2 = bend2 - h * v1 * v1 - c5 * s12
    right1 = right1 - (l1 * s1 + l2 * s12) * force[0] + (l1 * k1 + l2 * k12) * force[1]
    right2 = right2 - l2 * s12 * force[0] + l2 * k12 * force[1]
    determinant, motors = m11 * c3 - m12 * m12, []
    for v, u, bend, inertia, viscous, coulomb, static in zip(
        dtheta, torque, (bend1, bend2), a.motor_inertia, a.viscous, a.coulomb, a.static, strict=True
    ):
        slip = coulomb + (static - coulomb) * gaussian(v / a.stribeck)
        motors.append((u - bend - viscous * v - slip * hyperbolic_tangent(v / a.smoothing)) / inertia)
    links = (c3 * right1 - m12 * right2) / determinant, (m11 * right2 - m12 * right1) / determinant
    return dtheta, (v1, v2), tuple(motors), links


@functools.cache
def _advancing() -> Kernel:
    def advance(x, torque, ends, given):
        a, step, count = given
        (first, last), y = ends, x

        def runge_kutta(carried):
            n, x = carried
            share = (n + 0.5) / count
            force = [low + share * (high - low) for low, high in zip(first, last, strict=True)]
            slopes = [rate(x, torque, force, a)]
            for part in (0.5, 0.5, 1.0):
                slopes.append(rate(moved(x, part * step, slopes[-1]), torque, force, a))
            total = [p + 2.0 * q + 2.0 * r + s for p, q, r, s in zip(*map(flat, slopes), strict=True)]
            return n + 1.0, moved(x, step / 6.0, like(x, iter(total)))

        return repeat(count, runge_kutta, (0.0, y))[1], torque, ends

    pair = 0.0, 0.0
    return Kernel(Program(advance, ((pair,) * 4, pair, (pair, pair)), (zeros(plant(0.0)), 0.0, 0.0)))


def moved(x, factor, slope):
    """Return x + factor slope."""
    return like(x, (number + factor * change for number, change in zip(flat(x), flat(slope), strict=True)))


def advance(x: np.ndarray, torque: np.ndarray, force_ends: np.ndarray, a: Plant, step: float, count: int) -> None:
    """Advance x (4, 2) by `count` Runge-Kutta steps; the force goes in a line between its ends (2, 2)."""
    state = x.reshape(1, -1)
    given = np.array([*flat(a), step, count], dtype=np.float64)
    _advancing()((state, np.array(torque, dtype=np.float64)[np.newaxis], force_ends.reshape(1, -1).copy()), given)
    x[:] = state.reshape(4, 2)


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
