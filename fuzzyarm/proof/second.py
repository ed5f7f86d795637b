"""A second checker of proven tip bounds, which imports nothing of this package.

It reads the file of a bound and the controller file of its law as JSON and derives the bound again with equations of
its own: plant, law and reference are written below from the pages of the documentation. Of the tube in the file it uses
the centre y(t), the radii and the plan of each friction. On a segment of length h, with a plant z(t), δ = z - y,
ξ = (δθ, δq, δθ̇, δq̇, δu) and the constants p = p_0 + Δp π, |π| <= 1, all of this must hold:

1. *Mean values.* δ obeys ξ̇ = A ξ + b (a(t) π + w(t)), where A is linearised at the middle of the segment, a(t) are the
   torques of the constants along the centre, and |w| <= w̄ bounds what A omits, wherever |S ξ| <= ρ: defects of the
   centre, derivatives of the links' torques on the tube minus those in A times ρ, products Δp ρ, and friction.
2. *Friction.* Γ_f ∈ -μ F(|v|) Sgn(v) by the plan of the file: a motor is HELD if it rests at the start and its net
   torque stays below μ F(0); it may SLIP if its velocity keeps its sign on the tube; MONOTONE is Lemma 2 of the page,
   MIXED is every case of Lemma 1 that the velocities allow; ANY is any torque up to the static one.
3. *First exit.* With (1) and (2), |S ξ| <= ρ' < ρ on the segment (Lemma 3).
4. *Sample.* The law is linearised by its Jacobian on the box of measured states, with its rounding as a remainder.

Balls (Arb) hold plant, law, reference and exponentials. A course f(s), s in [-1, 1], is a Chebyshev interpolant in N
nodes; it errs by 4 M r^(1-N)/(r - 1) where |f| <= M in the ellipse with semi-axes of sum r. The set of deviations is a
zonotope G g, |g| <= 1, in doubles whose rounding is bounded: its first columns belong to the constants, and no column
is ever merged with another.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from flint import acb, arb, arb_mat, ctx

__all__ = ["LOOSER", "SecondCheck", "check"]

LOOSER = 1.02
"""The checker's own bound may be larger than the file's by this factor; its sentence states its own bound."""

_ROOM = 1.1  # factor on the radii of the file: enclosures here are wider in places
_FLOOR = np.repeat([1e-11, 1e-11, 1e-8, 1e-8, 1e-11, 1e-8, 1e-6, 1e-5, 1e-5], 2)  # far below a µm of the tip
_FLOORS = (0.01, 0.1, 1.0)  # shares of it that are added to the radii, the first that do
_LAWS = ("fuzzy-4-tip", "fuzzy-4-sampled-tip")
_CONTROLLERS = Path(__file__).parents[1] / "fuzzy_policy" / "controllers"
_PERIOD, _BITS, _SMALL, _ULPS, _UP = 1e-3, 96, 2.0**-44, 2.0**-48, 1.0 + 1e-10
_NODES, _RADII, _TURNS = 12, (8.0, 16.0, 32.0), 96
_BOTH = range(2)
# Rows of S; those of the file, in its order. The first eight are ξ without δu.
_Q, _V, _DQ, _BEND, _RATE, _NET, _MOTOR, _LINK = (slice(i, i + 2) for i in range(2, 18, 2))
_MOTORS, _JOINTS, _LINKS = (slice(i, i + 2) for i in range(0, 6, 2))  # channels of w
_DEFAULTS: dict[str, Any] = {
    **dict.fromkeys(("mass", "motor_inertia", "stiffness", "damping", "dry_friction", "viscous_friction"), [1.0, 1.0]),
    "payload": [0.0, 0.0], "force": [1.0, 1.0], "friction": "law", "force_swing": 0.0, "force_course": 0.0,
    "noise": [0.0, 0.0], "late": 0,
}  # fmt: skip
_RANGES = tuple(_DEFAULTS)[:6]
_TABLE_1: dict[str, Any] = {
    "length": [0.5, 0.5], "mass": [15.0, 9.0], "inertia": [0.31, 0.19], "mass_center": [0.25, 0.25],
    "viscous_friction": [0.14, 0.14], "gravity": 9.81, "motor_inertia": [2.71, 0.5], "stiffness": [6.4e4, 1.2e4],
    "damping": [20.4, 3.8], "static_friction": [6.0, 3.0], "coulomb_friction": [4.0, 2.0], "stribeck_velocity": 0.1,
    "torque_limit": [500.0, 250.0],
}  # fmt: skip


class _Refused(ValueError):
    """The claim does not follow; the message says why."""


@dataclasses.dataclass(frozen=True)
class SecondCheck:
    """The outcome of the second checker."""

    path: Path  # the file
    verdict: str  # "PROVEN", "NOT PROVEN" or "NOT CHECKED", which is for laws and motions that it does not know
    reason: str  # why it is not proven or not checked; empty if it is proven
    bound: float  # of the tip error, found here [m]; nan without a proof
    about: str  # law, set and motion in words, by the numbers of the file
    seconds: float  # duration of the check

    @property
    def proven(self) -> bool:
        """Whether the claim was derived again."""
        return self.verdict == "PROVEN"

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        found = {"file": str(self.path), "checker": "second", "proven": self.proven, "reason": self.reason}
        return found | {"bound": self.bound if self.proven else None, "about": self.about, "seconds": self.seconds}

    def to_text(self) -> str:
        """Return the result as text."""
        said = f"tip within {math.ceil(1e10 * self.bound) / 1e7:.4g} mm, proven" if self.proven else self.reason
        return f"  second checker: {self.verdict} ({self.seconds:.1f} s): {said}; {self.about}"


def check(path: Path) -> SecondCheck:
    """Derive the bound of a file again; OSError or ValueError if it cannot be read."""
    begin = time.perf_counter()
    document = json.loads(Path(path).read_bytes(), parse_constant=_no_number)
    try:
        claim = _Claim(document)
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"{path}: not the file of a bound: {error!r}") from None

    def answer(verdict: str, reason: str, bound: float = math.nan) -> SecondCheck:
        return SecondCheck(Path(path), verdict, reason, bound, claim.words(), time.perf_counter() - begin)

    if unknown := claim.unknown():
        return answer("NOT CHECKED", unknown)
    bits, done = ctx.prec, 0
    try:
        ctx.prec = _BITS
        tips = []
        for done, tip in enumerate(_Tube(claim), 1):
            if not tip <= LOOSER * claim.tip[done - 1]:
                raise _Refused(f"the tip may err by {1e3 * tip:.4g} mm, and the file says {1e3 * claim.tip[done - 1]:.4g}")
            tips.append(tip)
        if not max(tips) <= LOOSER * claim.bound:
            raise _Refused(f"the tip may err by {1e3 * max(tips):.4g} mm")
    except (ValueError, ArithmeticError, LookupError, TypeError) as error:
        return answer("NOT PROVEN", f"control step {done + 1}: {error}")
    finally:
        ctx.prec = bits
    return answer("PROVEN", "", max(tips))


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no number")


class _Claim:
    """The content of a file."""

    def __init__(self, document: dict[str, Any]) -> None:
        self.schema, self.policy, self.case = document["schema"], str(document["policy"]), document["case"]
        self.path, self.duration, self.files = document["path"], float(document["duration"]), document["files"]
        self.plants: dict[str, Any] = dict(_DEFAULTS) | document["plants"]
        self.bound, self.tip, self.steps = float(document["bound"]), document["tip"], document["steps"]

    def unknown(self) -> str:
        """Return what of the claim this checker does not know; empty if it knows all of it."""
        fixed = {name: value for name, value in _DEFAULTS.items() if name not in (*_RANGES, "friction")}
        changed = [name for name, value in self.plants.items() if name not in _RANGES and fixed.get(name, value) != value]
        changed += [name for name in self.plants if name not in _DEFAULTS]
        if self.policy not in _LAWS:
            return f"the second checker does not know the law {self.policy!r}; it knows {' and '.join(_LAWS)}"
        if self.case != "nominal" or self.path != "circle" or changed or self.schema != "fuzzyarm-tip-bound/1":
            odd = [*changed, *(str(x) for x in (self.schema, self.case, self.path))]
            return f"the second checker knows the circle of case nominal and no {odd[0]}" if changed else (
                f"the second checker knows the circle of case nominal in one tube, not {', '.join(odd)}"
            )
        return ""

    def words(self) -> str:
        """Return law, set and motion in words; the label of the file is not used."""
        said = [f"{name} {value}" for name, value in self.plants.items() if value != _DEFAULTS.get(name)]
        plants = f"with {', '.join(said)}" if said else "table-1"
        return f"{ascii(self.policy)[1:-1]}, set {plants}, {len(self.tip)} samples of the {self.path} in {self.duration:g} s"


# Plant -----------------------------------------------------------------------------------------------------------


def _upper(x: Any) -> float:
    """Return a float that is not below |x| of a ball."""
    found = float(x.abs_upper()) * (1.0 + 2.0**-50) + 1e-300
    if not math.isfinite(found):
        raise _Refused("an enclosure is not finite")
    return found


def _ends(x: Any) -> tuple[float, float]:
    """Return floats that enclose a ball from both sides."""
    middle, radius = float(x.mid()), _upper(x - x.mid())
    spare = 2.0**-50 * (abs(middle) + radius)
    return middle - radius - spare, middle + radius + spare


def _hull(low: float, high: float) -> Any:
    return arb(low).union(arb(high))


def _read(value: Any) -> Any:
    """Return nested lists of hexadecimal floats as floats."""
    return float.fromhex(value) if isinstance(value, str) else [_read(part) for part in value]


def _lumped(robot: dict[str, Any], link: int) -> list[Any]:
    """Return what a link adds to c_1, ..., c_5: m r² + I etc., from the equations of motion."""
    L, m, r, inertia = (arb(x) for x in (robot["length"][0], *(robot[n][link] for n in ("mass", "mass_center", "inertia"))))
    g, own = arb(robot["gravity"]), m * r * r + inertia
    return [own + m * L * L, m * L * r, own, m * g * L, m * g * r] if link else [own, arb(0), arb(0), m * g * r, arb(0)]


def link_torque(c: list[Any], q: Any, v: Any, a: Any) -> list[Any]:
    """Return M(q) q̈ + C(q, q̇) q̇ + g(q) [N m] of the constants c_1, ..., c_5."""
    cos2, sin2, sin12 = q[1].cos(), q[1].sin(), (q[0] + q[1]).sin()
    first = (c[0] + 2 * c[1] * cos2) * a[0] + (c[2] + c[1] * cos2) * a[1] - c[1] * sin2 * v[1] * (2 * v[0] + v[1])
    second = (c[2] + c[1] * cos2) * a[0] + c[2] * a[1] + c[1] * sin2 * v[0] * v[0]
    return [first + c[3] * q[0].sin() + c[4] * sin12, second + c[4] * sin12]


def link_slopes(c: list[Any], q: Any, v: Any, a: Any) -> list[list[list[Any]]]:
    """Return the derivatives of `link_torque` by q, q̇ and q̈, (2, 2) each."""
    cos2, sin2, cos12 = q[1].cos(), q[1].sin(), (q[0] + q[1]).cos()
    pull, k = c[4] * cos12, c[1] * sin2
    bent = -k * (2 * a[0] + a[1]) - c[1] * cos2 * v[1] * (2 * v[0] + v[1]) + pull
    angle = [[c[3] * q[0].cos() + pull, bent], [pull, c[1] * cos2 * v[0] * v[0] - k * a[0] + pull]]
    speed = [[-2 * k * v[1], -2 * k * (v[0] + v[1])], [2 * k * v[0], arb(0)]]
    return [angle, speed, [[c[0] + 2 * c[1] * cos2, c[2] + c[1] * cos2], [c[2] + c[1] * cos2, c[2]]]]


class _Plant:
    """The arms of a set: constants in the middle, in balls, and the half widths of their ranges."""

    def __init__(self, robot: dict[str, Any], plants: dict[str, Any]) -> None:
        ranges = {name: [_range(plants[name], j) for j in _BOTH] for name in _RANGES}
        middle = {name: [(arb(low) + arb(high)) / 2 for low, high in both] for name, both in ranges.items()}
        half = {name: [(arb(high) - arb(low)) / 2 for low, high in both] for name, both in ranges.items()}
        self.any = plants["friction"] == "any"
        if plants["friction"] not in ("law", "any"):
            raise _Refused(f"friction {plants['friction']!r}")

        def of(field: str, name: str) -> list[Any]:
            return [middle[name][j] * arb(robot[field][j]) for j in _BOTH]

        self.inertia, self.viscous = of("motor_inertia", "motor_inertia"), of("viscous_friction", "viscous_friction")
        self.stiffness, self.damping = of("stiffness", "stiffness"), of("damping", "damping")
        self.static, self.coulomb = of("static_friction", "dry_friction"), of("coulomb_friction", "dry_friction")
        self.stribeck, self.length = arb(robot["stribeck_velocity"]), [arb(x) for x in robot["length"]]
        links = [_lumped(robot, j) for j in _BOTH]
        self.c = [sum((middle["mass"][j] * links[j][i] for j in _BOTH), arb(0)) for i in range(5)]
        self.masses = {j: [half["mass"][j] * x for x in links[j]] for j in _BOTH if not half["mass"][j].is_zero()}
        self.share = [_share(*ranges["dry_friction"][j]) for j in _BOTH]
        self.half = {
            name: [_upper(half[name][j] * arb(robot[name][j])) if not half[name][j].is_zero() else 0.0 for j in _BOTH]
            for name in ("motor_inertia", "viscous_friction", "stiffness", "damping")
        }
        kinds = [(name, j) for name in _RANGES for j in _BOTH if not half[name][j].is_zero()]
        self.column = {kind: i for i, kind in enumerate(kinds)}  # of the zonotope, by constant

    def friction(self, joint: int, v: Any) -> Any:
        """Return F(v) [N m] of the middle, as an even function of the velocity."""
        fall = (-(v / self.stribeck) * (v / self.stribeck)).exp()
        return self.coulomb[joint] + (self.static[joint] - self.coulomb[joint]) * fall

    def slope(self, joint: int, v: Any) -> Any:
        """Return F'(v) [N m s/rad]."""
        x, depth = v / self.stribeck, self.static[joint] - self.coulomb[joint]
        return -2 * depth / self.stribeck * x * (-x * x).exp()

    def slopes(self, joint: int, low: float, high: float) -> tuple[float, float]:
        """Return the ends of F' on speeds in [low, high], piece by piece."""
        cuts = np.linspace(low, high, 9).tolist()
        found = [_ends(self.slope(joint, _hull(a, b))) for a, b in zip(cuts[:-1], cuts[1:], strict=True)]
        steepest = self.steepest(joint)
        return max(min(x for x, _ in found), -steepest), min(max(x for _, x in found), steepest)

    def steepest(self, joint: int) -> float:
        """Return a bound of |F'|, which is (F_s - F_c)/v_s times the largest 2 x exp(-x²), √2 e^(-1/2)."""
        depth = self.static[joint] - self.coulomb[joint]
        return _upper(depth / self.stribeck * arb(2).sqrt() * arb(-0.5).exp())

    def strength(self, joint: int, slowest: float, fastest: float) -> tuple[float, float]:
        """Return the ends of F on speeds: it falls."""
        return _ends(self.friction(joint, arb(fastest)))[0], _ends(self.friction(joint, arb(slowest)))[1]


