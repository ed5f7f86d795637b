"""The matrices of `fuzzyarm linearise`: plant, open and closed loop of a policy at one posture, as files and figures.

With the deviations x of the plant's states, s of the policy's memory, u of the torques, r of the reference angles, q_a
of the motor angles and q_b of the link angles, and with the outputs y, over one control period,

    plant       x⁺ = A x + B u,                               y = (q_a, q̇_a);
    open loop   (x, s)⁺ = [A 0; G F] (x, s) + [B; 0] u,       y = -(D x + C s), broken at all motors;
    closed loop (x, s)⁺ = [A + B D, B C; G F] (x, s) + [B E_u, B; E_s, 0] (r, d),   y = (q_a, q_b).

The law is u = D x + C s + E_u r + d, with an added torque d, and s⁺ = G x + F s + E_s r. Closing the open loop with
u = -y gives the closed one.
"""

import dataclasses
import io
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.io import savemat

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of, equations_of
from fuzzyarm.envs.physics.records import columns
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.eval._figure_files import figure_style, write_all
from fuzzyarm.eval.stability._linearisation import (
    GainLimits,
    Linearisable,
    LocalLoop,
    gain_limits,
    largest_radius,
    linearise_at,
)

__all__ = ["linear_models"]

_NAME = "linear"  # of the files
_STEPS = (50, 3000)  # fewest and most samples of a step response
_SETTLED = 0.01  # share of a deviation that is left at the end of a step response
_FREQUENCIES = 1000  # of a Bode diagram, up to half the sampling rate


