"""The recurrent network of `learned-observer`, from unexplained signals and their context to a residual torque.

Let z be the unexplained signals (zero where everything is explained), c the context, and h the memory (zero when an
episode begins). A gated recurrent unit with no bias in the candidate gives

    s = σ(S_z z + S_h h + S_c c + s_0),    r = σ(R_z z + R_h h + R_c c + r_0),
    n = tanh(A z + (C c)∘(B z) + r∘(U h)),    h⁺ = h + s∘(n - h),
    ρ = clip(m g (V (h⁺∘w) + G (h⁺∘w)∘Δ + D z), ±1),    w = 1 + W tanh(P c + p_0),

with Δ = (u_a - u_o)/R for u_a, u_o and R of `signals`, and g = |δ|²/(|δ|² + δ_0²) for the load δ in z, δ_0 = `QUIET`.
All matrices, s_0, r_0 and p_0 are learned. m is the last entry of c, 0 where the reference is at rest. G determines how
far the law goes beyond u_a. z = 0 and h = 0 give ρ = 0 exactly, for any c. For m = 0 or δ = 0, ρ and its derivatives
with respect to z and h are zero.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.checks import finite_array, listed
from fuzzyarm.envs.periods import checked_period
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.laws.learned.bundle import OBSERVER, Trained, read_bundle, write_folder
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.fuzzy_policy.laws.learned.estimate.signals import QUIET, context_parts, unexplained_parts
from fuzzyarm.fuzzy_policy.laws.learned.network import add_product, hyperbolic_tangent, logistic, real_array
from fuzzyarm.numbers.functions import array, each, maximum, minimum

__all__ = ["LARGEST_MEMORY", "EstimateBundle", "EstimateNetwork", "Layers", "heard", "respond", "shapes_of"]

_GATES = 2  # s and r
_AXES = (2, 3)  # dimensions of the plane or the space of a tip

LARGEST_MEMORY = 512  # entries of h and of tanh(P c); a larger network is refused before memory is allocated


def shapes_of(hidden: int, modulation: int, joints: int, axes: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the arrays by name, for `hidden` entries of h and `modulation` entries of tanh(P c).

    Names are the fields of `EstimateNetwork`; shapes are (rows, columns).
    """
    gates = _GATES * hidden
    unexplained, context = unexplained_parts(joints, axes).belief.stop, context_parts(joints, axes).motion.stop
    return {
        "gate_z": (gates, unexplained),
        "gate_h": (gates, hidden),
        "gate_c": (gates, context),
        "gate_bias": (gates,),
        "A": (hidden, unexplained),
        "B": (hidden, unexplained),
        "C": (hidden, context),
        "U": (hidden, hidden),
        "V": (joints, hidden),
        "G": (joints, hidden),
        "D": (joints, unexplained),
        "P": (modulation, context),
        "p_0": (modulation,),
        "W": (hidden, modulation),
    }


class Layers(NamedTuple):
    """The arrays of a network as the law uses them, in double precision."""

    of_z: Any  # the matrices that multiply z, side by side and transposed, so that no sum runs over the rows
    of_h: Any  # likewise the matrices that multiply h
    of_c: Any  # likewise the matrices that multiply c
    bias: Any  # added to these products
    # V, G, D: of the output
    V: Any
    G: Any
    D: Any
    W: Any  # transposed


@dataclasses.dataclass(frozen=True, eq=False)
class EstimateNetwork:
    """The arrays of the recurrent network, all finite, see `shapes_of`; rows for gate s precede those for gate r."""

    gate_z: np.ndarray  # S_z above R_z
    gate_h: np.ndarray  # S_h above R_h
    gate_c: np.ndarray  # S_c above R_c
    gate_bias: np.ndarray  # s_0, then r_0
    # A, B, C, U: of the candidate n
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    U: np.ndarray
    # V, G, D: of the output
    V: np.ndarray
    G: np.ndarray
    D: np.ndarray
    # P, p_0, W: of the weights w
    P: np.ndarray
    p_0: np.ndarray
    W: np.ndarray

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            real_array(field.name, getattr(self, field.name), 1 if field.name in ("gate_bias", "p_0") else 2)
        if not (1 <= self.hidden <= LARGEST_MEMORY and 1 <= len(self.P) <= LARGEST_MEMORY):
            raise ValueError(f"U has {self.hidden} rows and P has {len(self.P)}; allowed: 1 to {LARGEST_MEMORY} each")
        if len(self.V) == 0 or self.axes not in _AXES:
            needed = "for n joints, V needs n rows, and A needs 11 n + 4 or 11 n + 5 columns"
            raise ValueError(f"the arrays A {self.A.shape} and V {self.V.shape} fit no arm; {needed}")
        for name, shape in shapes_of(self.hidden, len(self.P), self.joints, self.axes).items():
            object.__setattr__(self, name, finite_array(name, getattr(self, name), shape))

    @property
    def hidden(self) -> int:
        """Number of entries of h."""
        return len(self.U)

    @property
    def joints(self) -> int:
        """Number of joints n of the arm."""
        return len(self.V)

    @property
    def axes(self) -> int:
        """Number of tip axes, from the number of columns of A."""
        without: int = unexplained_parts(self.joints, 0).belief.stop
        return int(self.A.shape[1]) - without

    @functools.cached_property
    def layers(self) -> Layers:
        """The arrays joined and transposed as the law uses them."""
        of_z = np.concatenate([self.gate_z, self.A, self.B]).T
        of_h = np.concatenate([self.gate_h, self.U]).T
        of_c = np.concatenate([self.gate_c, self.C, self.P]).T
        bias = np.concatenate([self.gate_bias, np.zeros(self.hidden), self.p_0])
        arrays = of_z, of_h, of_c, bias, self.V, self.G, self.D, self.W.T
        return Layers(*(np.array(array, dtype=np.float64, order="C") for array in arrays))