def _range(given: Any, joint: int) -> tuple[float, float]:
    low, high = given[joint] if isinstance(given[0], list) else given
    if not 0.0 <= float(low) <= float(high) < 1e6:
        raise _Refused(f"the range {given} of a set")
    return float(low), float(high)


def _share(low: float, high: float) -> tuple[float, float]:
    """Return the ends of the dry friction's factor relative to its middle."""
    if low == high:
        return 1.0, 1.0
    middle = (arb(low) + arb(high)) / 2
    return _ends(arb(low) / middle)[0], _ends(arb(high) / middle)[1]


# Reference and law -----------------------------------------------------------------------------------------------


def _about(x: Any, radius: float) -> Any:
    return x + arb(0, radius)


def _solved(J: list[list[Any]], x: list[Any]) -> list[Any]:
    det = J[0][0] * J[1][1] - J[0][1] * J[1][0]
    return [(J[1][1] * x[0] - J[0][1] * x[1]) / det, (J[0][0] * x[1] - J[1][0] * x[0]) / det]


def _tip(q: list[Any], length: list[Any]) -> tuple[list[Any], list[list[Any]]]:
    """Return the tip (x, y), x downwards, and its Jacobian."""
    one, both = q[0], q[0] + q[1]
    second = [-length[1] * both.sin(), length[1] * both.cos()]
    tip = [length[0] * one.cos() + second[1], length[0] * one.sin() - second[0]]
    return tip, [[-length[0] * one.sin() + second[0], second[0]], [length[0] * one.cos() + second[1], second[1]]]