class _StateSpace(NamedTuple):
    """A linear model in discrete time, x⁺ = A x + B u and y = C x + D u, with state x, input u and output y."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray

    def response(self, z: np.ndarray) -> np.ndarray:
        """Return C (z I - A)⁻¹ B + D at points z (k,) of the complex plane, (k, outputs, inputs)."""
        resolvent = z[:, np.newaxis, np.newaxis] * np.eye(len(self.A)) - self.A
        return np.asarray(
            self.C @ np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(z), *self.B.shape))) + self.D
        )

    def steps(self, count: int) -> np.ndarray:
        """Return the responses (count, outputs, inputs) to a unit step of each input from the first sample on."""
        state, found = np.zeros_like(self.B), []
        for _ in range(count):
            found.append(self.C @ state + self.D)
            state = self.A @ state + self.B
        return np.array(found)


@dataclasses.dataclass(frozen=True)
class _LinearModels:
    """The linear models of a policy's loop at one posture of an arm with r joints."""

    posture: np.ndarray  # (r,) [rad]
    control_period: float  # [s]
    loop: LocalLoop
    plant: _StateSpace
    open_loop: _StateSpace
    closed_loop: _StateSpace

    @property
    def radius(self) -> float:
        """The spectral radius of the closed loop."""
        return largest_radius([self.loop])

    def limits(self, delay: float = 0.0) -> GainLimits:
        """Return the factors on the loop gain of all motors between which this loop is stable; delay in samples."""
        return gain_limits([self.loop], delay)

    def one_motor(self, joint: int) -> _StateSpace:
        """Return the open loop of one motor, counted from 0, with the loops of the others closed."""
        A, B, C, D = self.open_loop
        others = np.arange(B.shape[1]) != joint
        return _StateSpace(A - B[:, others] @ C[others], B[:, [joint]], C[[joint]], D[[joint]][:, [joint]])

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the content of the files, by name: ``plant_A``, ..., ``open_loop_A``, ..., ``control_period``."""
        parts = {name: getattr(self, name) for name in ("plant", "open_loop", "closed_loop")}
        matrices = {f"{name}_{key}": m for name, part in parts.items() for key, m in part._asdict().items()}
        return matrices | {"control_period": np.array(self.control_period), "posture": self.posture}

    def write(self, folder: Path) -> list[Path]:
        """Write the matrices as ``.npz`` and ``.mat`` and the figures into a folder; return the paths."""
        texts: dict[str, Any] = {"npz": io.BytesIO(), "mat": io.BytesIO()}
        np.savez(texts["npz"], allow_pickle=False, **self.arrays())
        savemat(texts["mat"], self.arrays())
        texts["mat"] = io.BytesIO(b"MATLAB 5.0 MAT-file".ljust(116) + texts["mat"].getvalue()[116:])  # without a date
        paths = []
        for kind, content in texts.items():
            paths.append(folder / f"{_NAME}.{kind}")
            write_atomically(paths[-1], content.getvalue())
        return paths + write_all({"step": self._step_figure(), "bode": self._bode_figure()}, folder, svg=False)

    def _step_figure(self) -> Figure:
        decay = -math.log(min(max(self.radius, 1e-9), 1.0 - 1e-9))
        count, joints = int(np.clip(-math.log(_SETTLED) / decay, *_STEPS)), len(self.posture)
        if self.radius >= 1.0:
            count = _STEPS[0]
        found, time = self.closed_loop.steps(count), self.control_period * np.arange(count)
        with figure_style():
            figure = Figure(figsize=(9.0, 3.4), layout="constrained")
            axes = figure.subplots(1, 2)
            panels = (
                ("step of a joint's reference", "link angle [rad/rad]", 1.0),
                ("step of a motor's torque", "link angle [µrad/(N m)]", 1e6),
            )
            for kind, (ax, (title, label, factor)) in enumerate(zip(axes, panels, strict=True)):
                for j in range(joints):
                    ax.plot(time, factor * found[:, joints + j, kind * joints + j], label=f"joint {j + 1}")
                ax.set(title=title, xlabel="time [s]", ylabel=label)
            axes[0].legend()
        return figure

    def _bode_figure(self) -> Figure:
        half = math.pi / self.control_period
        omega = np.geomspace(1e-3 * half, (1.0 - 1e-6) * half, _FREQUENCIES)
        with figure_style():
            figure = Figure(figsize=(7.0, 5.2), layout="constrained")
            size, phase = figure.subplots(2, 1, sharex=True)
            for j in range(len(self.posture)):
                found = self.one_motor(j).response(np.exp(1j * omega * self.control_period))[:, 0, 0]
                size.loglog(omega, np.abs(found), label=f"motor {j + 1}")
                degrees = np.degrees(np.unwrap(np.angle(found)))  # on the branch that ends near -180
                phase.semilogx(omega, degrees - 360.0 * np.round((degrees[-1] + 180.0) / 360.0))
            size.axhline(1.0, color="0.6", linewidth=0.8)
            size.set(title="open loop of a motor, the others closed", ylabel="|L|")
            phase.set(xlabel="frequency [rad/s]", ylabel="phase [deg]")
            size.legend()
        return figure


def linear_models(policy: Linearisable, arm: AnyArm, control_period: float, posture: Any = None) -> _LinearModels:
    """Return the linear models of a policy at a posture.

    The policy, such as `load_policy` returns, must be for this arm and for `control_period`, the time between two
    torques [s]. `posture` (joints,) [rad] is within the limits of the angles; None: where the default path begins.

    Raises:
        TypeError: the policy's state is not an array, or its torque is not in double precision.
        ValueError: the posture does not fit the arm, or the policy has no equilibrium within the torque limits there.
    """
    low, high, _, _ = bounds_of(arm)
    at = default_reference(arm).sample(np.zeros(1)).q[0] if posture is None else np.asarray(posture, dtype=float)
    if at.shape != low.shape or not np.all((at >= low) & (at <= high)):
        raise ValueError(
            f"posture = {at.tolist()} rad must be {len(low)} angles, from {low.tolist()} to {high.tolist()} rad"
        )
    loop, by_reference = linearise_at(policy, arm, at, control_period)
    n, r = len(loop.plant), len(low)
    places = columns(equations_of(arm).State)
    A, B = loop.plant[:, :n], loop.plant[:, n:]
    law, unit = loop.law, np.eye(loop.law.shape[1])
    memory = law.shape[1] - n
    none = np.zeros((r, r))
    beside = np.vstack([np.hstack([A, np.zeros((n, memory))]), law[r:]])
    acts = np.vstack([B, np.zeros((memory, r))])
    moved = np.vstack([B @ by_reference[:r], by_reference[r:]])
    return _LinearModels(
        posture=at,
        control_period=control_period,
        loop=loop,
        plant=_StateSpace(
            A, B, np.vstack([np.eye(n)[places.motor], np.eye(n)[places.motor_velocity]]), np.zeros((2 * r, r))
        ),
        open_loop=_StateSpace(beside, acts, -law[:r], none),
        closed_loop=_StateSpace(
            loop.matrix(),
            np.hstack([moved, acts]),
            np.vstack([unit[places.motor], unit[places.link]]),
            np.zeros((2 * r, 2 * r)),
        ),
    )
