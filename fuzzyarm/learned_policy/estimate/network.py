"""The recurrent network of `learned-observer`: from what is unexplained, and the context, to a residual torque.

With z (signals that vanish where nothing is unexplained), c (context) and h (memory, zero when an episode begins), a
gated recurrent unit whose candidate has no bias gives

    s = σ(S_z z + S_h h + S_c c + s_0),    r = σ(R_z z + R_h h + R_c c + r_0),
    n = tanh(A z + (C c)∘(B z) + r∘(U h)),    h⁺ = h + s∘(n - h),
    ρ = clip(m g (V (h⁺∘w) + G (h⁺∘w)∘Δ + D z), ±1),    w = 1 + W tanh(P c + p_0),

with Δ = (u_a - u_o)/R, m of c, which is 0 where the reference is at rest, and g = |δ|²/(|δ|² + δ_0²) of the load δ in
z, δ_0 = `QUIET`. G says how far beyond u_a the law goes. z = 0 and h = 0 give ρ = 0 exactly, whatever the context.
Where the elastic observer believes in no load, and at rest, it acts alone, and ρ is flat: small deviations are left to
a loop that is stable whatever was learned.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.common.checks import finite_array, instance, shown
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.learned_policy.estimate.signals import CONTEXT, MOTION, QUIET, UNEXPLAINED, UNEXPLAINED_PARTS
from fuzzyarm.learned_policy.functions import add_product, hyperbolic_tangent, logistic

__all__ = ["GATES", "LARGEST_MEMORY", "EstimateNetwork", "heard", "respond", "shapes_of"]

GATES = 2
"""s and r."""

LARGEST_MEMORY = 512
"""Numbers in h and in tanh(P c); a larger network is refused before memory is allocated."""


def shapes_of(hidden: int, modulation: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the arrays by name, for `hidden` numbers in h and `modulation` in tanh(P c).

    Names are those of `EstimateNetwork`, shapes (rows, columns).
    """
    gates = GATES * hidden
    return {
        "gate_z": (gates, UNEXPLAINED),
        "gate_h": (gates, hidden),
        "gate_c": (gates, CONTEXT),
        "gate_bias": (gates,),
        "A": (hidden, UNEXPLAINED),
        "B": (hidden, UNEXPLAINED),
        "C": (hidden, CONTEXT),
        "U": (hidden, hidden),
        "V": (JOINTS, hidden),
        "G": (JOINTS, hidden),
        "D": (JOINTS, UNEXPLAINED),
        "P": (modulation, CONTEXT),
        "p_0": (modulation,),
        "W": (hidden, modulation),
    }


