"""A motion that excites every base parameter of the rigid arm: a Fourier series for each joint, within the limits.

    q(t) = q_0 + w(t) a Σ_k (s_k sin 2π k f t + c_k cos 2π k f t),    k = 1..6

w rises from 0 to 1 and falls back to 0 along quintic polynomials, so that the arm begins and ends at rest at q_0, where
it hangs with a bent elbow; f is the base frequency. The amplitude a is the largest for which angles, velocities and the
rigid arm's torques stay within the share `SHARE` of their limits. A local search from random coefficients s_k and c_k
minimises the condition number of the regressor of `_rigid`, scaled as described in `_Excitation.condition`.

`rehearsed` records the motion of the simulated arm under computed-torque control, with encoder noise.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize

from fuzzyarm.common import checks
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.dynamics import tip_jacobian, tip_position
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.reference import Reference, ReferenceSample, TipSample
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.identification._rigid import base_of, regressor
from fuzzyarm.identification.log import Log, joint_table

__all__ = ["SHARE", "rehearsed", "suggested"]

_HARMONICS = 6  # largest number of harmonics in the series
SHARE = 0.6
"""Largest share of the limits on angles, velocities and torques that a suggested motion uses."""
_SHORTEST, _LONGEST = 4.0, 120.0  # s
_FASTEST = 1.5  # Hz, largest frequency of the highest harmonic
_RAMP = 1.0  # s
_HOME = (0.0, 0.5)  # rad
_DRAWS, _REFINEMENTS = 60, 900
_INSTANTS = 400


@dataclasses.dataclass(frozen=True, eq=False)
class _Excitation(Reference):
    """A motion of two joints from rest to rest: the windowed Fourier series in the docstring of this module."""

    home: np.ndarray  # q_0 [rad], (2,)
    sine: np.ndarray  # a s_k [rad], (harmonics, 2)
    cosine: np.ndarray  # a c_k [rad], (harmonics, 2)
    frequency: float  # f [Hz]
    duration: float  # T [s]
    parameters: ArmParameters  # of the arm that moves

    @property
    def joints(self) -> int:
        """Number of joints: 2."""
        return len(self.home)

    def sample(self, t: ArrayLike) -> ReferenceSample:
        """Return q [rad], q̇ [rad/s] and q̈ [rad/s²], shapes (..., 2), at times t [s] of shape (...)."""
        time = np.clip(np.asarray(t, dtype=float), 0.0, self.duration)
        order = 2.0 * math.pi * self.frequency * np.arange(1, len(self.sine) + 1)
        phase = time[..., np.newaxis] * order
        sine, cosine = np.sin(phase), np.cos(phase)
        f = sine @ self.sine + cosine @ self.cosine
        df = (cosine * order) @ self.sine - (sine * order) @ self.cosine
        ddf = -(sine * order**2) @ self.sine - (cosine * order**2) @ self.cosine
        w, dw, ddw = (part[..., np.newaxis] for part in self._window(time))
        return ReferenceSample(self.home + w * f, dw * f + w * df, ddw * f + 2.0 * dw * df + w * ddf)

    def _window(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the window w, which has quintic ramps at both ends, and ẇ [1/s] and ẅ [1/s²] at times (...) [s]."""
        rising = time <= 0.5 * self.duration
        x = np.minimum(np.where(rising, time, self.duration - time) / _RAMP, 1.0)
        sign = np.where(rising, 1.0, -1.0)
        w = x**3 * (10.0 - 15.0 * x + 6.0 * x * x)
        dw = 30.0 * x * x * (1.0 - x) ** 2 / _RAMP
        ddw = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / _RAMP**2
        return w, sign * dw, ddw

    def tip(self, t: ArrayLike) -> TipSample:
        """Return position [m] and velocity [m/s] of the tip, shapes (..., 2), at times t [s] (...)."""
        motion, length = self.sample(t), self.parameters.length
        velocity = np.einsum("...ij,...j->...i", tip_jacobian(motion.q, length), motion.dq)
        return TipSample(tip_position(motion.q, length), velocity)

    def normals(self, t: ArrayLike) -> np.ndarray:
        """Return the unit normals to the left of the tip's path at times t [s], shape (..., 2); (0, 1) at rest."""
        x, y = np.moveaxis(self.tip(t).velocity, -1, 0)
        speed = np.hypot(x, y)
        moving = speed > 0.0
        size = np.where(moving, speed, 1.0)
        return np.stack([-y / size, np.where(moving, x / size, 1.0)], axis=-1)

    def corners(self) -> np.ndarray:
        """Return the times (4,) [s] at which q̈ has a corner, ascending: the ends of the ramps."""
        return np.array([0.0, _RAMP, self.duration - _RAMP, self.duration])

    def largest(self) -> dict[str, np.ndarray]:
        """Return the largest magnitudes (2,) by name: "angle" [rad], "velocity" [rad/s], rigid-arm "torque" [N m]."""
        sample = self.sample(np.linspace(0.0, self.duration, 4001))
        parts = {"angle": sample.q, "velocity": sample.dq, "torque": _torque(sample, self.parameters)}
        return {name: np.abs(part).max(axis=0) for name, part in parts.items()}

    def condition(self) -> float:
        """Return the condition number of the regressor, its rows divided by the torque limits and its columns scaled.

        The scale is the base parameter of the column, but at least so large that the scaled column has an rms of 0.01.
        """
        arm, sample = self.parameters, self.sample(np.linspace(0.0, self.duration, _INSTANTS))
        rows = regressor(*sample, arm.length[0], arm.gravity)
        stacked = np.concatenate([row / limit for row, limit in zip(rows, arm.torque_limit, strict=True)])
        size = np.sqrt(np.mean(stacked**2, axis=0))
        scale = np.maximum(np.abs(base_of(arm)), 1e-2 / np.maximum(size, 1e-12))
        singular = np.linalg.svd((stacked * scale)[:, size > 0.0], compute_uv=False)  # without gravity one column is 0
        return float(singular[0] / max(singular[-1], 1e-300))

    def fitted(self) -> _Excitation:
        """Return this motion with the largest amplitude that stays within the share `SHARE` of the arm's limits."""
        arm, sample = self.parameters, self.sample(np.linspace(0.0, self.duration, _INSTANTS))
        limits = arm.joint_limit, arm.velocity_limit, arm.torque_limit
        swing = np.abs(sample.q - self.home).max(axis=0)
        room = SHARE * np.array(arm.joint_limit) - np.abs(self.home)
        low, high = 0.0, float(np.min(room / np.maximum(swing, 1e-9)))
        for _ in range(12):
            size = 0.5 * (low + high)
            grown = ReferenceSample(self.home + size * (sample.q - self.home), size * sample.dq, size * sample.ddq)
            parts = grown.q, grown.dq, _torque(grown, arm)
            pairs = zip(parts, limits, strict=True)
            inside = all((np.abs(part) <= SHARE * np.array(limit)).all() for part, limit in pairs)
            low, high = (size, high) if inside else (low, size)
        return dataclasses.replace(self, sine=low * self.sine, cosine=low * self.cosine)

    def to_csv(self, period: float = 1e-3) -> str:
        """Return CSV text of time [s], q, q̇, q̈ [rad, rad/s, rad/s²] and expected torques [N m] every `period` [s]."""
        time = np.arange(round(self.duration / period) + 1) * period
        sample = self.sample(time)
        parts = {"q": sample.q, "dq": sample.dq, "ddq": sample.ddq, "torque": _torque(sample, self.parameters)}
        return joint_table(np.round(time, 9), {name: np.round(part, 9) for name, part in parts.items()})


