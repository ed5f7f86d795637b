"""The numbers a rollout is judged by, each defined once."""

from __future__ import annotations

import numpy as np

from fuzzyarm.eval.episodes.rollout import Rollout

FRINGE = 0.1  # s


def metrics(rollout: Rollout) -> dict[str, float]:
    """Return the metrics of one episode, over all control steps from the first to the last.

    ``tip_error_max_mm``, ``tip_error_rms_mm``
        Distance between the tip (link side) and its reference at the same instant, maximum and root mean square.
    ``tip_error_max_mid_mm``
        The maximum without the first and the last 0.1 s, in which loads set in and fade; that of all steps if none is
        left.
    ``circularity_link_min_mm``, ``circularity_link_max_mm``
        Range of |tip - center| - R with the link angles (for a path that is no circle: of the tip error's component
        along the left normal of the path). Blind to lag along the path.
    ``circularity_motor_min_mm``, ``circularity_motor_max_mm``
        The same with the motor angles, that is, as if the joints were rigid. No measure of accuracy at the tip: a
        policy that brings the tip to the reference leads the motors millimetres beside it.
    ``joint_error_rms_mrad``
        Root mean square of q_a - q_d over both joints: the error of a policy that leads the motors along the
        reference, and no error of one that leads the tip.
    ``torque_peak_1``, ``torque_peak_2``, ``torque_rms_1``, ``torque_rms_2``
        Largest and root mean square motor torque of each joint [N m].
    ``torque_rate_rms``
        Root mean square of the change of torque from step to step over the control period, both joints [N m/s].
    ``energy``
        Absolute mechanical work of the motors, ∫ |Γ_1 q̇_a1| + |Γ_2 q̇_a2| dt [J].
    ``domain_margin``
        Share of the joint box (25) left unused at the worst instant: 1 - max(|q|/limit, |q̇|/limit), both sides.
    ``return``
        Sum of rewards.
    ``predict_us``
        Median wall time of one `predict` call [µs]; the only metric that differs between runs.
    """
    error, torque = rollout.q_motor - rollout.q_reference, rollout.torque
    rate = np.diff(torque, axis=0) / rollout.control_period
    peak, rms = np.abs(torque).max(axis=0), np.sqrt(np.mean(torque**2, axis=0))
    return {
        "tip_error_max_mm": float(1e3 * rollout.tip_error.max()),
        "tip_error_max_mid_mm": float(1e3 * _middle(rollout).max()),
        "tip_error_rms_mm": float(1e3 * _rms(rollout.tip_error)),
        "circularity_link_min_mm": float(1e3 * rollout.circularity_error.min()),
        "circularity_link_max_mm": float(1e3 * rollout.circularity_error.max()),
        "circularity_motor_min_mm": float(1e3 * rollout.circularity_error_motor.min()),
        "circularity_motor_max_mm": float(1e3 * rollout.circularity_error_motor.max()),
        "joint_error_rms_mrad": float(1e3 * _rms(error)),
        "torque_peak_1": float(peak[0]),
        "torque_peak_2": float(peak[1]),
        "torque_rms_1": float(rms[0]),
        "torque_rms_2": float(rms[1]),
        "torque_rate_rms": float(_rms(rate)) if len(rate) else 0.0,
        "energy": float(np.abs(torque * rollout.dq_motor).sum() * rollout.control_period),
        "domain_margin": float(1.0 - rollout.domain_use.max()),
        "return": float(rollout.reward.sum()),
        "predict_us": 1e6 * rollout.step_time,
    }


def _middle(rollout: Rollout) -> np.ndarray:
    """Return the tip error without the first and the last `FRINGE` seconds, or all of it if nothing is left."""
    time = rollout.time
    inside = (time > FRINGE) & (time <= time[-1] - FRINGE)
    return rollout.tip_error[inside] if inside.any() else rollout.tip_error


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
