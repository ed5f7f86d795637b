"""Angles, velocities and accelerations of the motors from a log, without a shift in time.

A Butterworth filter of order 4 runs forwards and backwards over the measurements, so that nothing is delayed;
derivatives are central differences of what is smooth by then. The torque passes the same filter. The motors hold
torque k from instant k to k + 1: at instant k the mean of both neighbours acts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from fuzzyarm.identification.log import Log

__all__ = ["CUTOFF", "Motion", "smoothed"]

CUTOFF = 10.0  # Hz: above what motors draw, and below the vibration of elastic joints
_ORDER = 4
_SETTLING = 3.0  # periods of the cut-off frequency
_HIGHEST = 0.4  # cut-off frequency as a share of the sampling rate's half, at most


class Motion(NamedTuple):
    """Smooth angles [rad], velocities [rad/s], accelerations [rad/s²] and torques [N m], each of shape (N, 2).

    `settled` is the range of the instants that the ends of the log do not disturb, `independent` the number of
    independent samples among them: what the filter has smoothed has fewer than it has samples.
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    torque: np.ndarray
    settled: slice
    independent: float


def smoothed(log: Log, cutoff: float = CUTOFF) -> Motion:
    """Return the motion of a log behind a filter with a cut-off frequency [Hz]."""
    rate = 1.0 / log.period
    cutoff = min(cutoff, 0.5 * _HIGHEST * rate)
    filter_ = butter(_ORDER, cutoff, fs=rate, output="sos")

    def smooth(values: np.ndarray) -> np.ndarray:
        return np.asarray(sosfiltfilt(filter_, values, axis=0))

    q = smooth(log.angle)
    dq = np.gradient(q, log.period, axis=0) if log.velocity is None else smooth(log.velocity)
    held = log.torque.copy()
    held[1:] = 0.5 * (log.torque[1:] + log.torque[:-1])
    edge = min(round(_SETTLING * rate / cutoff), len(q) // 4)
    settled = slice(edge, len(q) - edge)
    independent = (settled.stop - settled.start) * log.period * 2.0 * cutoff
    return Motion(q, dq, np.gradient(dq, log.period, axis=0), smooth(held), settled, independent)