def _torque(sample: ReferenceSample, arm: ArmParameters) -> np.ndarray:
    """Return the torques (N, 2) [N m] that the motion `sample` requires of the rigid arm."""
    rows = regressor(*sample, arm.length[0], arm.gravity)
    return np.stack([row @ base_of(arm) for row in rows], axis=-1)


def suggested(arm: ArmParameters, duration: float = 20.0, seed: int = 0) -> _Excitation:
    """Return a motion to record, for an arm whose parameters are roughly known.

    Args:
        arm: an arm with exact lengths and limits; its other parameters predict the torque that the motion needs.
        duration: duration of the motion, T [s].
        seed: seed of the random coefficients from which the search begins.

    Raises:
        ValueError: the duration is out of range, or gravity is too strong for the arm to hold the initial posture.
    """
    duration = checks.real("duration", duration, "s", low=_SHORTEST, high=_LONGEST)
    rng = np.random.default_rng(checks.whole("seed", seed))
    home = np.minimum(_HOME, 0.25 * np.array(arm.joint_limit))
    still = ReferenceSample(home[np.newaxis], *np.zeros((2, 1, 2)))
    hold = np.abs(_torque(still, arm)[0]) + np.array(arm.coulomb_friction)
    if (hold > SHARE * np.array(arm.torque_limit)).any():
        raise ValueError(
            f"holding the arm at ({home[0]:g}, {home[-1]:g}) rad takes {hold[0]:.4g} and {hold[-1]:.4g} N m; "
            f"allowed: up to {100 * SHARE:g} % of {arm.torque_limit} N m. Check the masses and torque limits of --robot"
        )
    frequency = 2.0 / (duration - 2.0 * _RAMP) if duration < 12.0 else 0.2
    harmonics = max(2, min(_HARMONICS, int(_FASTEST / frequency)))

    def motion(numbers: np.ndarray) -> _Excitation:
        sine, cosine = numbers.reshape(2, harmonics, 2)
        return _Excitation(home, sine, cosine, frequency, duration, arm).fitted()

    def cost(numbers: np.ndarray) -> float:
        return math.log(motion(numbers).condition())

    drawn = [rng.normal(size=4 * harmonics) for _ in range(_DRAWS)]
    best = min(drawn, key=cost)
    found = minimize(cost, best, method="Nelder-Mead", options={"maxfev": _REFINEMENTS, "adaptive": True})
    return motion(found.x)


