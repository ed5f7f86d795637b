"""Speed of the equations of motion of robots: ns a sub-step and lane, beside the hand-written ones and MuJoCo.

    python benchmarks/robot_speed.py [--json FILE]

One thread, 1,024 lanes in blocks of 32, float64, a tip force and every constant per lane. MuJoCo steps the same
elastic robot, one environment in its C loop: each joint is two hinges of one body, the motor angle with the rotor as
armature, and the twist with spring and damper. Passes that the arm has no use for are off; its dry friction is a soft
constraint without a static peak. Times are processor times of the thread, alternating, the median of seven rounds.
About two minutes, half of it compilation.

For two joints the recursion also stands beside the hand-written equations in a control step of a single arm, and in
plain NumPy and torch on the 1,024 lanes: the ratio of the times, and the largest difference of the states.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import mujoco
import numpy as np
import torch
from measuring import options_of, printed, write

from fuzzyarm.envs.physics._serial import physics_of
from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.integrator import held_of, hold_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import Physics, filled, flat
from fuzzyarm.envs.physics.robot import Robot, robot_named

H = 2e-4  # s, a sub-step
LANES, SUBSTEPS, PEER_STEPS, ROUNDS = 1024, 50, 2000, 7
CONTROL_STEP, PAIRS = 5, 25  # sub-steps of 1 ms, and turns of the recursion and the hand-written equations
ROBOTS = ("paper", "planar-3r", "ur5", "panda")
UNUSED = (
    "contact equality limit actuation clampctrl warmstart filterparent sensor midphase nativeccd island refsafe "
    "eulerdamp"
)


def elastic_mjcf(robot: Robot) -> str:
    """Return the elastic robot as MJCF."""

    def numbers(values: object) -> str:
        return " ".join(repr(float(value)) for value in np.ravel(np.asarray(values)))

    body = ""
    for joint in reversed(robot.joints):
        rotation, inertia, drive = np.array(joint.rotation), np.array(joint.link.inertia), joint.drive
        moments = numbers([*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]])
        axis = numbers(joint.axis)
        body = f"""<body pos="{numbers(joint.position)}" xyaxes="{numbers(rotation[:, :2].T)}">
          <inertial pos="{numbers(joint.link.center)}" mass="{joint.link.mass!r}" fullinertia="{moments}"/>
          <joint axis="{axis}" armature="{drive.motor_inertia!r}" damping="{drive.viscous_friction!r}"
            frictionloss="{drive.coulomb_friction!r}"/>
          <joint axis="{axis}" stiffness="{drive.stiffness!r}" damping="{drive.damping!r}"/>{body}</body>"""
    flags = " ".join(f'{name}="disable"' for name in UNUSED.split())
    return f"""<mujoco><option timestep="{H!r}" integrator="Euler" gravity="{numbers(robot.gravity)}" solver="PGS"
      iterations="1" tolerance="0" jacobian="dense"><flag {flags}/></option><worldbody>{body}</worldbody></mujoco>"""


def ours(physics: Physics, constants: np.ndarray, robot: Robot) -> Callable[[], float]:
    """Return a function that takes ns a sub-step and lane of our kernel."""
    joints, generator = len(robot), np.random.default_rng(0)
    state = np.zeros((4 * joints, LANES))
    state[:joints] = state[joints : 2 * joints] = generator.uniform(-1.0, 1.0, (joints, LANES))
    torque = 0.2 * robot.drive("torque_limit")[:, np.newaxis] * generator.uniform(-1.0, 1.0, (joints, LANES))
    force = generator.uniform(-5.0, 5.0, (2 * physics.axes, LANES))
    arm, hold = np.repeat(constants[:, np.newaxis], LANES, axis=1), hold_of(physics)

    def measure() -> float:
        lanes = state.copy()
        start = time.thread_time()
        hold(lanes, torque, force, arm, H, SUBSTEPS)
        elapsed = time.thread_time() - start
        if not np.isfinite(lanes).all():
            raise RuntimeError(f"{robot.name}: the state is not finite")
        return 1e9 * elapsed / (LANES * SUBSTEPS)

    measure()
    return measure


def against_hand_written() -> dict[str, Any]:
    """Return recursive over hand-written time for two joints, by what runs them, and how far the states differ."""
    robot, generator = robot_named("paper"), np.random.default_rng(0)
    generated = physics_of(robot)
    constants = {
        two_joints(): np.array(flat(arm_constants(ArmParameters()))),
        generated: np.array(flat(generated.constants(generated.plant_of(robot), 0.0, 0.0, 0.0))),
    }
    state = generator.uniform(-1.0, 1.0, (8, LANES))
    torque = 0.2 * robot.drive("torque_limit")[:, np.newaxis] * generator.uniform(-1.0, 1.0, (2, LANES))
    force = generator.uniform(-5.0, 5.0, (4, LANES))

    def compiled(physics: Physics, lanes: int, repeats: int) -> np.ndarray:
        now, arm = state[:, :lanes].copy(), np.repeat(constants[physics][:, np.newaxis], lanes, axis=1)
        for _ in range(repeats):
            hold_of(physics)(now, torque[:, :lanes].copy(), force[:, :lanes].copy(), arm, H, CONTROL_STEP)
        return now

    def in_arrays(physics: Physics, take: Callable[[np.ndarray], Any]) -> np.ndarray:
        before = filled(physics.State, take(state))
        arm = filled(physics.Arm, take(np.repeat(constants[physics][:, np.newaxis], LANES, axis=1)))
        line, axes = take(force), physics.axes
        after = held_of(physics)(
            before, physics.PerJoint(*take(torque)), line[:axes], line[axes:], arm, H, CONTROL_STEP
        )
        return np.array([np.asarray(row) for row in flat(after)])

    ways: dict[str, Callable[[Physics], np.ndarray]] = {
        "batch": lambda physics: compiled(physics, LANES, 10),
        "single arm": lambda physics: compiled(physics, 1, 2000),
        "NumPy": lambda physics: in_arrays(physics, np.asarray),
        "torch": lambda physics: in_arrays(physics, torch.from_numpy),
    }
    torch.set_num_threads(1)
    found = {}
    for name, way in ways.items():
        ratios, states = [], [way(physics) for physics in constants]
        for _ in range(PAIRS):
            times = []
            for physics in constants:
                start = time.thread_time()
                way(physics)
                times.append(time.thread_time() - start)
            ratios.append(times[1] / times[0])
        found[name] = {"ratio": median(ratios), "difference": float(np.abs(states[0] - states[1]).max())}
    return found


def peer(robot: Robot) -> Callable[[], float]:
    """Return a function that takes ns a time step of MuJoCo."""
    model = mujoco.MjModel.from_xml_string(elastic_mjcf(robot))
    data = mujoco.MjData(model)

    def measure() -> float:
        mujoco.mj_resetData(model, data)
        data.qvel[:] = 0.5
        start = time.thread_time()
        mujoco.mj_step(model, data, nstep=PEER_STEPS)
        elapsed = time.thread_time() - start
        if not np.isfinite(data.qpos).all():
            raise RuntimeError(f"{robot.name}: MuJoCo's state is not finite")
        return 1e9 * elapsed / PEER_STEPS

    measure()
    return measure


def main() -> None:
    """Measure, print the table, and write it with `--json`."""
    options = options_of(__doc__).parse_args()
    entries = {"hand-written": ours(two_joints(), np.array(flat(arm_constants(ArmParameters()))), robot_named("paper"))}
    for name in ROBOTS:
        robot, physics = robot_named(name), physics_of(robot_named(name))
        entries[name] = ours(physics, np.array(flat(physics.constants(physics.plant_of(robot), 0.0, 0.0, 0.0))), robot)
        entries[f"{name} MuJoCo"] = peer(robot)
    times: dict[str, list[float]] = {name: [] for name in entries}
    for _ in range(ROUNDS):
        for name, measure in entries.items():
            times[name].append(measure())
    found = {name: median(values) for name, values in times.items()}
    rows = [
        {
            "robot": name,
            "joints": len(robot_named(name)),
            "ns": found[name],
            "mujoco_ns": found[f"{name} MuJoCo"],
            "ratio": found[f"{name} MuJoCo"] / found[name],
        }
        for name in ROBOTS
    ]
    result = {"hand_written_ns": found["hand-written"], "generated_over_hand_written": against_hand_written()}
    printed([*rows, result])
    write(options.json, "robot_speed.py", rows=rows, **result)


if __name__ == "__main__":
    main()
