"""The same arm in MuJoCo, a peer for accuracy and for speed.

    python benchmarks/mujoco_arm.py [--json FILE]

The model is as good and as fast as MuJoCo allows. Each joint is two hinges of one body: the motor angle q_a, with the
rotor as the hinge's armature, and the twist q_b - q_a, with the joint's spring and damper. These are equations (1) to
(3) exactly, and quicker than rotors on fixed tendons. Torques are generalised forces, quicker than actuators; every
pass the arm has no use for is off; one sweep of PGS solves the friction, as its two rows do not touch each other.

Dry friction is `frictionloss`, a soft constraint q̈_a = -b q̇_a within ±Γ_fc: the static peak Γ_fs is out of its reach,
so this arm has Γ_fs = Γ_fc, or no dry friction. b is as large as the time step allows; with MuJoCo's default, 105/s,
the motors creep. "Half step back" reads the positions of the semi-implicit Euler methods as q - h/2 q̇, at the instant
they belong to, which costs nothing and divides the tip error by up to 14.

The tip error is the largest distance to the event integrator over the nominal 1.5 s, computed torque in either loop.
Speed is that of `mujoco.rollout`, whose C++ threads run many steps open loop, with torques prepared before, nothing
recorded, no observation and no reward. That flatters MuJoCo. About two minutes.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Callable, Sequence
from statistics import median
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, gravity_torque, tip_jacobian, tip_position
from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.event_integrator import integrate
from fuzzyarm.envs.physics.integrator import hold_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.provenance import current_provenance

PERIOD = 1e-3  # s, one control step
OURS = 5  # sub-steps of our default, 0.2 ms
HELD_STEPS = 10  # control steps in one call of rollout
SUBSTEPS = (1, 2, 4, 5, 10, 20, 25, 30, 40, 50, 100)
TABLE_1 = ArmParameters()
COULOMB = dataclasses.replace(TABLE_1, static_friction=TABLE_1.coulomb_friction)
FRICTIONLESS = dataclasses.replace(TABLE_1, static_friction=(0.0, 0.0), coulomb_friction=(0.0, 0.0))
ARMS = {"frictionless": FRICTIONLESS, "Coulomb": COULOMB}


class Method(NamedTuple):
    """A MuJoCo integrator, and whether its positions are read half a step back."""

    integrator: str
    half_step_back: bool = False

    def __str__(self) -> str:
        return self.integrator + (", half step back" if self.half_step_back else "")


EULERS = ("Euler", "implicitfast", "implicit")
METHODS = (*(Method(name, back) for name in EULERS for back in (False, True)), Method("RK4"))
EQUAL_ACCURACY = {"frictionless": (Method("RK4"), PERIOD), "Coulomb": (Method("Euler", True), PERIOD / 30)}
"""By arm, the fastest method and time step [s] of those measured here with at most our tip error at 0.2 ms."""
FASTEST = (Method("Euler"), PERIOD)

STICK_RATE = {**dict.fromkeys(EULERS, 1.5), "RK4": 2.25}
"""b h of the friction constraint with the least tip errors; Euler is stable below 2, RK4 below 2.78."""
IMPEDANCE = 0.9999  # MuJoCo's largest
UNUSED = (
    "contact equality limit actuation clampctrl warmstart filterparent sensor midphase nativeccd multiccd autoreset"
)

TO_HINGES = np.array([[1, 0, 0, 0], [-1, 0, 1, 0], [0, 1, 0, 0], [0, -1, 0, 1]], dtype=float)
"""(q_a1, q_a2, q_b1, q_b2) to MuJoCo's hinges (q_a1, q_b1 - q_a1, q_a2, q_b2 - q_a2)."""
FROM_HINGES = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [1, 1, 0, 0], [0, 0, 1, 1]], dtype=float)

TORQUES = mujoco.mjtState.mjSTATE_QFRC_APPLIED