_NOISE = EncoderNoise(1e-5, 1e-3)  # rad, rad/s, of encoders with about 10⁵ lines


def rehearsed(
    motion: _Excitation,
    arm: ArmParameters,
    known: ArmParameters,
    seed: int,
    noise: EncoderNoise = _NOISE,
    bandwidth: float | None = None,
) -> Log:
    """Return the log of a motion of a simulated arm, one sample per millisecond; the controller's model is `known`.

    `noise`, drawn with `seed`, disturbs angles [rad] and velocities [rad/s]; `bandwidth` is the controller's bandwidth
    [rad/s] (default: the default of `ComputedTorquePolicy`). ValueError: the arm left its limits.
    """
    env = FuzzyArmEnv(parameters=arm, reference=motion, disturbance=Disturbance(encoder_noise=noise))
    policy = ComputedTorquePolicy(known, bandwidth=bandwidth)
    (observation, _), memory = env.reset(seed=seed), None
    measured, torque, terminated, truncated = [], [], False, False
    while not (terminated or truncated):
        action, memory = policy.predict(observation, memory)
        measured.append(observation)
        observation, _, terminated, truncated, info = env.step(action)
        torque.append(info["torque"])
    env.close()
    if terminated:
        seconds = len(torque) * env.control_period
        raise ValueError(
            f"the arm left its limits after {seconds:.3g} s ({info['reason']}): the arm `known`, from which the "
            "controller computes its torques, is too inaccurate for this motion"
        )
    parts = observed(np.array(measured))
    return Log(env.control_period, parts.q_motor, np.array(torque), parts.dq_motor)