def _on_circle(t: float, duration: float) -> tuple[list[Any], list[Any], list[Any]]:
    """Return p, ṗ, p̈ on the circle about (0.35, 0.65), R = 0.2, from ψ = π/2 once backwards, by the quintic law."""
    x = arb(t) / arb(duration) if t < duration else arb(1)
    s, ds = x**3 * (10 - 15 * x + 6 * x * x), 30 * (x * (1 - x)) ** 2 / arb(duration)
    dds, turn, R = 60 * x * (1 - x) * (1 - 2 * x) / arb(duration) ** 2, -2 * arb.pi(), arb(0.2)
    psi, rate, bend = arb.pi() / 2 + turn * s, turn * ds, turn * dds
    cos, sin = psi.cos(), psi.sin()
    along, out = [-R * sin, R * cos], [R * cos, R * sin]
    p = [arb(0.35) + out[0], arb(0.65) + out[1]]
    return p, [rate * a for a in along], [bend * a - rate * rate * o for a, o in zip(along, out, strict=True)]


def _reference(t: float, duration: float, length: list[Any]) -> tuple[list[Any], list[Any], list[Any]]:
    """Return q_d, q̇_d, q̈_d in balls that hold the policy's floats: q = p⁻¹, q̇ = J⁻¹ ṗ, q̈ = J⁻¹ (p̈ - J̇ q̇), elbow q2 > 0."""
    p, dp, ddp = _on_circle(t, duration)
    one, two = length
    q2 = ((p[0] * p[0] + p[1] * p[1] - one * one - two * two) / (2 * one * two)).acos()
    q = [arb.atan2(p[1], p[0]) - arb.atan2(two * q2.sin(), one + two * q2.cos()), q2]
    J = _tip(q, length)[1]
    v = _solved(J, dp)
    inner, outer = one * v[0] ** 2, two * (v[0] + v[1]) ** 2
    both = q[0] + q[1]
    a = _solved(J, [
        ddp[0] + inner * q[0].cos() + outer * both.cos(), ddp[1] + inner * q[0].sin() + outer * both.sin()
    ])  # fmt: skip
    size = 1.0 + sum(map(_upper, v)) + sum(_upper(x) ** 2 for x in v) + sum(map(_upper, a))
    return [_about(x, _ULPS) for x in q], [_about(x, _ULPS * size) for x in v], [_about(x, _ULPS * size) for x in a]


def _sign_at_rest(robot: dict[str, Any], joint: int) -> float:
    """Return the sign of the velocity that the law's backward differences give at rest.

    It is zero but for the rounding of 11 τ - 18 τ + 9 τ - 2 τ, whose sign takes the last bit of τ = g(q_d): this sum is
    repeated in doubles.
    """
    (one, two), g = robot["length"], robot["gravity"]
    (m1, m2), (r1, r2) = robot["mass"], robot["mass_center"]
    x, y = 0.35 + 0.2 * math.cos(math.pi / 2), 0.65 + 0.2 * math.sin(math.pi / 2)
    r, outer, inner = math.hypot(x, y), one + two, abs(one - two)
    q2 = 2.0 * math.atan2(math.sqrt((outer - r) * (outer + r)), math.sqrt((r - inner) * (r + inner)))
    x0, y0 = one + two * math.cos(q2), two * math.sin(q2)
    q1 = math.atan2(y * x0 - x * y0, x * x0 + y * y0)
    second = m2 * g * r2 * math.sin(q1 + q2)
    now = second if joint else (m1 * g * r1 + m2 * g * one) * math.sin(q1) + second
    rate = (11.0 * now - 18.0 * now + 9.0 * now - 2.0 * now) / (6.0 * _PERIOD)
    curvature = (2.0 * now - 5.0 * now + 4.0 * now - now) / (_PERIOD * _PERIOD)
    k, b = robot["stiffness"][joint], robot["damping"][joint] / robot["stiffness"][joint]
    middle = (rate - b * curvature) / k + 0.5 * _PERIOD * (curvature / k)
    return float(np.sign(middle))