Advance = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From a state (8,) and the held motor torques (2,) [N m] to the state a control step later."""


# The arm -------------------------------------------------------------------------------------------------------------


def mjcf(parameters: ArmParameters, payload: Payload, integrator: str, timestep: float) -> str:
    """Return the arm as MJCF: x points down, angles from hanging, the payload is part of link 2."""
    p, dry = parameters, max(parameters.coulomb_friction) > 0.0
    if integrator not in STICK_RATE:
        raise ValueError(f"unknown integrator {integrator!r}; choose from: {', '.join(STICK_RATE)}")
    if p.static_friction != p.coulomb_friction:
        raise ValueError(
            f"static_friction = {p.static_friction} N m differs from coulomb_friction = {p.coulomb_friction} N m: "
            "MuJoCo knows no static peak, make them equal"
        )
    # Without its implicit damping Euler is as accurate here and saves a factorisation.
    off = f"{UNUSED} island refsafe{' eulerdamp' * (integrator == 'Euler')}{' constraint' * (not dry)}"
    flags = " ".join(f'{name}="disable"' for name in off.split())
    damping = IMPEDANCE * STICK_RATE[integrator] / timestep  # a negative solreffriction is (-stiffness, -damping)

    def link(j: int, mass: float, center: float, inertia: float, outer: str = "") -> str:
        return f"""<body pos="{p.length[0] * j!r} 0 0">
          <inertial pos="{center!r} 0 0" mass="{mass!r}" diaginertia="{" ".join([repr(max(inertia, 1e-12))] * 3)}"/>
          <joint axis="0 0 1" armature="{p.motor_inertia[j]!r}" damping="{p.viscous_friction[j]!r}"
            frictionloss="{p.coulomb_friction[j]!r}" solreffriction="0 {-damping!r}"
            solimpfriction="{IMPEDANCE} {IMPEDANCE} 1"/>
          <joint axis="0 0 1" stiffness="{p.stiffness[j]!r}" damping="{p.damping[j]!r}"/>{outer}</body>"""

    links = link(0, p.mass[0], p.mass_center[0], p.inertia[0], link(1, *link_with_payload(p, payload)))
    return f"""<mujoco><compiler angle="radian"/>
      <option timestep="{timestep!r}" integrator="{integrator}" gravity="{p.gravity!r} 0 0" solver="PGS" iterations="1"
        tolerance="0" jacobian="dense"><flag {flags}/></option><worldbody>{links}</worldbody></mujoco>"""


def link_with_payload(parameters: ArmParameters, payload: Payload) -> tuple[float, float, float]:
    """Return mass [kg], distance of the mass center from joint 2 [m] and inertia about it [kg m²] of link 2."""
    m, r, carried = parameters.mass[1], parameters.mass_center[1], payload.mass
    at = payload.radius(parameters)
    center = (m * r + carried * at) / (m + carried)
    return m + carried, center, parameters.inertia[1] + m * (r - center) ** 2 + carried * (at - center) ** 2


class MujocoArm:
    """The arm under one method and time step [s], advanced by whole control steps.

    Raises:
        ValueError: unknown integrator, static friction apart from Coulomb's, a time step that is no whole fraction of
            1 ms, or RK4 read half a step back.
    """

    def __init__(
        self, parameters: ArmParameters, method: Method, timestep: float, payload: Payload | None = None
    ) -> None:
        """Compile the model."""
        self.substeps = round(PERIOD / timestep) if 0.0 < timestep < math.inf else 0
        if not (self.substeps and math.isclose(self.substeps * timestep, PERIOD, rel_tol=1e-9)):
            raise ValueError(f"timestep = {timestep!r} s must be a whole fraction of the control step, {PERIOD} s")
        if method == Method("RK4", True):
            raise ValueError("half_step_back is for the Euler methods: RK4's positions are those of the step's end")
        text = mjcf(parameters, payload or Payload(), method.integrator, PERIOD / self.substeps)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data, self.length = mujoco.MjData(self.model), parameters.length
        self.back = 0.5 * PERIOD / self.substeps if method.half_step_back else 0.0

    def load(self, state: np.ndarray) -> None:
        """Set the state (8,), in the order of `dynamics.State` [rad, rad/s]."""
        self.data.qvel[:] = TO_HINGES @ state[4:]
        self.data.qpos[:] = TO_HINGES @ state[:4] + self.back * self.data.qvel

    def advance(self, state: np.ndarray, torque: np.ndarray, force: Sequence[float] = (0.0, 0.0)) -> np.ndarray:
        """Return the state a control step later, under held motor torques [N m] and a held tip force [N].

        J(q_b)ᵀ F is renewed every time step.
        """
        self.load(state)
        calls = self.substeps if any(force) else 1
        for _ in range(calls):
            at_links = tip_jacobian((FROM_HINGES @ self.data.qpos)[2:], self.length).T @ np.asarray(force)
            self.data.qfrc_applied[:] = np.concatenate([torque, at_links]) @ FROM_HINGES
            mujoco.mj_step(self.model, self.data, nstep=self.substeps // calls)
        angles = FROM_HINGES @ (self.data.qpos - self.back * self.data.qvel)
        return np.concatenate([angles, FROM_HINGES @ self.data.qvel])


# Accuracy ------------------------------------------------------------------------------------------------------------


def our_advance(parameters: ArmParameters, substeps: int) -> Advance:
    """Return the control step of `integrator.hold_of`."""
    arm, no_force = np.array(flat(arm_constants(parameters)))[:, np.newaxis], np.zeros((4, 1))
    hold = hold_of(two_joints())

    def advance(state: np.ndarray, torque: np.ndarray) -> np.ndarray:
        lane = state[:, np.newaxis].copy()
        hold(lane, torque[:, np.newaxis], no_force, arm, PERIOD / substeps, substeps)
        return lane[:, 0]

    return advance


def closed_loop(advance: Advance, parameters: ArmParameters) -> tuple[np.ndarray, np.ndarray]:
    """Return states (n + 1, 8) and torques (n, 2) of the nominal circle, computed torque in the loop at 1 kHz."""
    policy, reference = load_policy("computed-torque", robot=parameters), JointReference(parameters=parameters)
    wanted = reference.sample(PERIOD * np.arange(round(reference.duration / PERIOD)))
    q = wanted.q[0]
    gravity = gravity_torque(math.sin(q[0]), math.sin(q.sum()), arm_constants(parameters))
    states = [np.concatenate([q + np.array(gravity) / np.array(parameters.stiffness), q, np.zeros(4)])]
    memory, torques = None, []
    for target in np.concatenate([wanted.q, wanted.dq, wanted.ddq], axis=1):
        torque, memory = policy.predict(np.concatenate([states[-1][[0, 1, 4, 5]], target]), memory)
        torques.append(torque)
        states.append(advance(states[-1], torque))
    return np.array(states), np.array(torques)


@functools.cache
def exact_loop(parameters: ArmParameters) -> tuple[np.ndarray, np.ndarray]:
    """Return `closed_loop` of the event integrator; about a second."""

    def advance(state: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return integrate(state, torque, lambda _: (0.0, 0.0), parameters, Payload(), 0.0, PERIOD)

    return closed_loop(advance, parameters)


def tip_error(advance: Advance, parameters: ArmParameters) -> float:
    """Return the largest distance [m] of the tip from the event integrator's."""
    states, exact = closed_loop(advance, parameters)[0], exact_loop(parameters)[0]
    difference = tip_position(states[:, 2:4], parameters.length) - tip_position(exact[:, 2:4], parameters.length)
    return float(np.hypot(*difference.T).max())


