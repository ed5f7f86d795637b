"""The steps of the elastic observer, for compiled laws: correct, act, predict, and the first estimate."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import in_columns, reader, writer
from fuzzyarm.fuzzy_policy.laws.elastic_target import target_parts
from fuzzyarm.fuzzy_policy.laws.observer_gains import Estimate, estimate_parts

__all__ = ["act_of", "begin_of", "correct_of", "estimated_of", "predict_of"]

STATICS_STEPS = 20  # iterations of the fixed point for the first estimate; for Table 1 each gains three digits


@functools.cache
def _add_product_of(rows: int, columns: int) -> Any:
    """Return the compiled function that adds ±G x to y[lane] (rows,), G interpolated between points of a table."""

    @register_jitable(forceinline=True)
    def add_product(
        table: np.ndarray, index: np.ndarray, weight: np.ndarray, x: np.ndarray, sign: float, y: np.ndarray, lane: int
    ) -> None:
        for corner in range(len(index)):
            point, share = index[corner], sign * weight[corner]
            for i in range(rows):
                product = 0.0
                for k in range(columns):
                    product += table[point, i, k] * x[k]
                y[lane, i] += share * product

    return add_product


def _first_of_parts(joints: int) -> Estimate:
    """Return where the first number of each part of (x, d) lies.

    Compiled code addresses the numbers of a lane by these: making a view of a row takes as long as a product with it.
    """
    return Estimate(*(part.start for part in estimate_parts(joints)))


@functools.cache
def estimated_of(joints: int) -> Any:
    """Return the compiled function that gives the parts of (x, d) (..., 5 n) as views."""
    q_motor, q_link, dq_motor, dq_link, load = estimate_parts(joints)

    @register_jitable
    def estimated(array: np.ndarray) -> Estimate:
        return Estimate(
            array[..., q_motor], array[..., q_link], array[..., dq_motor], array[..., dq_link], array[..., load]
        )

    return estimated


@functools.cache
def correct_of(joints: int) -> Any:
    """Return the compiled function that corrects a lane's (x̂, d̂)⁻ by what is measured, and gives ν (2 n,)."""
    q_motor, _, dq_motor, _, _ = _first_of_parts(joints)
    add_product = _add_product_of(5 * joints, 2 * joints)

    @register_jitable(forceinline=True)
    def correct(
        lane: int,
        o: Observation,
        predicted: np.ndarray,
        observer: np.ndarray,
        index: np.ndarray,
        weight: np.ndarray,
        innovation: np.ndarray,
    ) -> None:
        for i in range(joints):
            innovation[i] = o.q_motor[lane, i] - predicted[lane, q_motor + i]
            innovation[joints + i] = o.dq_motor[lane, i] - predicted[lane, dq_motor + i]
        add_product(observer, index, weight, innovation, 1.0, predicted, lane)

    return correct


@functools.cache
def act_of(joints: int) -> Any:
    """Return the compiled function that turns a lane's u_ff into u = u_ff - d̂ - K (x̂ - x_d); `error` is room (4 n,)."""
    q_motor, q_link, dq_motor, dq_link, load = _first_of_parts(joints)
    theta_d, dtheta_d, _ = (part.start for part in target_parts(joints))
    add_product = _add_product_of(joints, 4 * joints)

    @register_jitable(forceinline=True)
    def act(
        lane: int,
        o: Observation,
        target: np.ndarray,
        predicted: np.ndarray,
        stiffness: np.ndarray,
        feedback: np.ndarray,
        index: np.ndarray,
        weight: np.ndarray,
        error: np.ndarray,
        torque: np.ndarray,
    ) -> None:
        for i in range(joints):
            unbent = predicted[lane, load + i] / stiffness[i]
            error[i] = predicted[lane, q_motor + i] - (target[lane, theta_d + i] - unbent)
            error[joints + i] = predicted[lane, q_link + i] - o.q_reference[lane, i]
            error[2 * joints + i] = predicted[lane, dq_motor + i] - target[lane, dtheta_d + i]
            error[3 * joints + i] = predicted[lane, dq_link + i] - o.dq_reference[lane, i]
            torque[lane, i] -= predicted[lane, load + i]
        add_product(feedback, index, weight, error, -1.0, torque, lane)

    return act


@functools.cache
def begin_of(physics: Physics) -> Any:
    """Return the compiled function that fills a lane's first (x̂, d̂)⁻.

    It has K_t (θ - q) = g(q) for the measured θ, links as fast as motors, d = 0.
    """
    joints, gravity, estimated = physics.joints, physics.gravity, estimated_of(physics.joints)
    per_joint = reader(physics.PerJoint, in_columns)

    @register_jitable
    def begin(lane: int, q: np.ndarray, dq: np.ndarray, predicted: np.ndarray, stiffness: np.ndarray, arm: Any) -> None:
        x = estimated(predicted)
        for i in range(joints):
            x.q_motor[lane, i] = x.q_link[lane, i] = q[lane, i]
            x.dq_motor[lane, i] = x.dq_link[lane, i] = dq[lane, i]
            x.load[lane, i] = 0.0
        for _ in range(STATICS_STEPS):
            weight = gravity(per_joint(x.q_link, lane), arm)
            for i in range(joints):
                x.q_link[lane, i] = q[lane, i] - weight[i] / stiffness[i]

    return begin


@functools.cache
def predict_of(physics: Physics) -> Any:
    """Return the compiled function that advances x̂ of a lane over a control period, d̂ held."""
    loaded_step = physics.loaded_step
    read_state, write_state = reader(physics.State, in_columns), writer(physics.State, in_columns)

    @register_jitable
    def predict(predicted: np.ndarray, lane: int, torque: Any, load: Any, arm: Any, h: float, substeps: int) -> None:
        state = read_state(predicted, lane)
        for _ in range(substeps):
            state = loaded_step(state, torque, load, arm, h)
        write_state(predicted, lane, state)

    return predict