class _Law:
    """u = Σ h(z) K (e, ė, x_I) + Σ (h(z) - h(z_d)) L r + u_ff, with e and r of θ_d; z = cos θ_2 and -c_5 sinc(θ_1 + θ_2)."""

    def __init__(self, document: dict[str, Any], duration: float) -> None:
        robot = self.robot = {name: _read(value) for name, value in document["robot"].items()}
        if document["kept"] != ["z1", "z3"] or document["form"] != "consistent" or not document["integral"]:
            raise _Refused("the controller file is of another form")
        self.nominal = _Plant(robot, _DEFAULTS)
        self.duration, plant = duration, self.nominal
        bounds = [[arb(x) for x in pair] for pair in _read(document["bounds"])]
        self._low, self._width = (bounds[0][0], bounds[2][0]), (bounds[0][1] - bounds[0][0], bounds[2][1] - bounds[2][0])
        z2, z4, z5 = ((bounds[i][0] + bounds[i][1]) / 2 for i in (1, 3, 4))
        c, fv = plant.c, plant.viscous
        gains, self._rules = _read(document["gains"]), {}
        for i in _BOTH:  # of z3, which the A of the rules depends on
            z3 = bounds[2][i]
            A = [[z2, z3, -fv[0] + 2 * z4, z4], [z3, z3, z5, -fv[1]]]
            for k in _BOTH:  # of z1, on which E depends
                m = c[2] + c[1] * bounds[0][k]
                E = [[plant.inertia[0] + c[0] + 2 * c[1] * bounds[0][k], m], [m, plant.inertia[1] + c[2]]]
                L = [[*(-x for x in A[j]), *E[j]] for j in _BOTH]
                self._rules[i, k] = [([arb(x) for x in gains[i][k][j]], L[j]) for j in _BOTH]
        self._past: list[list[Any]] = []  # τ_d of the last samples, the latest first
        self._before: list[Any] = []

    def _target(self, k: int) -> tuple[list[Any], list[Any]]:
        """Return r = (θ_d, θ̇_d, θ̈_d) (6,) and u_ff (2,) at the k-th sample, in balls."""
        q, v, a = _reference(_PERIOD * k, self.duration, self.nominal.length)
        n = self.nominal
        torque = [_about(x, _ULPS * (1.0 + _upper(x))) for x in link_torque(n.c, q, v, a)]
        self._past = [torque, *(self._past or [torque] * 3)][:4]
        T, target, smooth, slips = arb(_PERIOD), [], [], []
        for j in _BOTH:
            now, latest, second, third = (past[j] for past in self._past)
            stiff, b = n.stiffness[j], n.damping[j] / n.stiffness[j]
            rate = (11 * now - 18 * latest + 9 * second - 2 * third) / (6 * T)
            bend = (2 * now - 5 * latest + 4 * second - third) / (T * T)
            velocity, acceleration = v[j] + (rate - b * bend) / stiff, a[j] + bend / stiff
            target.append((q[j] + (now - b * (rate - b * bend)) / stiff, velocity, acceleration))
            smooth.append(n.inertia[j] * acceleration + n.viscous[j] * velocity + now)
            middle = velocity + T * acceleration / 2
            side = _sign_at_rest(self.robot, j) if not k else 1.0 if middle > 0 else -1.0 if middle < 0 else math.nan
            if math.isnan(side):
                raise _Refused("the sign of the friction that the law expects is not decided")
            slips.append(side * n.friction(j, middle))
        before, self._before = self._before or smooth, smooth
        u_ff = [s + (s - old) / 2 + slip for s, old, slip in zip(smooth, before, slips, strict=True)]
        return [target[j][i] for i in range(3) for j in _BOTH], [_about(u, _ULPS * (1.0 + _upper(u)) + 1e-13) for u in u_ff]

    def _shares(self, one: Any, two: Any) -> list[Any]:
        """Return ω of z1 and z3 at motor angles."""
        z = two.cos(), -self.nominal.c[4] * (one + two).sinc()
        found = [(x - low) / width for x, low, width in zip(z, self._low, self._width, strict=True)]
        if not all(0 < share < 1 for share in found):
            raise _Refused("a premise leaves its bounds")
        return found

    def _slopes(self, at: list[Any], x: list[Any], r: list[Any]) -> list[list[Any]]:
        """Return ∂u/∂(θ, θ̇, x_I) (2, 6) at motor angles `at` and errors x."""
        share = self._shares(*at)
        both = at[0] + at[1]
        turn = -at[1].sin() / self._width[0], -self.nominal.c[4] * (both.cos() - both.sinc()) / both / self._width[1]
        weight = {(i, k): _of(share[1], i) * _of(share[0], k) for i in _BOTH for k in _BOTH}
        slopes = []
        for j in _BOTH:
            row = [sum((weight[rule] * self._rules[rule][j][0][p] for rule in weight), arb(0)) for p in range(6)]
            asked = {rule: _dot(self._rules[rule][j][0], x) + _dot(self._rules[rule][j][1], r) for rule in weight}
            by_1 = sum((_of(share[1], i) * (asked[i, 1] - asked[i, 0]) for i in _BOTH), arb(0)) * turn[0]
            by_3 = sum((_of(share[0], k) * (asked[1, k] - asked[0, k]) for k in _BOTH), arb(0)) * turn[1]
            slopes.append([row[0] + by_3, row[1] + by_1 + by_3, *row[2:]])
        return slopes

    def respond(self, k: int, point: list[float], box: np.ndarray) -> tuple[list[Any], np.ndarray, np.ndarray, list[Any]]:
        """Return u at a point (θ, θ̇, x_I), the Jacobian (2, 6), a bound (2,) of the rest on a box, and θ_d."""
        r, u_ff = self._target(k)
        exact = [arb(x) for x in point]
        wide = [_about(x, radius) for x, radius in zip(exact, box.tolist(), strict=True)]
        at, errors = [], [[*(a - b for a, b in zip(part[:4], r[:4], strict=True)), *part[4:]] for part in (exact, wide)]
        share, aim = self._shares(*exact[:2]), self._shares(*r[:2])
        for j in _BOTH:
            total = u_ff[j]
            for (i, m), rule in self._rules.items():
                weight = _of(share[1], i) * _of(share[0], m)
                change = weight - _of(aim[1], i) * _of(aim[0], m)
                total += weight * _dot(rule[j][0], errors[0]) + change * _dot(rule[j][1], r)
            at.append(total)
        centre = np.array([[float(x.mid()) for x in row] for row in self._slopes(exact[:2], errors[0], r)])
        slopes, rest = self._slopes(wide[:2], errors[1], r), np.zeros(2)
        for j in _BOTH:
            rest[j] = sum(_upper(x - c) * radius for x, c, radius in zip(slopes[j], centre[j].tolist(), box.tolist(), strict=True))
            sizes = [_dot([abs(x) for x in K], [abs(x) for x in errors[1]]) + _dot([abs(x) for x in L], [abs(x) for x in r])
                     for K, L in (rule[j] for rule in self._rules.values())]  # fmt: skip
            rest[j] += _ULPS * max(map(_upper, sizes))  # rounding in the law, in whatever order it adds
        return at, centre, rest * _UP, r[:2]


def _of(share: Any, side: int) -> Any:
    return share if side else 1 - share


def _dot(a: list[Any], b: list[Any]) -> Any:
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))


# Courses along the centre ----------------------------------------------------------------------------------------


def _tables() -> tuple[Any, Any]:
    """Return the powers (N, 8) of the Chebyshev nodes, and the matrix (N, N) from values at them to coefficients."""
    angles = [arb.pi() * (2 * i + 1) / (2 * _NODES) for i in range(_NODES)]
    turned = [[(j * angle).cos() * 2 / _NODES / (1 if j else 2) for angle in angles] for j in range(_NODES)]
    return arb_mat([[angle.cos() ** p for p in range(8)] for angle in angles]), arb_mat(turned)


class _Course:
    """f(s) = Σ c_j T_j(s) ± `left` on a segment."""

    def __init__(self, c: list[Any], left: float = 0.0) -> None:
        self.c, self.left = c, left
        self.sizes = [_upper(x) for x in c]

    def line(self) -> tuple[float, float, float]:
        """Return level and slope of the line c_0 + c_1 s in floats, and a bound of what is beside it."""
        level, slope = float(self.c[0].mid()), float(self.c[1].mid())
        beside = _upper(self.c[0] - level) + _upper(self.c[1] - slope) + sum(self.sizes[2:]) + self.left
        return level, slope, beside * _UP

    def size(self) -> float:
        """Return a bound of |f|."""
        return (sum(self.sizes) + self.left) * _UP

    def range(self) -> tuple[float, float]:
        """Return the ends of f: its values at both ends if |c_1| > Σ j² |c_j|, because |T_j'| <= j²."""
        ends = [_ends(x) for x in (sum(self.c, arb(0)), sum(self.c[::2], arb(0)) - sum(self.c[1::2], arb(0)))]
        beside = self.left
        if not float(self.c[1].abs_lower()) > 1.001 * sum(j * j * x for j, x in enumerate(self.sizes[2:], 2)):
            ends, beside = [_ends(self.c[0])], (sum(self.sizes[1:]) + self.left) * _UP
        return min(low for low, _ in ends) - beside, max(high for _, high in ends) + beside

    def ball(self, radius: float = 0.0) -> Any:
        """Return a ball around the range, larger by a radius."""
        low, high = self.range()
        return _hull(low - radius, high + radius)