def angle_difference(one: Advance, other: Advance, parameters: ArmParameters) -> float:
    """Return the largest difference [rad] of a motor or link angle under the same torques, those of `exact_loop`."""
    states, torques = exact_loop(parameters)
    first = second = states[0]
    largest = 0.0
    for torque in torques:
        first, second = one(first, torque), other(second, torque)
        largest = max(largest, float(np.abs(first[:4] - second[:4]).max()))
    return largest


# Speed ---------------------------------------------------------------------------------------------------------------


def rollout_inputs(lanes: int, substeps: int, parameters: ArmParameters) -> tuple[np.ndarray, np.ndarray]:
    """Return states (lanes, 9) all along the nominal motion and its torques from there on, (lanes, time steps, 4)."""
    states, torques = exact_loop(parameters)
    starts = np.linspace(0, len(torques) - HELD_STEPS, lanes).astype(int)
    initial = np.hstack([np.zeros((lanes, 1)), states[starts, :4] @ TO_HINGES.T, states[starts, 4:] @ TO_HINGES.T])
    held = torques[starts[:, np.newaxis] + np.arange(HELD_STEPS)] @ FROM_HINGES[:2]
    return initial, np.repeat(held, substeps, axis=1)


def steps_per_second(
    lanes: int, threads: int, timestep: float, integrator: str, seconds: float, parameters: ArmParameters = COULOMB
) -> float:
    """Return control steps of 1 ms per second, all lanes together, of `mujoco.rollout`; ten of them at a call.

    Args:
        lanes: number of arms.
        threads: 1 runs on the calling thread, more in MuJoCo's pool.
        timestep: MuJoCo's time step [s], a whole fraction of 1 ms.
        integrator: one of `STICK_RATE`.
        seconds: how long to measure [s], after one call to warm up.
        parameters: the arm.

    Raises:
        ValueError: an argument is out of range.
    """
    if lanes < 1 or threads < 1 or not 0.0 < seconds < math.inf:
        raise ValueError(f"lanes = {lanes} and threads = {threads} must be at least 1, seconds = {seconds} above 0")
    arm, calls, elapsed = MujocoArm(parameters, Method(integrator), timestep), 0, 0.0
    initial, control = rollout_inputs(lanes, arm.substeps, parameters)
    models, data = [arm.model] * lanes, [mujoco.MjData(arm.model) for _ in range(threads)]
    options = {"control_spec": int(TORQUES), "nstep": control.shape[1], "skip_checks": True}
    with Rollout(nthread=threads if threads > 1 else 0) as pool:
        pool.rollout(models, data, initial, control, **options)
        begin = time.perf_counter()
        while elapsed < seconds:
            pool.rollout(models, data, initial, control, **options)
            calls, elapsed = calls + 1, time.perf_counter() - begin
    return lanes * HELD_STEPS * calls / elapsed