def heard(z: Any, c: Any, joints: int, axes: int) -> Any:
    """Return m times g, the factor on u_a - u_o and in ρ, for the network's inputs z and c; 0 at rest or unloaded."""
    load, square = unexplained_parts(joints, axes).load.start, 0.0
    for k in range(joints):
        square = square + z[load + k] * z[load + k]
    return c[context_parts(joints, axes).motion.start] * (square / (square + QUIET * QUIET))


def respond(z: Any, c: Any, h: Any, gap: Any, torques: Any, n: Layers, axes: int) -> list[Any]:
    """Return the network's output ρ, joint by joint, for its inputs z and c, and advance its memory h (hidden,).

    `gap` is u_a - u_o and `torques` is R, both [N m]; `n` contains the network's arrays, for `axes` tip axes.
    """
    hidden, total, follow = len(h), array(1), array(1)
    w = array(hidden)
    for i in each(hidden):
        w[i] = 1.0
    _remember(z, c, h, w, n)
    share, rho = heard(z, c, len(gap), axes), []
    for joint in range(len(gap)):
        total[0], follow[0] = 0.0, 0.0
        for i in each(hidden):
            total[0] += n.V[joint, i] * (h[i] * w[i])
            follow[0] += n.G[joint, i] * (h[i] * w[i])
        total[0] += follow[0] * (gap[joint] / torques[joint])
        for k in each(len(z)):
            total[0] += n.D[joint, k] * z[k]
        rho.append(minimum(maximum(share * total[0], -1.0), 1.0))
    return rho


def _remember(z: Any, c: Any, h: Any, w: Any, n: Layers) -> None:
    """Advance the memory h (hidden,) by the inputs z and c, and add W tanh(P c + p_0) to w (hidden,)."""
    hidden, modulation, gates = len(h), n.W.shape[0], _GATES * len(h)
    from_z, from_h, from_c = (array(matrix.shape[1]) for matrix in (n.of_z, n.of_h, n.of_c))
    for numbers in (from_z, from_h):
        for i in each(len(numbers)):
            numbers[i] = 0.0
    for i in each(len(from_c)):
        from_c[i] = n.bias[i]
    add_product(z, n.of_z, from_z)
    add_product(h, n.of_h, from_h)
    add_product(c, n.of_c, from_c)
    for k in each(modulation):
        at = k + (gates + hidden)
        from_c[at] = hyperbolic_tangent(from_c[at])
    add_product(from_c[gates + hidden :], n.W, w)
    for i in each(hidden):
        s = logistic(from_z[i] + from_h[i] + from_c[i])
        r = logistic(from_z[i + hidden] + from_h[i + hidden] + from_c[i + hidden])
        candidate = from_z[i + gates] + from_c[i + gates] * from_z[i + (gates + hidden)] + r * from_h[i + gates]
        h[i] += s * (hyperbolic_tangent(candidate) - h[i])


@dataclasses.dataclass(frozen=True, eq=False)
class EstimateBundle(Trained):
    """A learned observer and its origin."""

    network: EstimateNetwork  # the recurrent network
    arm: ArmParameters | ArmDefinition  # arm of the training run: the two-joint arm, or the name and digest of a robot
    control_period: float  # control period of the training run [s]

    def __post_init__(self) -> None:
        joints = len(ArmParameters().length)
        if isinstance(self.arm, ArmParameters) and (self.network.joints, self.network.axes) != (joints, joints):
            raise ValueError(
                f"it is for the two-joint arm, but its network is for {self.network.joints} joints and a tip with "
                f"{self.network.axes} coordinates"
            )

    def serves(self, arm: AnyArm) -> bool:
        """Return whether the observer was trained for this arm."""
        if isinstance(self.arm, ArmParameters):
            return arm == self.arm
        return isinstance(arm, Robot) and arm.digest == self.arm.digest

    def save(self, folder: Path) -> None:
        """Write the bundle into a folder, see `write_folder`."""
        arm = self.arm
        described = {"parameters": arm.to_dict()} if isinstance(arm, ArmParameters) else {"arm": vars(arm)}
        description = {"schema": OBSERVER, **described, "control_period": self.control_period, **self._record}
        write_folder(folder, description, dataclasses.asdict(self.network))

    @classmethod
    def load(cls, folder: str | Path) -> EstimateBundle:
        """Read and check a bundle; BundleError as in `PolicyBundle.load`."""

        def build(found: _EstimateDescription, tensors: dict[str, np.ndarray], trained: Any) -> EstimateBundle:
            names = {field.name for field in dataclasses.fields(EstimateNetwork)}
            if set(tensors) != names:
                raise ValueError(f"the weights are {listed(tensors)}; needed: {', '.join(sorted(names))}")
            if (found.arm is None) == (found.parameters is None):
                raise ValueError("exactly one of the entries 'parameters' and 'arm' must be given, to describe the arm")
            arm = found.arm or ArmParameters.from_dict(found.parameters or {})
            period = checked_period("control_period", found.control_period)
            return cls(EstimateNetwork(**tensors), arm, period, **trained)

        return read_bundle(Path(folder), OBSERVER, _EstimateDescription, build)


@dataclasses.dataclass(frozen=True)
class _EstimateDescription:
    """The content of ``policy.json``; exactly one of the last two fields is present."""

    schema: str
    control_period: float
    training: dict[str, Any]
    seed: int
    versions: dict[str, Any]
    weights_sha256: str
    curve: list[dict[str, Any]]
    parameters: dict[str, Any] | None = None
    arm: ArmDefinition | None = None