class _Motion:
    """The centre on a segment: θ, q and their derivatives by time, at the nodes and as courses."""

    def __init__(self, angles: list[list[float]], duration: float, tables: tuple[Any, Any]) -> None:
        if len(angles) != 4 or any(len(row) != 8 for row in angles):
            raise _Refused("the centre has four polynomials of degree 7")
        powers, self._turned = tables
        rate = 2 / arb(duration)
        rows = [[arb(x) for x in row] for row in angles]
        self.polynomials = [rows]
        for _ in _BOTH:
            rows = [[rate * i * x for i, x in enumerate(row)][1:] + [arb(0)] for row in rows]
            self.polynomials.append(rows)
        self.nodes = [(powers * arb_mat(part).transpose()).table() for part in self.polynomials]  # (N, 4) each
        self._discs = [[[_horner(row, (r + 1 / r) / 2) for row in part] for part in self.polynomials] for r in _RADII]

    def at(self, side: int) -> list[Any]:
        """Return θ, q, θ̇, q̇ (8,) at s = -1 or 1."""
        return [sum((x * side**i for i, x in enumerate(row)), arb(0)) for part in self.polynomials[:2] for row in part]

    def courses(self, functions: list[Callable[..., list[Any]]]) -> list[list[_Course]]:
        """Return f(x, v, a) as courses for functions of θ and q (4,), their velocities and accelerations.

        The first function is linear: its courses are polynomials of less than N coefficients, and exact.
        """
        values = [[f(*at) for f in functions] for at in zip(*self.nodes, strict=True)]
        flat = arb_mat([[x for part in row for x in part] for row in values])
        columns = (self._turned * flat).transpose().table()
        places = iter(columns)
        beyond = [[f(*disc) for disc in self._discs] for f in functions[1:]]
        found = []
        shares = [4.0 * r ** (1 - _NODES) / (r - 1.0) * _UP for r in _RADII]
        for number, value in enumerate(values[0]):
            left = [0.0] * len(value)
            if number:
                sizes = [[_size(x) * share for x in disc] for disc, share in zip(beyond[number - 1], shares, strict=True)]
                left = np.min(sizes, axis=0).tolist()
            found.append([_Course(next(places), one) for one in left])
        return found


def _horner(row: list[Any], radius: float) -> Any:
    """Return the values of a polynomial on the square around |s| <= radius."""
    s, value = acb(arb(0, radius), arb(0, radius)), acb(0)
    for x in reversed(row):
        value = value * s + x
    return value


def _size(x: Any) -> float:
    found = float(x.abs_upper())
    return found if math.isfinite(found) else math.inf


# Tube ------------------------------------------------------------------------------------------------------------