# Tables --------------------------------------------------------------------------------------------------------------


def measure(parameters: ArmParameters) -> list[dict[str, Any]]:
    """Return a row per method and time step; `best`: no other as fast is more accurate."""
    rates = {(i, n): steps_per_second(64, 1, PERIOD / n, i, 0.1, parameters) for i in STICK_RATE for n in SUBSTEPS}
    rows: list[dict[str, Any]] = []
    for method, n in itertools.product(METHODS, SUBSTEPS):
        advance = MujocoArm(parameters, method, PERIOD / n).advance
        errors = {
            "tip_error_um": 1e6 * tip_error(advance, parameters),
            "difference_rad": angle_difference(advance, our_advance(parameters, n), parameters),
        }
        rate = {"steps_per_second": rates[method.integrator, n]}
        rows.append({"method": str(method), "ms": 1e3 * PERIOD / n, **errors, **rate})
    for row in rows:
        as_fast = [other for other in rows if other["steps_per_second"] >= row["steps_per_second"]]
        row["best"] = all(row["tip_error_um"] <= other["tip_error_um"] for other in as_fast)
    return rows


def peer_speeds() -> list[dict[str, Any]]:
    """Return the medians of five rounds that take the configurations in turn."""
    chosen = [(name, *EQUAL_ACCURACY[name]) for name in ARMS] + [("Coulomb", *FASTEST)]
    keys = [(*choice, lanes, threads) for choice in chosen for lanes in (64, 1024) for threads in (1, 2)]
    rounds = [
        [
            steps_per_second(lanes, threads, h, method.integrator, 0.3, ARMS[arm])
            for arm, method, h, lanes, threads in keys
        ]
        for _ in range(5)
    ]
    names = ("arm", "method", "ms", "lanes", "threads", "steps_per_second")
    return [
        dict(zip(names, (arm, str(method), 1e3 * h, lanes, threads, median(rates)), strict=True))
        for (arm, method, h, lanes, threads), *rates in zip(keys, *rounds, strict=True)
    ]


def main() -> None:
    """Measure, print and write."""
    from measuring import options_of, printed, write  # the package's own benchmark loads this file from elsewhere

    options = options_of(__doc__).parse_args()
    versions = current_provenance()["versions"] | {"mujoco": mujoco.__version__}
    arms = {
        name: {"our_tip_error_um": 1e6 * tip_error(our_advance(arm, OURS), arm), "mujoco": printed(measure(arm))}
        for name, arm in ARMS.items()
    }
    write(options.json, "mujoco_arm.py", versions=versions, **arms, speed=printed(peer_speeds()))


if __name__ == "__main__":
    main()