@dataclasses.dataclass(frozen=True, eq=False)
class EstimateNetwork:
    """The arrays of the module's equations, in the shapes of `shapes_of`; the rows of s stand above those of r.

    Attributes:
        gate_z: S_z above R_z.
        gate_h: S_h above R_h.
        gate_c: S_c above R_c.
        gate_bias: s_0, then r_0.
        A, B, C, U: of the candidate n.
        V, G, D: of the output.
        P, p_0, W: of the weights w.

    Raises:
        TypeError: an entry is no array of real numbers.
        ValueError: shapes do not fit together, or a number is not finite.
    """

    gate_z: np.ndarray
    gate_h: np.ndarray
    gate_c: np.ndarray
    gate_bias: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    U: np.ndarray
    V: np.ndarray
    G: np.ndarray
    D: np.ndarray
    P: np.ndarray
    p_0: np.ndarray
    W: np.ndarray

    def __post_init__(self) -> None:
        """Check shapes and numbers."""
        for field in dataclasses.fields(self):
            if instance(field.name, getattr(self, field.name), np.ndarray).dtype.kind not in "fiu":
                raise TypeError(f"{field.name} must hold real numbers; it holds {shown(getattr(self, field.name))}")
        if self.U.ndim != 2 or self.P.ndim != 2:
            raise ValueError(f"U and P have {self.U.ndim} and {self.P.ndim} axes; needed: 2")
        if not (1 <= self.hidden <= LARGEST_MEMORY and 1 <= len(self.P) <= LARGEST_MEMORY):
            raise ValueError(f"U has {self.hidden} rows and P {len(self.P)}; allowed: 1 to {LARGEST_MEMORY}")
        for name, shape in shapes_of(self.hidden, len(self.P)).items():
            object.__setattr__(self, name, finite_array(name, getattr(self, name), shape))

    @property
    def hidden(self) -> int:
        """Numbers in h."""
        return len(self.U)

    @functools.cached_property
    def arguments(self) -> tuple[np.ndarray, ...]:
        """What `respond` takes behind ρ, in double precision.

        These are the matrices of z, of h and of c side by side and transposed, so that no sum runs over the rows; then
        the biases, V, G, D and W.
        """
        of_z = np.concatenate([self.gate_z, self.A, self.B]).T
        of_h = np.concatenate([self.gate_h, self.U]).T
        of_c = np.concatenate([self.gate_c, self.C, self.P]).T
        bias = np.concatenate([self.gate_bias, np.zeros(self.hidden), self.p_0])
        arrays = of_z, of_h, of_c, bias, self.V, self.G, self.D, self.W.T
        return tuple(np.array(array, dtype=np.float64, order="C") for array in arrays)


_LOAD: int = UNEXPLAINED_PARTS.load.start


@register_jitable
def heard(z: np.ndarray, c: np.ndarray) -> float:
    """Return m g of z and c (numbers of `signals`), see the module."""
    square = 0.0
    for k in range(JOINTS):
        square += z[_LOAD + k] * z[_LOAD + k]
    share: float = c[MOTION] * (square / (square + QUIET * QUIET))
    return share


@register_jitable
def respond(
    z: np.ndarray,
    c: np.ndarray,
    h: np.ndarray,
    gap: np.ndarray,
    torques: np.ndarray,
    rho: np.ndarray,
    of_z: np.ndarray,
    of_h: np.ndarray,
    of_c: np.ndarray,
    bias: np.ndarray,
    V: np.ndarray,
    G: np.ndarray,
    D: np.ndarray,
    W: np.ndarray,
) -> None:
    """Fill ρ (n,) from z and c (numbers of `signals`) u_a - u_o and R (n,) [N m], and advance h (hidden,).

    The last eight arrays are `EstimateNetwork.arguments`.
    """
    hidden, modulation, gates = len(h), len(W), GATES * len(h)
    from_z, from_h, from_c, w = np.zeros(of_z.shape[1]), np.zeros(of_h.shape[1]), bias.copy(), np.ones(hidden)
    add_product(z, of_z, from_z)
    add_product(h, of_h, from_h)
    add_product(c, of_c, from_c)
    for k in range(modulation):
        from_c[gates + hidden + k] = hyperbolic_tangent(from_c[gates + hidden + k])
    add_product(from_c[gates + hidden :], W, w)
    for i in range(hidden):
        s = logistic(from_z[i] + from_h[i] + from_c[i])
        r = logistic(from_z[hidden + i] + from_h[hidden + i] + from_c[hidden + i])
        candidate = from_z[gates + i] + from_c[gates + i] * from_z[gates + hidden + i] + r * from_h[gates + i]
        n = hyperbolic_tangent(candidate)
        h[i] += s * (n - h[i])
    share = heard(z, c)
    for joint in range(len(rho)):
        total, follow = 0.0, 0.0
        for i in range(hidden):
            total += V[joint, i] * (h[i] * w[i])
            follow += G[joint, i] * (h[i] * w[i])
        total += follow * (gap[joint] / torques[joint])
        for k in range(len(z)):
            total += D[joint, k] * z[k]
        rho[joint] = min(max(share * total, -1.0), 1.0)
