"""Model-predictive control on the elastic observer's estimate: does it gain anything, here and where the limits bind?

    python benchmarks/predictive.py [--json FILE]

At each sample minimise, over the torques of the next N samples,

    Σ |q error/link_angle|² + |q̇ error/link_velocity|² + |w/Γ|² + V(e_N),   e_(i+1) = A_i e_i + B_i w_i,   |u_i| <= Γ,

with u = u_ff - d̂ + w, the estimate (x̂, d̂), the weights and the target of ``elastic-observer``, none tuned anew. A and B
are the elastic arm without dry friction, linearised along the reference, sample by sample; V is the value function of
the problem without limits to the end of the path. Where no limit binds, the optimum is that of the Riccati recursion;
otherwise Clarabel solves the quadratic program. Unlike the other policies it is given the whole reference beforehand.

Policies: the shipped observers; ``ltv``, the Riccati recursion with its torques clipped (preview, but no limits);
``mpc``; and both with the payload told to feedforward, target, model and observer, which no other policy is: what a
perfect estimate would give. Tasks: the paper's cases, which are reported and not tuned on, and the circle with 5 kg in
durations around the one at which an arm that knew its payload would just reach its limits. Half a minute on one core.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import clarabel
import numpy as np
from scipy import sparse
from scipy.linalg import solve_discrete_are
from scipy.optimize import brentq

from fuzzyarm import load_policy, metrics_of, run_episode
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import in_columns, reader
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.scenario.elastic_reference import ElasticReference
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.fuzzy_policy.known_arm import without_dry_friction
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.gain_schedule import place_in_schedule
from fuzzyarm.fuzzy_policy.laws.observer_gains import estimate_parts, state_part
from fuzzyarm.fuzzy_policy.laws.observer_steps import begin_of, correct_of, predict_of

ARM, PERIOD, SUBSTEPS = ArmParameters(), 1e-3, 5
LIMIT = np.array(ARM.torque_limit)
HORIZON = 100  # samples, twice the slowest time constant of the loop
STATES = 4 * JOINTS
SHARES = (1.1, 1.0, 0.95, 0.9)  # of the shortest duration that a known payload allows
PAYLOAD = 5.0  # kg


def carried(reference: JointReference, t: np.ndarray, payload: float) -> np.ndarray:
    """Return the torques (samples, 2) [N m] that a payload [kg] adds to those that the links need."""
    links = reference.sample(t)
    with_it, without = (
        rigid_inverse_dynamics(links.q, links.dq, links.ddq, arm_constants(ARM, Payload(mass)))
        for mass in (payload, 0.0)
    )
    return with_it - without


def motion(reference: JointReference, t: np.ndarray, payload: float) -> tuple[np.ndarray, np.ndarray]:
    """Return x_d (samples, 8) at the times, and u_ff (samples, 2) [N m] in the middle of the holds that begin there."""
    elastic = ElasticReference(reference)
    motors, links = elastic.sample(t), reference.sample(t)
    bent = motors.q + carried(reference, t, payload) / np.array(ARM.stiffness)
    x = np.hstack([bent, links.q, motors.dq, links.dq])
    middle = t + 0.5 * PERIOD
    hold = elastic.sample(middle)
    dry = (ARM.coulomb_friction, ARM.static_friction, ARM.stribeck_velocity)
    size = [stribeck_magnitude(hold.dq[:, j], *(np.resize(part, JOINTS)[j] for part in dry)) for j in range(JOINTS)]
    friction = np.stack(size, axis=1) * np.sign(hold.dq)
    inertia, viscous = np.array(ARM.motor_inertia), np.array(ARM.viscous_friction)
    links_torque = elastic.torque(middle) + carried(reference, middle, payload)
    return x, inertia * hold.ddq + viscous * hold.dq + friction + links_torque


def linearised(x: np.ndarray, u: np.ndarray, payload: float) -> tuple[np.ndarray, np.ndarray]:
    """Return A (samples, 8, 8) and B (samples, 8, 2) of one control period about (x, u), without dry friction."""
    smooth = without_dry_friction(ARM)
    physics = equations_of(smooth)
    arm, state_in = arm_constants(smooth, Payload(payload)), physics.State

    def moved(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        parts = [physics.PerJoint(x[:, 2 * k], x[:, 2 * k + 1]) for k in range(4)]
        state, torque = state_in(*parts), physics.PerJoint(u[:, 0], u[:, 1])
        load = physics.PerJoint(np.zeros(len(x)), np.zeros(len(x)))
        for _ in range(SUBSTEPS):
            state = physics.loaded_step(state, torque, load, arm, PERIOD / SUBSTEPS)
        return np.stack([column for part in state for column in part], axis=1)

    columns = []
    for place, size in enumerate([1e-5] * 4 + [1e-3] * 4 + [1e-1] * JOINTS):
        dx, du = np.zeros(STATES), np.zeros(JOINTS)
        (dx if place < STATES else du)[place % STATES] = size
        columns.append((moved(x + dx, u + du) - moved(x - dx, u - du)) / (2.0 * size))
    both = np.stack(columns, axis=-1)
    return both[..., :STATES], both[..., STATES:]


class Predictive:
    """The law of the module's docstring, with or without the limits; for one arm on one reference."""

    def __init__(self, reference: JointReference, limits: bool, payload: float = 0.0) -> None:
        """Linearise along the reference with a payload [kg] that is told, and solve the problem without limits."""
        self.limits, self._observer = limits, ElasticObserverPolicy(ARM, PERIOD)
        self.steps = round(reference.duration / PERIOD)
        t = PERIOD * np.arange(self.steps + HORIZON + 2)
        self._x, self._u = motion(reference, t, payload)
        self._A, self._B = linearised(self._x, self._u, payload)
        weights = self._observer.weights
        self._Q = np.diag(np.repeat([0.0, weights.link_angle**-2, 0.0, weights.link_velocity**-2], JOINTS))
        self._R = np.diag(LIMIT**-2.0)
        self._V, self._K = self._riccati()
        self.solves, self.seconds = 0, 0.0
        physics = equations_of(ARM)
        self._arm = arm_constants(ARM, Payload(payload))
        self._begin, self._correct, self._predict = begin_of(physics), correct_of(JOINTS), predict_of(physics)
        self._per_joint = reader(physics.PerJoint, in_columns)

    def _riccati(self) -> tuple[np.ndarray, np.ndarray]:
        A, B = self._A, self._B
        V = np.empty((len(A) + 1, STATES, STATES))
        K = np.empty((len(A), JOINTS, STATES))
        V[-1] = solve_discrete_are(A[-1], B[-1], self._Q, self._R)
        for k in reversed(range(len(A))):
            K[k] = np.linalg.solve(self._R + B[k].T @ V[k + 1] @ B[k], B[k].T @ V[k + 1] @ A[k])
            V[k] = self._Q + A[k].T @ V[k + 1] @ (A[k] - B[k] @ K[k])
            V[k] = 0.5 * (V[k] + V[k].T)
        return V, K

    def predict(
        self, observation: np.ndarray, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Return torques (2,) [N m] and the next state: the sample's number and the prediction (1, 10)."""
        o = observed(np.asarray(observation, dtype=float)[np.newaxis])
        if state is None:
            k, predicted = 0, np.zeros((1, estimate_parts(JOINTS).load.stop))
            self._begin(0, o.q_motor, o.dq_motor, predicted, np.array(ARM.stiffness), self._arm)
        else:
            k, predicted = state[0], state[1].copy()
        schedule = self._observer._schedule
        index, weight = np.empty(2, dtype=np.int64), np.empty(2)
        place_in_schedule(o.q_motor[0], schedule.kept, schedule.cosine, schedule.points, index, weight)
        self._correct(0, o, predicted, self._observer.observer, index, weight, np.empty(2 * JOINTS))
        load = predicted[0, estimate_parts(JOINTS).load]
        error = predicted[0, state_part(JOINTS)] - self._x[k]
        error[:JOINTS] += load / np.array(ARM.stiffness)
        torque = np.clip(self._u[k] - load + self._wanted(k, error, load), -LIMIT, LIMIT)
        physics_torque, physics_load = self._per_joint(torque[np.newaxis], 0), self._per_joint(load[np.newaxis], 0)
        self._predict(predicted, 0, physics_torque, physics_load, self._arm, PERIOD / SUBSTEPS, SUBSTEPS)
        return torque, (min(k + 1, self.steps), predicted)

    def _wanted(self, k: int, error: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Return w (2,) [N m] at sample k for the error (8,)."""
        first = -self._K[k] @ error
        if not self.limits:
            return first
        end = min(k + HORIZON, len(self._A))
        low, high = -LIMIT - (self._u[k:end] - load), LIMIT - (self._u[k:end] - load)
        e = error
        for i in range(k, end):
            w = -self._K[i] @ e
            if (w < low[i - k]).any() or (w > high[i - k]).any():
                return self._program(k, end, error, low, high)
            e = self._A[i] @ e + self._B[i] @ w
        return first

    def _program(self, k: int, end: int, error: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the first w of the quadratic program over the samples from k to `end`, in shares of the limits."""
        begin, n = time.process_time(), end - k
        A, B, states = self._A[k:end], self._B[k:end] * LIMIT, STATES * (end - k)
        # Variables: w_0 .. w_(n-1) in shares of the limits, e_1 .. e_n.
        cost = sparse.block_diag([sparse.eye(JOINTS * n), *[self._Q] * (n - 1), self._V[end]])
        after = sparse.bmat([[None, sparse.csc_matrix((STATES, STATES))], [sparse.block_diag(A[1:]), None]])
        moves = sparse.hstack([-sparse.block_diag(B), sparse.eye(states) - after])
        shares = sparse.eye(JOINTS * n, JOINTS * n + states)
        start = np.concatenate([A[0] @ error, np.zeros(states - STATES)])
        b = np.concatenate([start, (high / LIMIT).ravel(), -(low / LIMIT).ravel()])
        cones = [clarabel.ZeroConeT(states), clarabel.NonnegativeConeT(2 * JOINTS * n)]
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_threads = False, 1
        rows = sparse.vstack([moves, shares, -shares], format="csc")
        upper, linear = sparse.triu(cost, format="csc"), np.zeros(JOINTS * n + states)
        answer = clarabel.DefaultSolver(upper, linear, rows, b, cones, settings).solve()
        self.solves, self.seconds = self.solves + 1, self.seconds + time.process_time() - begin
        if str(answer.status) not in ("Solved", "AlmostSolved"):
            raise SystemExit(f"the quadratic program ended with {answer.status}")
        return np.array(answer.x)[:JOINTS] * LIMIT


def loaded_peak(duration: float) -> float:
    """Return the largest share of the torque limits that the circle in a duration [s] needs with the payload."""
    torque = motion(JointReference(duration=duration), np.linspace(0.0, duration, 2001), PAYLOAD)[1]
    return float(np.max(np.abs(torque) / LIMIT))


def row(name: str, policy: Any, task: str, case: str, reference: JointReference) -> dict[str, Any]:
    """Return what a policy reaches in a task; `policy` acts, and may count its programs."""
    run = run_episode(policy, case, reference=reference)
    metrics = metrics_of(run)
    used = np.abs(run.torque) / LIMIT
    return {
        "policy": name,
        "task": task,
        "completed": run.completed,
        "rms_mm": metrics["tip_error_rms_mm"],
        "max_mm": metrics["tip_error_max_mm"],
        "at_limit": float((used > 1.0 - 1e-9).any(axis=1).mean()),
        "predict_us": metrics["predict_us"],
        "programs": getattr(policy, "solves", 0),
        "program_ms": 1e3 * policy.seconds / policy.solves if getattr(policy, "solves", 0) else None,
    }


def main() -> None:
    """Run every policy in every task, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    shortest = float(brentq(lambda duration: loaded_peak(duration) - 1.0, 0.5, 1.5, xtol=1e-4))
    print(f"with {PAYLOAD:g} kg the circle takes {shortest:.4f} s at least")
    tasks = [(case, case, JointReference()) for case in PAPER_CASES]
    for share in SHARES:
        duration = PERIOD * round(share * shortest / PERIOD)
        tasks.append((f"circle in {duration:.3f} s with {PAYLOAD:g} kg", "payload", JointReference(duration=duration)))
    rows = []
    for task, case, reference in tasks:
        policies: dict[str, Any] = {name: load_policy(name) for name in ("elastic-observer", "adaptive-observer")}
        for payload in (0.0, PAYLOAD) if case == "payload" else (0.0,):
            for name in ("ltv", "mpc"):
                told = ", payload told" if payload else ""
                policies[name + told] = Predictive(reference, name == "mpc", payload)
        for name, policy in policies.items():
            rows.append(found := row(name, policy, task, case, reference))
            print(
                f"{task}: {name}: rms {found['rms_mm']:.4g}, max {found['max_mm']:.4g} mm, "
                f"at a limit {100 * found['at_limit']:.1f} %, {found['programs']} programs, "
                f"{'completed' if found['completed'] else 'ended early'}",
                flush=True,
            )
    if options.json:
        document = {
            "command": "python benchmarks/predictive.py",
            **current_provenance(),
            "horizon": HORIZON,
            "shortest_s": shortest,
            "rows": rows,
        }
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