def _floats(matrix: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return middles and radii of a matrix of balls."""
    rows, columns = matrix.nrows(), matrix.ncols()
    entries = matrix.entries()
    middle = np.array([float(x.mid()) for x in entries]).reshape(rows, columns)
    radius = np.array([float(x.rad()) for x in entries]).reshape(rows, columns)
    if not np.isfinite(middle).all():
        raise _Refused("a matrix is not finite")
    return middle, radius * _UP + 2.0**-52 * np.abs(middle)


def _above(matrix: Any) -> np.ndarray:
    middle, radius = _floats(matrix)
    return (np.abs(middle) + radius) * _UP


def _reach(rows: tuple[np.ndarray, np.ndarray], G: np.ndarray, own: np.ndarray | None = None) -> np.ndarray:
    """Return bounds of |X G g|, with `own` added to the columns of the constants."""
    middle, radius = rows
    image = middle @ G
    total = np.abs(G).sum(axis=1) * _UP
    spare = (radius + _SMALL / 4 * np.abs(middle)) @ total
    if own is not None:
        image[:, : own.shape[1]] += own
        spare = spare + _SMALL * np.abs(own).sum(axis=1)
    return np.asarray((np.abs(image).sum(axis=1) + spare) * _UP)


def _growth(size: np.ndarray, h: float) -> np.ndarray:
    """Return a bound of exp(|A| t), t <= h: with X = |A| h, its series to X^N/N!, and R <= X^N/N! (S + R)."""
    total, term = np.eye(len(size)), np.eye(len(size))
    for i in range(1, 60):
        term = term @ size * (h / i)
        total += term
    if not term.sum(axis=1).max() < 1e-9:
        raise _Refused("the linear equation is too fast for its segment")
    return (total + 2.0 * (term @ total).max()) * _UP


class _Friction:
    """The friction of one motor on a segment: what its plan makes of it."""

    def __init__(self, plant: _Plant, joint: int, plan: str, mode: int, motion: Any, known: tuple[float, float]) -> None:
        self.joint, self.plan, self.known, self._plant = joint, plan, known, plant
        self.side = mode if mode in (-1, 1) else 0
        self.net, self.needed, self.v, self.a, self.slips = motion  # N, P, v, θ̈ and F(v) of the centre
        self._rests = all(x.is_zero() for x in self.v.c)
        self.static, self.share = _ends(plant.friction(joint, arb(0))), plant.share[joint]
        self.uncertain = max(1.0 - self.share[0], self.share[1] - 1.0)
        self.inertia = _ends(plant.inertia[joint])[0]
        if plan not in ("any", "held", "slip", "monotone", "mixed") or (plan == "any") != plant.any or mode not in (-1, 0, 1, 2):
            raise _Refused(f"motor {joint + 1}: plan {plan!r} and mode {mode!r} do not fit the set")
        if (plan == "held" and not (self._rests and known == (0.0, 0.0))) or (plan == "slip" and not self.side):
            raise _Refused(f"motor {joint + 1} does not {'rest' if plan == 'held' else 'slip'}")
        self.missed = self._missed() if self.side else math.inf
        self.slope = 0.0
        if plan == "slip":
            self.slope = -float(plant.slope(joint, arb(abs(0.5 * sum(self.v.range())))).mid())

    def _missed(self) -> float:
        """Return a bound of |P - σ F(v)| along the centre."""
        parts = [_upper(p - self.side * f) for p, f in zip(self.needed.c, self.slips.c, strict=True)]
        return (sum(parts) + self.needed.left + self.slips.left) * _UP

    def parted(self, start: float, h: float, driving: float) -> float:
        """Return a bound of |δv| by Lemma 2, for |δN| and the constants within `driving` [N m]."""
        if self.side:
            eta = self.missed + self.uncertain * self.static[1]
        elif self._rests:
            eta = max(0.0, self.needed.size() - self.share[0] * self.static[0])
        else:
            eta = self.needed.size() + self.share[1] * self.static[1]
        low, high = self.v.range()
        aside = max(0.0, -low if self.side > 0 else high) if self.side else 0.0
        steep = self._plant.steepest(self.joint) * self.share[1]
        rate = steep / self.inertia * h
        return ((start + aside + h * (driving + eta + steep * aside) / self.inertia) * math.exp(rate) + aside) * _UP

    def bound(self, tube_v: float, spread: float, h: float) -> float:
        """Return a bound of |Γ_f + P| beside the linear slope; |N - N_y| <= `spread` [N m], constants included."""
        j, plant, (weak, strong) = self.joint, self._plant, self.share
        low, high = self.v.range()
        low, high = low - tube_v, high + tube_v
        if self.plan == "any":
            return (self.needed.size() + strong * self.static[1]) * _UP
        if self.plan in ("monotone", "held"):
            limit = weak * self.static[0] * (1.0 - 1e-9)
            if self.plan == "held" and not self.net.size() + spread < limit:
                raise _Refused(f"motor {j + 1} may begin to move")
            return 0.0
        if self.plan == "slip":
            if not (low if self.side > 0 else -high) > 0.0:
                raise _Refused(f"motor {j + 1} may stop")
            falling, rising = plant.slopes(j, *sorted((abs(low), abs(high))))
            bent = max(abs(falling + self.slope), abs(rising + self.slope)) + self.uncertain * max(-falling, rising)
            return (self.missed + bent * tube_v) * _UP
        least, most = self._during(low, high, spread, h)
        need, ends = self.needed.range(), [0.0]
        for side, slowest, fastest in ((1, max(0.0, least), most), (-1, max(0.0, -most), -least)):
            if fastest <= 0.0:
                continue
            under, over = plant.strength(j, slowest, fastest)
            if side == self.side:
                ends.append(self.missed + plant.steepest(j) * tube_v + self.uncertain * over)
            else:
                pulls = -side * weak * under, -side * strong * over
                ends += [abs(need[0] + min(pulls)), abs(need[1] + max(pulls))]
        if least <= 0.0 <= most:  # at rest, where Γ_f = -N and the motor does not accelerate
            static, net = strong * self.static[1], self.net.range()
            rest = spread + self.inertia * (1.0 + 1e-9) * self.a.size()
            bottom, top = max(net[0] - spread, -static), min(net[1] + spread, static)
            if bottom <= top:
                ends += [min(rest, abs(need[0] - top)) if need[0] < top else 0.0]
                ends += [min(rest, abs(need[1] - bottom)) if need[1] > bottom else 0.0]
        return max(ends) * _UP

    def _rates(self, low: float, high: float, spread: float) -> tuple[float, float]:
        """Return the least v̇ where v < 0, and the largest where v > 0."""
        net, weak = self.net.range(), self.share[0]
        back = weak * self._plant.strength(self.joint, 0.0, max(-low, 0.0))[0]
        forth = weak * self._plant.strength(self.joint, 0.0, max(high, 0.0))[0]
        spare = 1e-10 * (abs(net[0]) + abs(net[1]) + spread + back + forth)
        return (net[0] - spread + back - spare) / self.inertia, (net[1] + spread - forth + spare) / self.inertia

    def _during(self, low: float, high: float, spread: float, h: float) -> tuple[float, float]:
        falling, rising = self._rates(low, high, spread)
        least, most = min(self.known[0], 0.0) + min(falling, 0.0) * h * _UP, max(self.known[1], 0.0) + max(rising, 0.0) * h * _UP
        return max(low, least), min(high, most)

    def after(self, tube_v: float, spread: float, h: float, end: float) -> tuple[float, float]:
        """Return bounds of v at the end of the segment, where the centre has the velocity `end`."""
        if self.plan in ("any", "held"):
            return (-math.inf, math.inf) if self.plan == "any" else (0.0, 0.0)
        low, high = self.v.range()
        falling, rising = self._rates(low - tube_v, high + tube_v, spread)
        least = min(0.0, min(self.known[0], 0.0) + h * falling * (1.0 - 1e-10 * np.sign(falling)))
        most = max(0.0, max(self.known[1], 0.0) + h * rising * (1.0 + 1e-10 * np.sign(rising)))
        spare = tube_v * _UP + 1e-15 * (1.0 + abs(end))
        return max(end - spare, least), min(end + spare, most)


class _Tube:
    """The tube, control step by control step: iterating gives a bound of the tip error at the end of each."""

    def __init__(self, claim: _Claim) -> None:
        name = claim.policy.removesuffix("-tip") + ".json"
        content = (_CONTROLLERS / name).read_bytes()
        if claim.files != {name: hashlib.sha256(content).hexdigest()}:
            raise _Refused(f"{name} is not the controller file of the bound")
        document = json.loads(content)
        self._claim, self._law = claim, _Law(document, claim.duration)
        robot = self._law.robot
        if any(robot.get(name) != value for name, value in _TABLE_1.items()):
            raise _Refused(f"{name} is not for the arm of Table 1")
        self._limit, self._plant, self._tables = robot["torque_limit"], _Plant(robot, claim.plants), _tables()
        total = math.ceil(claim.duration / _PERIOD - 1e-9)
        if not 1 <= len(claim.steps) == len(claim.tip) <= total:
            raise _Refused(f"{len(claim.steps)} control steps and {len(claim.tip)} samples of at most {total}")

    def __iter__(self) -> Iterator[float]:
        """Yield a bound of the tip error at each sample [m]."""
        law, plant = self._law, self._plant
        q, v, _ = _reference(0.0, self._claim.duration, law.nominal.length)
        hung = link_torque(law.nominal.c, q, [arb(0)] * 2, [arb(0)] * 2)
        start = [*(a + t / k for a, t, k in zip(q, hung, law.nominal.stiffness, strict=True)), *q, *[arb(0)] * 4]
        self._centre = [float(x.mid()) for x in start]
        # rows: ξ with δu, then x_I; columns: the constants, then what has disturbed the motion so far
        self._G = np.zeros((12, len(plant.column)))
        self._widen(np.array([_upper(x - c) for x, c in zip(start, self._centre, strict=True)]))
        self._memory, self._known = [0.0, 0.0], [(0.0, 0.0)] * 2
        for k, parts in enumerate(self._claim.steps):
            torque = self._sample(k)
            begun = 0.0
            for part in parts:
                duration = float(part["duration"])
                if not 0.0 < duration <= _PERIOD:
                    raise _Refused(f"a segment lasts {duration} s")
                self._cross(part, duration, torque)
                begun += duration
            if begun != _PERIOD:
                raise _Refused(f"its segments last {begun} s")
            self._G[8:10] = 0.0
            yield self._tip(_PERIOD * (k + 1))

    def _widen(self, box: np.ndarray, *columns: np.ndarray) -> None:
        """Add a box around the first rows, and columns."""
        wide = np.zeros((12, len(box)))
        wide[: len(box)] = np.diag(box)
        self._G = np.hstack([self._G, wide[:, box > 0.0], *columns])

    def _sample(self, k: int) -> np.ndarray:
        """Add the law's torque and its memory at t_k to the zonotope; return the torque at the centre."""
        seen = [0, 1, 4, 5, 10, 11]
        deviations = self._G[seen]
        box = np.abs(deviations).sum(axis=1) * _UP
        point = [self._centre[i] for i in seen[:4]] + self._memory
        answer, slopes, rest, aim = self._law.respond(k, point, box)
        torque = np.array([float(u.mid()) for u in answer])
        rounding = _SMALL * (np.abs(slopes) @ box)
        rest = rest + rounding + [_upper(u - c) for u, c in zip(answer, torque.tolist(), strict=True)]
        self._G[8:10] = slopes @ deviations
        next_memory = [x + arb(_PERIOD) * (arb(p) - a) for x, p, a in zip(self._memory, point, aim, strict=False)]
        self._G[10:12] += _PERIOD * deviations[:2]
        self._memory = [float(x.mid()) for x in next_memory]
        left = [_upper(x - c) + _SMALL * (abs(c) + b) for x, c, b in zip(next_memory, self._memory, box[4:] + box[:2], strict=True)]
        self._widen(np.concatenate([np.zeros(8), rest, left]))
        reach = np.abs(torque) + np.abs(self._G[8:10]).sum(axis=1) * _UP
        if not (reach < self._limit).all():
            raise _Refused("a motor may reach its torque limit")
        return torque

    def _linear(self, slopes: list[Any], frictions: list[_Friction]) -> tuple[Any, Any, Any, Any]:
        """Return A (10, 10), b (10, 6), S (18 + 2 masses, 10) and D of ξ̇ = A ξ + b w, observed S ξ + D w."""
        p, zero = self._plant, arb(0)
        angle, speed, mass = slopes[0]
        inverse = np.linalg.inv(np.array(mass))
        A = [[zero] * 10 for _ in range(10)]
        S, D = [[arb(i == j) for j in range(10)] for i in range(8)], [[zero] * 6 for _ in range(18)]
        b = [[zero] * 6 for _ in range(10)]
        pulls, nets = [], []
        for j in _BOTH:
            free = zero if frictions[j].plan == "held" else 1 / p.inertia[j]
            joint = [zero] * 10
            for place, x in ((j, p.stiffness[j]), (4 + j, p.damping[j])):
                joint[place], joint[2 + place] = x, -x
            net = [-x for x in joint]
            net[4 + j], net[8 + j] = net[4 + j] - p.viscous[j], arb(1)
            nets.append(net)
            A[j][4 + j], A[2 + j][6 + j] = arb(frictions[j].plan != "held"), arb(1)
            A[4 + j] = [free * x for x in net]
            A[4 + j][4 + j] += free * arb(frictions[j].slope)
            b[4 + j][j], b[4 + j][2 + j] = free, -free
            for i in _BOTH:
                joint[2 + i], joint[6 + i] = joint[2 + i] - arb(angle[j][i]), joint[6 + i] - arb(speed[j][i])
            pulls.append(joint)
        for i in _BOTH:
            row = [arb(x) for x in inverse[i].tolist()]
            A[6 + i] = [row[0] * x + row[1] * y for x, y in zip(*pulls, strict=True)]
            b[6 + i][2:6] = row + row
        S += [[arb(x) for x in np.eye(10)[at + j] - np.eye(10)[at + 2 + j]] for at in (0, 4) for j in _BOTH]
        S += nets + [row[:] for row in A[4:8]]
        D[14:18] = [row[:] for row in b[4:8]]
        for j in _BOTH:
            if frictions[j].plan == "monotone":  # its velocity is an input, bounded beside the linear equation
                v = 4 + j
                A[v], b[v], S[14 + j], D[14 + j] = [zero] * 10, [zero] * 6, [zero] * 10, [zero] * 6
                for rows, inputs in ((A, b), (S, D)):
                    for row, channel in zip(rows, inputs, strict=True):
                        channel[j], row[v] = row[v], zero
        for one in slopes[1:]:
            for i in _BOTH:
                terms = [(x, at + l) for x_of, at in zip(one, (2, 6, 16), strict=True) for l, x in enumerate(x_of[i])]
                S.append([sum((arb(x) * S[at][n] for x, at in terms), zero) for n in range(10)])
                D.append([sum((arb(x) * D[at][n] for x, at in terms), zero) for n in range(6)])
        return arb_mat(A), arb_mat(b), arb_mat(S), arb_mat(D)

    def _drives(self, courses: Any, frictions: list[_Friction]) -> tuple[np.ndarray, ...]:
        """Return level and slope (6, m) of the constants' torques by channel, the rest (6,), and sizes on motors (2,)."""
        p = self._plant
        level, slope = np.zeros((6, len(p.column))), np.zeros((6, len(p.column)))
        rest, sizes = np.zeros(6), np.zeros(2)
        bending, rates, spins, speeds = courses[0][:2], courses[0][2:4], courses[0][8:10], courses[0][6:8]
        made: list[tuple[int, int, float, _Course]] = []
        for (kind, j), column in p.column.items():
            half = p.half.get(kind, [0.0, 0.0])[j]
            if kind == "mass":
                place = list(p.masses).index(j)
                made += [(column, 4 + i, -1.0, course) for i, course in enumerate(courses[2 + place])]
            elif kind == "dry_friction":
                if frictions[j].plan == "slip":
                    made.append((column, j, -frictions[j].side * frictions[j].uncertain, frictions[j].slips))
            else:
                course = {"stiffness": bending, "damping": rates, "motor_inertia": spins, "viscous_friction": speeds}[kind][j]
                within = kind in ("stiffness", "damping")
                made.append((column, 2 + j if within else j, half if within else -half, course))
                sizes[j] += half * course.size()
        for column, channel, factor, course in made:
            if channel in _BOTH and frictions[channel].plan == "monotone":
                continue
            at, by, beside = course.line()
            level[channel, column] += factor * at
            slope[channel, column] += factor * by
            rest[channel] += (abs(factor) * beside + _SMALL * abs(factor) * (abs(at) + abs(by))) * _UP
        return level, slope, rest, sizes * _UP

    @staticmethod
    def _omitted(c: list[Any], at: Any, ranges: list[list[Any]], tube: np.ndarray) -> np.ndarray:
        """Return what the slopes `at` of the links' torque leave out on the tube (2,)."""
        left = np.zeros(2)
        for part, around, rows in zip(link_slopes(c, *ranges), at, (_Q, _DQ, _LINK), strict=True):
            for j in _BOTH:
                left[j] += sum(_upper(x - m) * r for x, m, r in zip(part[j], around[j], tube[rows].tolist(), strict=True))
        return left * _UP

    def _cross(self, part: dict[str, Any], h: float, torque: np.ndarray) -> None:
        """Take the zonotope over a segment."""
        p, radii = self._plant, np.array(part["tube"], dtype=float)
        if radii.shape != (18,) or not (np.isfinite(radii).all() and (radii >= 0.0).all()):
            raise _Refused("a tube has 18 radii")
        motion, u = _Motion(part["angles"], h, self._tables), [arb(x) for x in torque.tolist()]
        self._move(motion.at(-1), self._centre)

        def joints(x: Any, v: Any, a: Any) -> list[Any]:
            bend, rate = ([y[j] - y[2 + j] for j in _BOTH] for y in (x, v))
            net = [u[j] - p.stiffness[j] * bend[j] - p.damping[j] * rate[j] - p.viscous[j] * v[j] for j in _BOTH]
            needed = [n - p.inertia[j] * a[j] for j, n in enumerate(net)]
            return [*bend, *rate, *net, *v[:2], *a[:2], *needed]

        def links(x: Any, v: Any, a: Any) -> list[Any]:
            asked = link_torque(p.c, x[2:], v[2:], a[2:])
            pull = [p.stiffness[j] * (x[j] - x[2 + j]) + p.damping[j] * (v[j] - v[2 + j]) for j in _BOTH]
            return [*(t - r for t, r in zip(pull, asked, strict=True)), *x[2:], *v[2:], *a[2:]]

        def weights(c: list[Any]) -> Callable[..., list[Any]]:
            return lambda x, v, a: link_torque(c, x[2:], v[2:], a[2:])

        def slips(x: Any, v: Any, a: Any) -> list[Any]:
            return [p.friction(j, v[j]) for j in _BOTH]

        courses = motion.courses([joints, links, *map(weights, p.masses.values()), slips])
        plans, modes = part["plans"], part["modes"]
        if len(plans) != 2 or len(modes) != 2:
            raise _Refused("a segment has two plans and two modes")
        frictions = [
            _Friction(p, j, plans[j], modes[j], [courses[0][at + j] for at in (4, 10, 6, 8)] + [courses[-1][j]], self._known[j])
            for j in _BOTH
        ]
        middle = [[row[0] for row in of[2:]] for of in motion.polynomials]
        all_slopes = [
            [[[float(x.mid()) for x in row] for row in of] for of in link_slopes(c, *middle)] for c in (p.c, *p.masses.values())
        ]
        A, b, S, D = self._linear(all_slopes, frictions)
        level, slope, rest, sizes = self._drives(courses, frictions)
        free, push, after = self._free(A, b, S, D, level, slope, h)
        for floor in _FLOORS:
            tube = _ROOM * radii + floor * _FLOOR
            try:
                w, reached, spread = self._torques(tube, courses[1], frictions, all_slopes, rest, sizes, free, push, h)
            except _Refused:
                if floor == _FLOORS[-1]:
                    raise
                continue
            if (reached < tube).all():
                break
        else:
            row = int(np.argmax(reached / tube))
            raise _Refused(f"the tube is left in row {row + 1}, with {reached[row]:.4g}, and the file has {radii[row]:.4g}")
        after(w)
        for j, friction in enumerate(frictions):
            if friction.plan == "monotone":
                self._G[4 + j] = 0.0
                self._widen(np.zeros(0), w[j] * np.eye(12)[:, 4 + j : 5 + j])
        ends = motion.at(1)
        self._known = [f.after(tube[_V][j], spread[j], h, float(ends[4 + j].mid())) for j, f in enumerate(frictions)]
        self._centre = [float(x) for x in part["end"]]
        self._move(ends, self._centre)

    def _torques(
        self, tube: np.ndarray, links: list[_Course], frictions: list[_Friction], slopes: list[Any], rest: np.ndarray,
        sizes: np.ndarray, free: np.ndarray, push: np.ndarray, h: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Return w̄ (6,) on a tube, what the rows of S then reach (18,), and a bound of |N - N_y| with the constants (2,)."""
        p, w = self._plant, rest.copy()
        half = {name: np.array(value) for name, value in p.half.items()}
        within = half["stiffness"] * tube[_BEND] + half["damping"] * tube[_RATE]
        own = half["motor_inertia"] * tube[_MOTOR] + half["viscous_friction"] * tube[_V]
        spread = (tube[_NET] + sizes + within + own) * _UP
        begin = np.abs(self._G[4:6]).sum(axis=1) * _UP
        w[_JOINTS] += within
        for j, friction in enumerate(frictions):
            if friction.plan == "monotone":
                w[j] = friction.parted(begin[j], h, spread[j])
            else:
                w[j] += friction.bound(tube[_V][j], spread[j], h) + own[j]
        ranges = [[links[at + i].ball(tube[rows][i]) for i in _BOTH] for at, rows in ((2, _Q), (4, _DQ), (6, _LINK))]
        w[_LINKS] += [links[i].size() for i in _BOTH]
        for c, at in zip((p.c, *p.masses.values()), slopes, strict=True):
            w[_LINKS] += self._omitted(c, at, ranges, tube)
        w *= _UP
        if p.masses:  # r_p ξ, bounded by the tube or as it is observed
            parts = [np.abs(np.array(x)) @ tube[rows] for at in slopes[1:] for x, rows in zip(at, (_Q, _DQ, _LINK), strict=True)]
            products, others = np.sum(parts, axis=0) * _UP, w[_LINKS].copy()
            for _ in range(4):
                w[_LINKS] = (others + products) * _UP
                products = np.minimum(products, (free + push @ w)[18:].reshape(-1, 2).sum(axis=0) * _UP)
            w[_LINKS] = (others + products) * _UP
        reached = ((free + push @ w) * _UP)[:18]
        for j, friction in enumerate(frictions):
            if friction.plan == "monotone":
                pull = spread[j] + friction.needed.size() + friction.share[1] * friction.static[1]
                reached[14 + j] = pull / friction.inertia * _UP
        return w, reached, spread

    def _move(self, of: list[Any], to: list[float]) -> None:
        """Measure deviations from another centre, which differs by rounding."""
        self._widen(np.array([_upper(x - c) for x, c in zip(of, to, strict=True)]))

    def _free(
        self, A: Any, b: Any, S: Any, D: Any, level: np.ndarray, slope: np.ndarray, h: float
    ) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], None]]:
        """Return bounds of S ξ without w, those of what w = 1 adds, and the function that takes the zonotope on, for w̄.

        Between both ends S ξ_h is within h²/8 sup |S ξ̈_h| of a line, with ξ̈_h = e^{A t} (A² ξ + A b a + b ȧ).
        """
        m, G = level.shape[1], self._G[:10]
        SA = S * A
        SAA = SA * A
        size_A, size_b = _above(A), _above(b)
        E = _growth(size_A, h)
        quarter = (A * (arb(h) / 4)).exp()
        half = quarter * quarter
        phi = _floats(half * half)
        totals = np.abs(G).sum(axis=1) * _UP
        moved = phi[0] @ G
        box = (phi[1] + _SMALL / 4 * np.abs(phi[0])) @ totals
        (feed, feed_left), (Sb, Sb_left), (SAb, SAb_left) = map(_floats, (D, S * b, SA * b))
        if m:
            held, held_left = self._driven(A, b, level, slope, h, size_A, E)
            moved[:, :m] += held
            box += held_left.sum(axis=1)
        rows, spare = _floats(S), np.abs(level).sum(axis=1) + np.abs(slope).sum(axis=1)
        first = _reach(rows, G, feed @ (level - slope)) + (feed_left + _SMALL * np.abs(feed)) @ spare
        last = _reach(rows, moved, feed @ (level + slope)) + (feed_left + _SMALL * np.abs(feed)) @ spare
        last += (np.abs(rows[0]) + rows[1]) @ box
        kick = SAb @ (level - slope) + Sb @ slope * (2.0 / h)
        bend = _reach(_floats(SAA), G, kick)
        bend += (SAb_left + _SMALL * np.abs(SAb) + 2.0 / h * (Sb_left + _SMALL * np.abs(Sb))) @ spare
        turned = np.concatenate([bend[:8], np.zeros(2)])
        free = (np.maximum(first, last) + h * h / 8.0 * (bend + h * _above(SA) @ (E @ turned))) * _UP
        late = h**3 / 6.0 * _above(SAA) @ (E @ size_b)
        push = (np.abs(feed) + feed_left + h * (np.abs(Sb) + Sb_left) + h * h / 2.0 * (np.abs(SAb) + SAb_left) + late) * _UP

        def after(w: np.ndarray) -> None:
            acting = np.flatnonzero(w > 0.0)
            columns, missed = [], box.copy()
            for middle in (half * quarter, quarter):  # from the middles of both halves to the end
                for matrix, share in ((middle * b, h / 2.0), (middle * A * b, h * h / 16.0)):
                    made, left = _floats(matrix)
                    columns.append((share * made * w)[:, acting])
                    missed += share * (left + _SMALL * np.abs(made)) @ w
            missed += h**3 / 96.0 * size_A @ (size_A @ (E @ (size_b @ w)))
            new = np.zeros((12, 4 * len(acting)))
            new[:10] = np.hstack(columns)
            self._G[:10] = moved
            self._widen(missed[:8] * _UP, new[:, np.abs(new).sum(axis=0) > 0.0])

        return free, push, after

    @staticmethod
    def _driven(
        A: Any, b: Any, level: np.ndarray, slope: np.ndarray, h: float, size_A: np.ndarray, E: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return ∫ e^{A (h - t)} b (level + slope s(t)) dt (10, m) and its error, by the series in A."""
        m, terms = level.shape[1], 26
        both = b * arb_mat(np.hstack([level, slope]).tolist())
        power, total, later = both, both * 0, both * 0
        for i in range(terms):
            total += power * (arb(h) / (i + 1))
            later += power * (arb(h) * arb(h) / (i + 2))
            power = A * power * (arb(h) / (i + 1))
        found = [[total[i, n] + total[i, m + n] - later[i, m + n] * 2 / arb(h) for n in range(m)] for i in range(10)]
        middle, left = _floats(arb_mat(found))
        rest = _above(power)
        return middle, left + 3.0 * h * E @ (rest[:, :m] + rest[:, m:])

    def _tip(self, t: float) -> float:
        """Return a bound of |p(q) - p_r|: in `_TURNS` directions, with the quadratic remainder."""
        q = [arb(x) for x in self._centre[2:4]]
        tip, J = _tip(q, self._plant.length)
        target = _on_circle(t, self._claim.duration)[0]
        off = [a - b for a, b in zip(tip, target, strict=True)]
        offset, middle = math.hypot(*map(_upper, off)) * _UP, np.array([float(x.mid()) for x in off])
        jacobian, left = _floats(arb_mat(J))
        turns = np.pi * np.arange(_TURNS) / _TURNS
        units = np.stack([np.cos(turns), np.sin(turns)], axis=1)
        links = self._G[2:4]
        radius = np.abs(links).sum(axis=1) * _UP
        reach = np.abs(units @ jacobian @ links).sum(axis=1) * _UP + 4.0 * _SMALL * (np.abs(jacobian) @ radius).sum()
        corner = (1.0 + 1e-10) / math.cos(0.5 * math.pi / _TURNS)
        wide = min(offset + reach.max() * corner, ((np.abs(units @ middle) + reach).max() + _SMALL * (1.0 + offset)) * corner)
        one, two = map(_upper, self._plant.length)
        bent = 0.5 * (one * radius[0] ** 2 + two * (radius[0] + radius[1]) ** 2) + (left @ radius).sum() + _SMALL
        return float((wide + bent) * _UP)
