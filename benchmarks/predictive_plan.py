"""The plan of the model-predictive laws of `predictive.py`, and the quadratic program within the torque limits.

A plan is about the motion that an arm makes under the torque u_ff of its model: x_d, u_ff and the sampled equations
e_(i+1) = A_i e_i + B_i w_i of the deviations e = x - x_d and w = u - u_ff. V is the value function without limits,

    V_i(e) = min over w of |q error/link_angle|² + |q̇ error/link_velocity|² + |w/Γ|² + V_(i+1)(A_i e + B_i w).
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import clarabel
import numpy as np
from scipy import sparse
from scipy.linalg import solve_discrete_are

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import (
    Arm,
    Payload,
    arm_constants,
    dry_frictions,
    frictionless,
    rigid_inverse_dynamics,
    tip_jacobian,
)
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.friction import DryFriction, stribeck_magnitude
from fuzzyarm.envs.physics.integrator import held_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, State, filled, flat
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.known_arm import travel_of

__all__ = [
    *("ARM", "HORIZON", "LIMIT", "PERIOD", "STATES", "SUBSTEPS"),
    *("Model", "Optimum", "Plan", "linearised", "motion", "plan_of"),
]

ARM, PERIOD, SUBSTEPS = ArmParameters(), 1e-3, 5
LIMIT = np.array(ARM.torque_limit)
HORIZON = 100  # samples, twice the slowest time constant of the loop
STATES = 4 * JOINTS
STEPS = np.repeat([1e-5, 1e-3, 1e-1], [4, 4, JOINTS])  # of the differences that make A and B


class Model(NamedTuple):
    """What a plan takes the arm to be.

    Attributes:
        arm: the constants of the equations, with the payload.
        travel_force: f_t, a force at the tip along the direction of travel [N].
        force: F, a force at the tip (2,) [N].
    """

    arm: Arm
    travel_force: float
    force: np.ndarray

    @classmethod
    def of(cls, payload: float) -> Model:
        """Return Table 1 with a payload [kg]."""
        return cls(arm_constants(ARM, Payload(payload)), 0.0, np.zeros(2))


class Plan(NamedTuple):
    """The problem without limits over n samples.

    Attributes:
        x: x_d (n, 8) at the samples.
        u: u_ff (n, 2) [N m] in the middle of the holds that begin there.
        torque: τ_d (n, 2) [N m] of the joints at the samples.
        A, B: (n, 8, 8) and (n, 8, 2).
        Q: weight of e (8, 8); that of w is 1/Γ².
        V: of the samples and of what follows the last one, (n + 1, 8, 8).
        K: w = -K e without limits, (n, 2, 8).
    """

    x: np.ndarray
    u: np.ndarray
    torque: np.ndarray
    A: np.ndarray
    B: np.ndarray
    Q: np.ndarray
    V: np.ndarray
    K: np.ndarray


def plan_of(reference: JointReference, t: np.ndarray, model: Model, link_angle: float, link_velocity: float) -> Plan:
    """Return the plan for samples at times t (n,) [s]; beyond the last one the arm is taken to be as it is there."""
    x, u, torque = motion(reference, t, model)
    force = model.travel_force * travel_of(ARM, x[:, 2:4], x[:, 6:8]) + model.force
    A, B = linearised(x, u, model.arm, force)
    Q = np.diag(np.repeat([0.0, link_angle**-2, 0.0, link_velocity**-2], JOINTS))
    return Plan(x, u, torque, A, B, Q, *_riccati(A, B, Q))


def motion(reference: JointReference, t: np.ndarray, model: Model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x_d (n, 8) at times t (n,) [s], u_ff (n, 2) [N m] half a sample later, and τ_d (n, 2) [N m] at t.

    With τ_d = M q̈_d + C q̇_d + g - Jᵀ (f_t v/|v| + F), the derivatives by differences over a sample, and b = B_t/K_t:
    θ_d = q_d + (τ_d - b τ̇_d + b² τ̈_d)/K_t,   u_ff = I_a θ̈_d + f_v θ̇_d + F(θ̇_d) sign θ̇_d + τ_d.
    """
    arm = model.arm
    stiffness, damping = np.array([arm.stiffness1, arm.stiffness2]), np.array([arm.damping1, arm.damping2])
    inertia, viscous = np.array([arm.motor_inertia1, arm.motor_inertia2]), np.array([arm.viscous1, arm.viscous2])
    dry = DryFriction(*np.array(dry_frictions(arm)).T)
    relaxation = damping / stiffness
    # The samples, and the middles of the holds, each with what lies a sample before and after it.
    links = reference.sample(t + PERIOD * np.array([[[0.0], [0.5]], [[-1.0], [-0.5]], [[1.0], [1.5]]]))
    force = model.travel_force * travel_of(ARM, links.q, links.dq) + model.force
    now, before, after = rigid_inverse_dynamics(*links, arm) - np.einsum(
        "...ij,...i->...j", tip_jacobian(links.q, ARM.length), force
    )
    rate, curvature = (after - before) / (2.0 * PERIOD), (after - 2.0 * now + before) / PERIOD**2
    theta = links.q[0] + (now - relaxation * (rate - relaxation * curvature)) / stiffness
    dtheta = links.dq[0] + (rate - relaxation * curvature) / stiffness
    ddtheta = links.ddq[0] + curvature / stiffness
    u = inertia * ddtheta + viscous * dtheta + stribeck_magnitude(dtheta, dry) * np.sign(dtheta) + now
    return np.hstack([theta[0], links.q[0, 0], dtheta[0], links.dq[0, 0]]), u[1], now[0]


def linearised(x: np.ndarray, u: np.ndarray, arm: Arm, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return A (n, 8, 8) and B (n, 8, 2) of one sample about (x, u) under a tip force (n, 2) [N], without dry friction.

    By central differences of all numbers at once: a copy of the arm for each sample, number and direction.
    """
    smooth = frictionless(arm)
    numbers = STATES + JOINTS
    offsets = np.concatenate([np.diag(STEPS), -np.diag(STEPS)])[:, np.newaxis]
    copies = (np.hstack([x, u]) + offsets).reshape(-1, numbers).T
    push = np.tile(force.T, 2 * numbers)
    start = filled(State, copies[:STATES])
    end = held_of(equations_of(ARM))(
        start, PerJoint(*copies[STATES:]), push, (0.0, 0.0), smooth, PERIOD / SUBSTEPS, SUBSTEPS
    )
    up, down = np.stack(flat(end)).reshape(STATES, 2, numbers, len(x)).transpose(1, 3, 0, 2)
    both = (up - down) / (2.0 * STEPS)
    return both[..., :STATES], both[..., STATES:]


def _riccati(A: np.ndarray, B: np.ndarray, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return V (n + 1, 8, 8) and K (n, 2, 8) of the problem without limits."""
    R = np.diag(LIMIT**-2.0)
    V, K = np.empty((len(A) + 1, STATES, STATES)), np.empty((len(A), JOINTS, STATES))
    V[-1] = solve_discrete_are(A[-1], B[-1], Q, R)
    for k in reversed(range(len(A))):
        K[k] = np.linalg.solve(R + B[k].T @ V[k + 1] @ B[k], B[k].T @ V[k + 1] @ A[k])
        V[k] = Q + A[k].T @ V[k + 1] @ (A[k] - B[k] @ K[k])
        V[k] = 0.5 * (V[k] + V[k].T)
    return V, K


class Optimum:
    """The first w of the problem with or without the limits |u| ≤ Γ.

    Attributes:
        limits: whether there are limits.
        solves: programs solved so far.
        seconds: that they took [s].
    """

    def __init__(self, limits: bool) -> None:
        """Begin to count."""
        self.limits, self.solves, self.seconds = limits, 0, 0.0

    def __call__(self, plan: Plan, k: int, error: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """Return w (2,) [N m] at sample k of a plan for e (8,), where u = u_ff + shift + w with a shift (2,) [N m].

        Where the Riccati recursion keeps the limits over the horizon it is the optimum; else a program is solved.
        """
        first: np.ndarray = -plan.K[k] @ error
        if not self.limits:
            return first
        end = min(k + HORIZON, len(plan.A))
        low, high = -LIMIT - (plan.u[k:end] + shift), LIMIT - (plan.u[k:end] + shift)
        e = error
        for i in range(k, end):
            w = -plan.K[i] @ e
            if (w < low[i - k]).any() or (w > high[i - k]).any():
                return self.program(plan, k, end, error, low, high)
            e = plan.A[i] @ e + plan.B[i] @ w
        return first

    def program(self, plan: Plan, k: int, end: int, error: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the first w (2,) [N m] of the program over samples k to `end`, low ≤ w ≤ high (end - k, 2) [N m].

        Raises:
            SystemExit: the solver finds no optimum.
        """
        begin, n = time.process_time(), end - k
        A, B, states = plan.A[k:end], plan.B[k:end] * LIMIT, STATES * n
        # Variables: w_0 .. w_(n-1) in shares of the limits, e_1 .. e_n.
        cost = sparse.block_diag([sparse.eye(JOINTS * n), *[plan.Q] * (n - 1), plan.V[end]])
        after = sparse.bmat([[None, sparse.csc_matrix((STATES, STATES))], [sparse.block_diag(A[1:]), None]])
        moves = sparse.hstack([-sparse.block_diag(B), sparse.eye(states) - after])
        shares = sparse.eye(JOINTS * n, JOINTS * n + states)
        start = np.concatenate([A[0] @ error, np.zeros(states - STATES)])
        b = np.concatenate([start, (high / LIMIT).ravel(), -(low / LIMIT).ravel()])
        cones: list[Any] = [clarabel.ZeroConeT(states), clarabel.NonnegativeConeT(2 * JOINTS * n)]
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_threads = False, 1
        rows = sparse.vstack([moves, shares, -shares], format="csc")
        upper, linear = sparse.triu(cost, format="csc"), np.zeros(JOINTS * n + states)
        answer = clarabel.DefaultSolver(upper, linear, rows, b, cones, settings).solve()
        self.solves, self.seconds = self.solves + 1, self.seconds + time.process_time() - begin
        if str(answer.status) not in ("Solved", "AlmostSolved"):
            raise SystemExit(f"the quadratic program ended with {answer.status}")
        return np.array(answer.x)[:JOINTS] * LIMIT
