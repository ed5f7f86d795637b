"""A second checker of proven tip bounds, which imports nothing of this package.

It reads a bound's file and its law's controller file, and derives the bound again from separate equations, with the
centre y(t), the radii ρ and the motors' friction plans of the file's tube. On a segment of length h, for a plant z(t),
δ = z - y, ξ = (δθ, δq, δθ̇, δq̇, δu) and constants p = p_0 + Δp π, |π| <= 1, all of the following must hold:
1. *Mean values.* ξ̇ = A ξ + b (a(t) π + w(t)), where A is the linearisation at the middle of the segment, a(t) are the
   torques of the constants along the centre, and |w| <= w̄ bounds the terms missing in A wherever |S ξ| <= ρ: defects of
   the centre, derivatives of the links' torques on the tube minus those in A, times ρ, products Δp ρ, and friction.
2. *Friction* Γ_f ∈ -μ F(|v|) Sgn(v), by plan. HELD: v = 0, and the torque N without Γ_f is below μ F(0); SLIP: v keeps
   its sign on the tube; MONOTONE uses Lemma 2 of the documentation, MIXED all cases of Lemma 1; ANY is |Γ_f| <= μ F(0).
3. *First exit* (Lemma 3): with (1) and (2), |S ξ| <= ρ' < ρ on the segment.
4. *Sample.* The law is linearised on the box of measured states; its remainder includes rounding and a guest's torque.
5. *Every lap.* The end of a lap lies in the set in which the lap began.

Plant, law, reference and exponentials are balls (Arb). Functions of time f(s), |s| <= 1, become Chebyshev interpolants
with n nodes; errors are at most 4 M r^(1-n)/(r - 1) if |f| <= M in the ellipse with r as sum of semi-axes. Deviations
lie in a zonotope G g, |g| <= 1, in doubles with bounds on rounding; the first columns of G belong to the constants.
"""

import dataclasses
import hashlib
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from flint import acb, arb, arb_mat, arb_series, ctx

__all__ = ["SecondCheck", "check"]

_LOOSER, _GRAIN = 1.01, 5e-8  # factor, and [m] at an instant, by which this checker's bound may exceed the file's
_LAWS, _OMEGA = ("fuzzy-4-tip", "fuzzy-4-sampled-tip", "computed-torque-tip"), 70  # ω of computed torque [rad/s]
_SCHEMAS = ("fuzzyarm-tip-bound/1", "fuzzyarm-tip-bound/2")  # the second also bounds the error between samples
_CONTROLLERS = Path(__file__).parents[1] / "fuzzy_policy" / "controllers"
_PERIOD, _BITS, _SMALL, _ULPS, _UP = 1e-3, 96, 2.0**-44, 2.0**-48, 1.0 + 1e-10
_AGAIN, _ROW, _SHARE = 4, 4096, 2e-3  # most repeats of a lap; tags per step; margin of a set around the end of a lap
_NODES, _RADII, _TURNS, _BOTH, _LISTS = 12, (8.0, 16.0, 32.0), 96, range(2), ("tip", "whole", "steps")
_FLOOR = np.repeat([1e-11, 1e-11, 1e-8, 1e-8, 1e-11, 1e-8, 1e-6, 1e-5, 1e-5], 2)  # far below a µm of the tip
# Factors on the file's radii and on `_FLOOR`, which is added, tried in turn: some enclosures are wider here.
_ROOMS = (1.0, 0.01), (1.01, 0.03), (1.03, 0.1), (1.1, 1.0)
# Rows of S, in the order of the file; the first eight are ξ without δu.
_Q, _V, _DQ, _BEND, _RATE, _NET, _MOTOR, _LINK = (slice(i, i + 2) for i in range(2, 18, 2))
_SEEN, _JOINTS, _LINKS = [2, 3, 6, 7, 16, 17], slice(2, 4), slice(4, 6)  # rows of δq, δq̇ and δq̈; channels of w
_RANGES = ("mass", "motor_inertia", "stiffness", "damping", "dry_friction", "viscous_friction")
_FIXED: dict[str, Any] = {"payload": [0.0, 0.0], "force": [1.0, 1.0], "noise": [0.0, 0.0], "late": 0}
_FIXED |= {"force_swing": 0.0, "force_course": 0.0}
_DEFAULTS: dict[str, Any] = {name: [1.0, 1.0] for name in _RANGES} | _FIXED | {"friction": "law"}
_KNOWN: Any = {"case": ("nominal",), "path": ("circle",), "laps": ("one", "ever")}  # supported values in a claim
_KNOWN |= dict.fromkeys(("arm", "points", "start"), (None,))
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
    verdict: str  # "PROVEN", "NOT PROVEN" or, for laws and motions that the checker does not support, "NOT CHECKED"
    reason: str  # why the claim is not proven or not checked; empty if it is proven
    bound: float  # bound on the tip error [m], found here; nan without a proof
    about: str  # law, set and motion in words, from the numbers of the file
    seconds: float  # duration of the check
    proven: bool  # whether the claim was derived again


def check(path: Path) -> SecondCheck:
    """Derive again the bound stated in a file, and return the outcome; OSError or ValueError if it cannot be read."""
    begin = time.perf_counter()
    try:
        claim = _Claim(json.loads(Path(path).read_bytes(), parse_constant=float))
        unknown = claim.unknown()
    except (LookupError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
        raise ValueError(f"{path} is not a file that fuzzyarm prove wrote: {error!r}") from None
    verdict, reason, place, most = ("NOT CHECKED" if unknown else "PROVEN"), unknown, -1, 0.0
    try:
        with ctx.workprec(_BITS):
            tube: Any = () if unknown else _Tube(claim)
            for place in tube:
                stated = (claim.whole[place] if claim.whole else math.inf), claim.tip[place]
                found = tube.step(place)
                for one, other in zip(found, stated, strict=True):
                    if not one <= _LOOSER * min(other + _GRAIN, claim.bound):
                        raise _Refused(f"the tip error may reach {1e3 * one:.4g} mm, more than the file says")
                most = max(most, *found[not claim.whole :])
    except (ValueError, ArithmeticError, LookupError, TypeError) as error:
        lap = f" of lap {place // claim.count + 1}" if claim.ever else ""
        verdict, reason = "NOT PROVEN", f"control step {place % claim.count + 1}{lap}: " * (place >= 0) + str(error)
    bound, proven = (float(most), True) if verdict == "PROVEN" else (math.nan, False)
    return SecondCheck(Path(path), verdict, reason, bound, claim.words(), time.perf_counter() - begin, proven)


class _Claim:
    """The claim of a file: its law, motion, set of plants, bound and tube."""

    def __init__(self, document: dict[str, Any]) -> None:
        self.schema, self.policy, self.files = document["schema"], str(document["policy"]), document.get("files")
        law, _, margin = self.policy.removeprefix("shield:").partition(":any:")
        self.law, self.guest = law, [abs(float(x)) for x in (margin or "0,0").split(",")]
        self.known = {name: document.get(name, values[0]) for name, values in _KNOWN.items()}
        self.duration, self.bound = float(document["duration"]), float(document["bound"])
        self.plants: dict[str, Any] = _DEFAULTS | document["plants"]
        self.ever, laps = self.known["laps"] == "ever", [document, *document.get("later", [])]
        self.tip, self.whole, self.steps = ([x for lap in laps for x in lap.get(name, ())] for name in _LISTS)
        self.count, self.sizes = round(self.duration / _PERIOD), [[len(lap.get(n, ())) for n in _LISTS] for lap in laps]

    def unknown(self) -> str:
        """Return, in words, what this checker does not support in the claim; empty if nothing."""
        odd = [f"the law {self.law!r} (only {', '.join(_LAWS)})"] * (self.law not in _LAWS)
        odd += [f"files of the schema {self.schema!r}"] * (self.schema not in _SCHEMAS)
        other = [(n, x) for n, x in self.known.items() if x not in _KNOWN[n]]
        odd += [f"any {n} but the default" if isinstance(x, dict) else f"{n} {x!r:.40}" for n, x in other]
        odd += [f"sets with {n}" for n, x in self.plants.items() if n not in _DEFAULTS or x != _FIXED.get(n, x)]
        odd += [] if abs(self.duration / _PERIOD - max(self.count, 1)) < 1e-9 else ["durations in fractions of 1 ms"]
        return f"this checker does not cover {', '.join(odd)}" if odd else ""

    def words(self) -> str:
        """Return the law, the set of plants and the motion in words, from the numbers in the file."""
        said = [f"{name} {value}" for name, value in self.plants.items() if value != _DEFAULTS.get(name)]
        plants = f"with {', '.join(said)}" if said else "table-1"
        samples = "all laps" if self.ever else f"{len(self.tip)} samples"
        motion = f"{self.known['path']} in {self.duration:g} s"
        return ascii(f"{self.policy}, set {plants}, {samples} of the {motion}")[1:-1]


def _upper(x: Any) -> float:
    """Return a float that is at least |x| for every x in a ball."""
    found = float(x.abs_upper()) * (1.0 + 2.0**-50) + 1e-300
    if not math.isfinite(found):
        raise _Refused("no finite bound was found for a number in the proof")
    return found


def _ends(x: Any) -> tuple[float, float]:
    """Return a lower and an upper float bound on a ball."""
    middle, radius = float(x.mid()), _upper(x - x.mid())
    spare = 2.0**-50 * (abs(middle) + radius)
    return middle - radius - spare, middle + radius + spare


def _about(x: Any, radius: float) -> Any:
    return x + arb(0, radius)


def _read(value: Any) -> Any:
    return float.fromhex(value) if isinstance(value, str) else [_read(part) for part in value]


def _lumped(robot: dict[str, Any], link: int) -> list[Any]:
    """Return the contributions of a link to the five constants c_1, ..., c_5 of `link_torque`."""
    m, r, inertia = (arb(robot[name][link]) for name in ("mass", "mass_center", "inertia"))
    L, g, own = arb(robot["length"][0]), arb(robot["gravity"]), m * r * r + inertia
    return [own + m * L * L, m * L * r, own, m * g * L, m * g * r] if link else [own, arb(0), arb(0), m * g * r, arb(0)]


def link_torque(c: list[Any], q: Any, v: Any, a: Any) -> list[Any]:
    """Return both links' torques M(q) a + C(q, v) v + g(q) [N m], v = q̇, a = q̈, for the constants c_1, ..., c_5."""
    cos2, sin2, sin12 = q[1].cos(), q[1].sin(), (q[0] + q[1]).sin()
    first = (c[0] + 2 * c[1] * cos2) * a[0] + (c[2] + c[1] * cos2) * a[1] - c[1] * sin2 * v[1] * (2 * v[0] + v[1])
    second = (c[2] + c[1] * cos2) * a[0] + c[2] * a[1] + c[1] * sin2 * v[0] * v[0]
    return [first + c[3] * q[0].sin() + c[4] * sin12, second + c[4] * sin12]


def _jacobian(f: Any, x: list[Any]) -> list[list[Any]]:
    """Return ∂f/∂x (m, n), from the linear terms of power series in each entry of x."""
    along = ([arb_series([a, int(i == k)], prec=2) for i, a in enumerate(x)] for k in range(len(x)))
    return [list(row) for row in zip(*([y[1] for y in f(series)] for series in along), strict=True)]


def _link_slopes(c: list[Any], q: Any, v: Any, a: Any) -> list[list[list[Any]]]:
    """Return the derivatives of `link_torque`, for its arguments, with respect to q, v and a, (2, 2) each."""
    rows = _jacobian(lambda x: link_torque(c, x[:2], x[2:4], x[4:]), [*q, *v, *a])
    return [[row[i : i + 2] for row in rows] for i in (0, 2, 4)]


class _Plant:
    """The arms of a set: the middle (a ball) and the half width of each constant's range."""

    def __init__(self, robot: dict[str, Any], plants: dict[str, Any]) -> None:
        middle, half = dict[str, list[Any]](), dict[str, list[Any]]()
        for name in _RANGES:
            both = plants[name] if isinstance(plants[name][0], list) else [plants[name]] * 2
            if len(both) != 2 or not all(0.0 <= low <= high < 1e6 for low, high in both):
                raise _Refused(f"the range {plants[name]} of {name} must be (low, high) with 0 <= low <= high < 1e6")
            middle[name] = [(arb(low) + arb(high)) / 2 for low, high in both]
            half[name] = [(arb(high) - arb(low)) / 2 for low, high in both]
        names = ("motor_inertia", "viscous_friction", "stiffness", "damping", "static_friction", "coulomb_friction")
        scaled = [(field, middle[field if field in _RANGES else "dry_friction"]) for field in names]
        parts = [[factor[j] * arb(robot[field][j]) for j in _BOTH] for field, factor in scaled]
        self.inertia, self.viscous, self.stiffness, self.damping, self.static, self.coulomb = parts
        self.any = ("law", "any").index(plants["friction"]) == 1
        self.stribeck, self.length = arb(robot["stribeck_velocity"]), [arb(x) for x in robot["length"]]
        links = [_lumped(robot, j) for j in _BOTH]
        self.c = [sum((middle["mass"][j] * links[j][i] for j in _BOTH), arb(0)) for i in range(5)]
        self.masses = {j: [half["mass"][j] * x for x in links[j]] for j in _BOTH if not half["mass"][j].is_zero()}
        pairs = zip(half["dry_friction"], middle["dry_friction"], strict=True)
        shares = [wide if wide.is_zero() else wide / at for wide, at in pairs]
        self.share = [(_ends(1 - share)[0], _ends(1 + share)[1]) for share in shares]  # ends of the factor on friction
        inner = ("motor_inertia", "viscous_friction", "stiffness", "damping")
        wide = {name: [half[name][j] * arb(robot[name][j]) for j in _BOTH] for name in inner}
        self.half = {name: np.array([0.0 if x.is_zero() else _upper(x) for x in both]) for name, both in wide.items()}
        kinds = [(name, j) for name in _RANGES for j in _BOTH if not half[name][j].is_zero()]
        self.column = {kind: i for i, kind in enumerate(kinds)}  # column of the zonotope, by constant

    def friction(self, joint: int, v: Any) -> Any:
        """Return the magnitude F(v) [N m] of a motor's dry friction, even in v, with all constants at mid-range."""
        fall = (-(v / self.stribeck) * (v / self.stribeck)).exp()
        return self.coulomb[joint] + (self.static[joint] - self.coulomb[joint]) * fall

    def slope(self, joint: int, v: Any) -> Any:
        """Return F'(v) [N m s/rad], the slope of `friction`."""
        return -2 * v / self.stribeck**2 * (self.friction(joint, v) - self.coulomb[joint])

    def steepest(self, joint: int) -> float:
        """Return a bound on |F'| [N m s/rad], which is largest at v_s/√2, with the Stribeck velocity v_s."""
        return _upper(self.slope(joint, self.stribeck / arb(2).sqrt())) * _UP

    def slopes(self, joint: int, low: float, high: float) -> tuple[float, float]:
        """Return a lower and an upper bound on `slope`, F'(v) [N m s/rad], for 0 <= low <= v <= high [rad/s]."""
        (a, b), (c, d) = (_ends(self.slope(joint, arb(v))) for v in (low, high))
        turn = _ends(self.stribeck / arb(2).sqrt())
        return min(a, c, -self.steepest(joint) if low <= turn[1] and high >= turn[0] else math.inf), max(b, d)


def _tip(q: list[Any], length: list[Any]) -> list[Any]:
    """Return the tip's position [x, y] [m], x downwards, at the link angles q."""
    parts = [(L * phi.cos(), L * phi.sin()) for L, phi in zip(length, (q[0], q[0] + q[1]), strict=True)]
    return [a + b for a, b in zip(*parts, strict=True)]


def _on_circle(t: Any, duration: float) -> list[Any]:
    """Return p(t) [m] on the circle about (0.35, 0.65), R = 0.2, as ψ falls by 2π from π/2, by a quintic law."""
    x = t / arb(duration)
    psi = arb.pi() / 2 - 2 * arb.pi() * x * x * x * (10 - 15 * x + 6 * x * x)
    return [arb(0.35) + arb(0.2) * psi.cos(), arb(0.65) + arb(0.2) * psi.sin()]


def _reference(t: float, duration: float, length: list[Any]) -> tuple[list[Any], list[Any], list[Any]]:
    """Return balls of q_d, q̇_d, q̈_d on the circle at time t [s], with q_2 > 0, that contain the policy's floats."""
    (x, y), (one, two) = _on_circle(arb_series([t, 1], prec=3), duration), length
    q2 = ((x * x + y * y - one * one - two * two) / (2 * one * two)).acos()
    series = [(y / x).atan() - (two * q2.sin() / (one + two * q2.cos())).atan(), q2]  # x > 0
    q, v, a = ([factor * joint[i] for joint in series] for i, factor in enumerate((1, 1, 2)))
    size = _ULPS * (1.0 + sum(map(_upper, v)) + sum(_upper(x) ** 2 for x in v) + sum(map(_upper, a)))
    return [_about(x, _ULPS) for x in q], [_about(x, size) for x in v], [_about(x, size) for x in a]


def _sign_at_rest(robot: dict[str, Any], joint: int) -> float:
    """Return the sign that the law computes for θ̇_d of a joint at rest, where rounding errors replace the exact 0."""
    (one, two), (m1, m2), (r1, r2), g = (robot[name] for name in ("length", "mass", "mass_center", "gravity"))
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
    return float(np.sign((rate - b * curvature) / k + 0.5 * _PERIOD * (curvature / k)))


class _Law:
    """A law u = own(θ, θ̇, x_I; r) + u_ff, r = (θ_d, θ̇_d, θ̈_d), where own = 0 at θ = θ_d, θ̇ = θ̇_d, x_I = 0."""

    def __init__(self, robot: dict[str, Any], duration: float) -> None:
        self.robot, self.nominal, self.duration = robot, _Plant(robot, _DEFAULTS), duration
        self._past, self._before = list[Any](), list[Any]()  # last samples of τ_d, latest first; smooth part of u_ff

    def _target(self, k: int) -> tuple[list[Any], list[Any]]:
        """Return r = (θ_d, θ̇_d, θ̈_d) (6,) and u_ff (2,) at the k-th sample, in balls."""
        n, (q, v, a) = self.nominal, _reference(_PERIOD * k, self.duration, self.nominal.length)
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
            sign = float(middle > 0) - float(middle < 0) or math.nan  # nan if undecided: refused as not finite
            side = sign if self._before else _sign_at_rest(self.robot, j)
            slips.append(side * n.friction(j, middle))
        before, self._before = self._before or smooth, smooth
        u_ff = [s + (s - old) / 2 + slip for s, old, slip in zip(smooth, before, slips, strict=True)]
        u_ff = [_about(u, _ULPS * (1.0 + _upper(u)) + 1e-13) for u in u_ff]
        return [target[j][i] for i in range(3) for j in _BOTH], u_ff

    def respond(self: Any, k: int, point: list[float], box: np.ndarray) -> tuple[list[Any], Any, Any, list[Any]]:
        """Return u at sample k, x = (θ, θ̇, x_I) = point; ∂u/∂x (2, 6); bounds (2,) on u's remainder in x ± box; θ_d."""
        (r, u_ff), x = self._target(k), [arb(number) for number in point]
        wide = [_about(a, radius) for a, radius in zip(x, box.tolist(), strict=True)]
        near, far = (_jacobian(lambda y: self._own(y, r), y) for y in (x, wide))  # ∂u/∂(θ, θ̇, x_I), (2, 6)
        centre, rest = np.vectorize(lambda a: float(a.mid()))(near), np.zeros(2)
        for j, (slopes, gains) in enumerate(zip(far, self._gains_at(wide), strict=True)):
            # Rounding errors of the law for any order of its sums: a share of the sizes of its terms.
            sizes = _upper(_dot([abs(a) for a in gains], [abs(a) for a in _less(wide, r)]))
            rest[j] = _distance(slopes, centre[j]) @ box + 2.0 * _ULPS * (sizes + 200.0 * sum(map(_upper, r)) + 1.0)
        return [own + ahead for own, ahead in zip(self._own(x, r), u_ff, strict=True)], centre, rest * _UP, r[:2]


class _ComputedTorque(_Law):
    """Computed torque: u - u_ff = f(θ, θ̇, θ̈_d - 3ω ė - 3ω² e - ω³ x_I) - f(r), f(q, v, a) = M a + C v + g + f_v v."""

    def _own(self, x: list[Any], r: list[Any]) -> list[Any]:
        n, e, w, both = self.nominal, _less(x, r), _OMEGA, []
        asked = [r[4 + j] - w * (3 * e[2 + j] + w * (3 * e[j] + w * e[4 + j])) for j in _BOTH]
        for y, a in ((x, asked), (r, r[4:])):
            links = link_torque(n.c, y[:2], y[2:4], a)
            both.append([links[j] + n.inertia[j] * a[j] + n.viscous[j] * y[2 + j] for j in _BOTH])
        return [a - b for a, b in zip(*both, strict=True)]

    def _gains_at(self, x: list[Any]) -> list[list[Any]]:
        """Return the gains (2, 6) from (e, ė, x_I) to torques at the state x: M(θ) times 3ω², 3ω and ω³."""
        n, w, rows = self.nominal, _OMEGA, _link_slopes(self.nominal.c, x[:2], [arb(0)] * 2, [arb(0)] * 2)[2]
        rows = [[a + n.inertia[j] * int(i == j) for i, a in enumerate(row)] for j, row in enumerate(rows)]
        return [[factor * a for factor in (3 * w * w, 3 * w, w**3) for a in row] for row in rows]


class _Fuzzy(_Law):
    """The fuzzy law: gains that depend on θ, times the errors (e, ė, x_I), plus u_ff, computed for θ instead of θ_d."""

    def __init__(self, document: dict[str, Any], duration: float) -> None:
        super().__init__({name: _read(value) for name, value in document["robot"].items()}, duration)
        if document["kept"] != ["z1", "z3"] or document["form"] != "consistent" or not document["integral"]:
            raise _Refused("the controller must have the consistent form, integral action, and the premises z1 and z3")
        self._bounds = [[arb(x) for x in _read(document["bounds"])[i]] for i in (0, 2)]
        at = [pair for half in _read(document["gains"]) for pair in half]  # by vertex of A (z3) and of E (z1)
        self._corners = [[list(map(arb, four)) for four in zip(*(pair[j] for pair in at), strict=True)] for j in _BOTH]

    def _premises(self, x: list[Any]) -> list[Any]:
        return [x[1].cos(), -self.nominal.c[4] * (x[0] + x[1]).sin() / (x[0] + x[1])]

    def _gains_at(self, x: list[Any]) -> list[list[Any]]:
        w1, w3 = ((z - low) / (high - low) for z, (low, high) in zip(self._premises(x), self._bounds, strict=True))
        if not all(0 < w < 1 for w in (w1, w3) if isinstance(w, arb)):
            raise _Refused("the premise z1 or z3 may leave the range for which the controller was designed")
        shares = [(1 - w3) * (1 - w1), (1 - w3) * w1, w3 * (1 - w1), w3 * w1]
        return [[_dot(shares, four) for four in joint] for joint in self._corners]

    def _own(self, x: list[Any], r: list[Any]) -> list[Any]:
        z, aim, c2 = self._premises(x), self._premises(r), self.nominal.c[1]
        first, third = z[0] - aim[0], z[1] - aim[1]
        ahead = [c2 * first * (2 * r[4] + r[5]) - third * r[1], c2 * first * r[4] - third * (r[0] + r[1])]
        return [_dot(gains, _less(x, r)) + own for gains, own in zip(self._gains_at(x), ahead, strict=True)]


def _less(x: list[Any], r: list[Any]) -> list[Any]:
    return [*(a - b for a, b in zip(x[:4], r[:4], strict=True)), *x[4:]]


def _dot(a: list[Any], b: list[Any]) -> Any:
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))


class _Course:
    """A function f(s) = Σ c_j T_j(s) ± `left` on a segment, -1 <= s <= 1, with Chebyshev polynomials T_j."""

    def __init__(self, c: list[Any], left: float) -> None:
        self.c, self.left, self.sizes = c, left, [_upper(x) for x in c]

    def line(self) -> tuple[float, float, float]:
        """Return level and slope of the line c_0 + c_1 s in floats, and a bound on the distance of f from it."""
        level, slope = float(self.c[0].mid()), float(self.c[1].mid())
        beside = _upper(self.c[0] - level) + _upper(self.c[1] - slope) + sum(self.sizes[2:]) + self.left
        return level, slope, beside * _UP

    def size(self) -> float:
        return (sum(self.sizes) + self.left) * _UP

    def range(self) -> tuple[float, float]:
        """Return bounds on f: its end values if |c_1| > Σ j² |c_j|, j > 1, because |T_j'| <= j², else c_0 ± Σ |c_j|."""
        ends = [_ends(x) for x in (sum(self.c, arb(0)), sum(self.c[::2], arb(0)) - sum(self.c[1::2], arb(0)))]
        beside = self.left
        if not float(self.c[1].abs_lower()) > 1.001 * sum(j * j * x for j, x in enumerate(self.sizes[2:], 2)):
            ends, beside = [_ends(self.c[0])], (sum(self.sizes[1:]) + self.left) * _UP
        return min(low for low, _ in ends) - beside, max(high for _, high in ends) + beside

    def ball(self, radius: float) -> Any:
        low, high = self.range()
        return arb(low - radius).union(arb(high + radius))


class _Motion:
    """The centre on a segment: θ and q as polynomials in s, and their derivatives in t = begin + h (s + 1)/2."""

    def __init__(self, angles: list[list[float]], h: float, begin: float) -> None:
        if len(angles) != 4 or any(len(row) != 8 for row in angles):
            raise _Refused("angles of a segment must be four polynomials of eight coefficients each")
        rows = [[arb(x) for x in row] for row in angles]
        self.polynomials = [rows]
        for _ in _BOTH:
            rows = [[*[2 * i * x / arb(h) for i, x in enumerate(row)][1:], arb(0)] for row in rows]
            self.polynomials.append(rows)
        turns: list[Any] = [arb.pi() * (2 * i + 1) / (2 * _NODES) for i in range(_NODES)]
        self._turned = arb_mat([[(j * x).cos() * 2 / _NODES / (1 if j else 2) for x in turns] for j in range(_NODES)])
        discs: list[Any] = [acb(arb(0, (r + 1 / r) / 2), arb(0, (r + 1 / r) / 2)) for r in _RADII]
        every = [(*self.at(s), begin + (s + 1) * arb(h) / 2) for s in [*(x.cos() for x in turns), *discs]]
        self._nodes, self._discs = every[:_NODES], every[_NODES:]

    def at(self, s: Any) -> list[list[Any]]:
        """Return the angles, velocities and accelerations of (θ_1, θ_2, q_1, q_2) at s, -1 to 1 on the segment."""
        powers = [s**i for i in range(8)]
        return [[_dot(row, powers) for row in part] for part in self.polynomials]

    def courses(self, linear: Any, others: list[Any]) -> tuple[list[_Course], list[list[_Course]]]:
        """Return f(*at(s), t) as lists of functions of s: of f = `linear`; then of each f in `others`, interpolated."""
        values = [[f(*at) for f in (linear, *others)] for at in self._nodes]
        flat = arb_mat([[x for part in row for x in part] for row in values])
        places = iter((self._turned * flat).transpose().table())
        exact, found = [_Course(next(places), 0.0) for _ in values[0][0]], []
        for f in others:
            shares = [4.0 * r ** (1 - _NODES) / (r - 1.0) * _UP for r in _RADII]
            sizes = np.array([[float(x.abs_upper()) for x in f(*disc)] for disc in self._discs])
            left = np.nan_to_num(sizes * np.array(shares)[:, np.newaxis], nan=math.inf).min(axis=0)
            found.append([_Course(next(places), one) for one in left.tolist()])
        return exact, found


def _floats(matrix: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles and the radii of a matrix of balls as float arrays."""
    shape, entries = (matrix.nrows(), matrix.ncols()), matrix.entries()
    middle = np.array([float(x.mid()) for x in entries]).reshape(shape)
    radius = np.array([float(x.rad()) for x in entries]).reshape(shape)
    if not np.isfinite(middle).all():
        raise _Refused("no finite bound was found for an entry of a matrix in the proof")
    return middle, radius * _UP + 2.0**-52 * np.abs(middle)


def _above(matrix: Any) -> np.ndarray:
    middle, radius = _floats(matrix)
    return np.asarray((np.abs(middle) + radius) * _UP)


_distance = np.vectorize(lambda x, middle: _upper(x - middle), otypes=[float])


def _reach(rows: tuple[np.ndarray, np.ndarray], G: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return bounds on the entries of |X G g + own π|, g = (π, ...), |g| <= 1, X with middle and radii `rows`."""
    image = np.einsum("ij,jk", rows[0], G)
    image[:, : own.shape[1]] += own
    spare = (rows[1] + _SMALL / 4 * np.abs(rows[0])) @ np.abs(G).sum(axis=1) + _SMALL * np.abs(own).sum(axis=1)
    return np.asarray((np.abs(image).sum(axis=1) + spare * _UP) * _UP)


class _Friction:
    """The dry friction Γ_f of a motor on a segment. N is its torque without Γ_f; the centre needs Γ_f = -P."""

    def __init__(self, plant: _Plant, joint: int, plan: str, mode: int, known: Any, motion: Any) -> None:
        self.joint, self.plan, self.known, self._plant = joint, plan, known, plant
        self.net, self.needed, self.v, self.a, self.slips = motion  # N, P, v, θ̈ and F(v) of the centre
        self.side, self._rests = (mode if mode in (-1, 1) else 0), all(x.is_zero() for x in self.v.c)
        self.static, self.share = _ends(plant.friction(joint, arb(0))), plant.share[joint]
        self.uncertain = max(1.0 - self.share[0], self.share[1] - 1.0)
        self.inertia, self._range = _ends(plant.inertia[joint])[0], self.v.range()
        plans = ("any",) if plant.any else ("held", "slip", "monotone", "mixed")
        fits = plan in plans and mode in (-1, 0, 1, 2) and (self.side or plan != "slip")
        if not fits or (plan == "held" and not (self._rests and known == (0.0, 0.0))):
            raise _Refused(f"motor {joint + 1}: plan {plan!r} does not fit mode {mode!r}, the set and the motion")
        parts = [_upper(p - self.side * f) for p, f in zip(self.needed.c, self.slips.c, strict=True)]
        self.missed = (sum(parts) + self.needed.left + self.slips.left) * _UP  # bound on |P - σ F(v)|
        self.slope = -float(plant.slope(joint, arb(0.5 * abs(sum(self._range)))).mid()) if plan == "slip" else 0.0

    def parted(self, start: float, h: float, driving: float) -> Any:
        """Return a bound on |δv| [rad/s] over h [s] by Lemma 2: initially |δv| <= `start`; |δN| <= `driving` [N m]."""
        eta, aside = self.needed.size() + self.share[1] * self.static[1], 0.0
        if self.side:  # a centre with v of the other sign, up to `aside`, is compared after a shift
            eta = self.missed + self.uncertain * self.static[1]
            aside = max(0.0, -self._range[0] if self.side > 0 else self._range[1])
        elif self._rests:
            eta = max(0.0, self.needed.size() - self.share[0] * self.static[0])
        steep = self._plant.steepest(self.joint) * self.share[1]
        grown = start + aside + h * (driving + eta + steep * aside) / self.inertia
        return (grown * math.exp(steep / self.inertia * h) + aside) * _UP

    def bound(self, tube_v: float, spread: float, h: float) -> Any:
        """Return a bound [N m] on |Γ_f + P - slope δv| during h [s] with |δv| <= tube_v, |N - N_y| <= spread."""
        j, plant, (weak, strong) = self.joint, self._plant, self.share
        low, high = self._range[0] - tube_v, self._range[1] + tube_v
        if self.plan == "any":
            return (self.needed.size() + strong * self.static[1]) * _UP
        if self.plan == "held":
            if not self.net.size() + spread < weak * self.static[0] * (1.0 - 1e-9):
                raise _Refused(f"the file says that motor {j + 1} rests, but it may begin to move")
            return 0.0
        if self.plan == "slip":
            if not (low if self.side > 0 else -high) > 0.0:
                raise _Refused(f"the file says that motor {j + 1} keeps turning, but it may stop")
            falling, rising = plant.slopes(j, *sorted((abs(low), abs(high))))
            bent = max(abs(falling + self.slope), abs(rising + self.slope)) + self.uncertain * max(-falling, rising)
            return (self.missed + bent * tube_v) * _UP
        falling, rising = self._rates(tube_v, spread)
        low = max(low, min(self.known[0], 0.0) + min(falling, 0.0) * h * _UP)
        high = min(high, max(self.known[1], 0.0) + max(rising, 0.0) * h * _UP)
        need, found = self.needed.range(), [0.0]
        for side, slowest, fastest in ((1, max(0.0, low), high), (-1, max(0.0, -high), -low)):
            if fastest > 0.0:
                under, over = _ends(plant.friction(j, arb(fastest)))[0], _ends(plant.friction(j, arb(slowest)))[1]
                if side == self.side:
                    found.append(self.missed + plant.steepest(j) * tube_v + self.uncertain * over)
                else:
                    pulls = -side * weak * under, -side * strong * over
                    found += [abs(need[0] + min(pulls)), abs(need[1] + max(pulls))]
        if low <= 0.0 <= high:  # at rest, where Γ_f = -N and the motor does not accelerate
            static, net = strong * self.static[1], self.net.range()
            rest = spread + self.inertia * (1.0 + 1e-9) * self.a.size()
            bottom, top = max(net[0] - spread, -static), min(net[1] + spread, static)
            if bottom <= top:
                found += [min(rest, max(0.0, top - need[0])), min(rest, max(0.0, need[1] - bottom))]
        return max(found) * _UP

    def _rates(self, tube_v: float, spread: float) -> tuple[float, float]:
        """Return a lower bound on v̇ [rad/s²] for v < 0, and an upper bound for v > 0; arguments as for `bound`."""
        net, weak = self.net.range(), self.share[0]
        low, high = self._range[0] - tube_v, self._range[1] + tube_v
        back, forth = (weak * _ends(self._plant.friction(self.joint, arb(max(x, 0.0))))[0] for x in (-low, high))
        spare = 1e-10 * (abs(net[0]) + abs(net[1]) + spread + back + forth)
        return (net[0] - spread + back - spare) / self.inertia, (net[1] + spread - forth + spare) / self.inertia

    def after(self, tube_v: float, spread: float, h: float, end: float) -> tuple[float, float]:
        """Return the range of v [rad/s] at the segment's end, for the centre's v = `end`; others as for `bound`."""
        if self.plan in ("any", "held"):
            return (-math.inf, math.inf) if self.plan == "any" else (0.0, 0.0)
        falling, rising = self._rates(tube_v, spread)
        least = min(0.0, min(self.known[0], 0.0) + h * falling * (1.0 - 1e-10 * np.sign(falling)))
        most = max(0.0, max(self.known[1], 0.0) + h * rising * (1.0 + 1e-10 * np.sign(rising)))
        spare = tube_v * _UP + 1e-15 * (1.0 + abs(end))
        return max(end - spare, least), min(end + spare, most)


class _Tube:
    """The tube of deviations. Iterating over it yields the indices of control steps for which to call `step`."""

    def __init__(self, claim: _Claim) -> None:
        self._claim, name = claim, claim.law.removesuffix("-tip") + ".json"
        self._law: Any = _ComputedTorque(_TABLE_1, claim.duration)
        if claim.law != "computed-torque-tip":
            content = (_CONTROLLERS / name).read_bytes()
            if claim.files != {name: hashlib.sha256(content).hexdigest()}:
                raise _Refused(f"{name} is not the controller file for which the bound was found")
            self._law = _Fuzzy(json.loads(content), claim.duration)
        if any(self._law.robot.get(field) != value for field, value in _TABLE_1.items()):
            raise _Refused(f"the controller {name} is for another arm, but this checker covers only the arm of Table 1")
        self._plant = plant = _Plant(self._law.robot, claim.plants)
        least, most, sizes = (claim.count if claim.ever else 1), claim.count, claim.sizes
        fits = [least <= a == c <= most and b == a * _SCHEMAS.index(claim.schema) for a, b, c in sizes]
        if claim.ever != (len(fits) > 1) or not all(fits):
            raise _Refused(f"tip, whole and steps have {sizes} entries, which do not fit a motion of {most} steps")
        q, nominal = _reference(0.0, claim.duration, plant.length)[0], self._law.nominal
        hung = link_torque(nominal.c, q, [arb(0)] * 2, [arb(0)] * 2)
        start = [*(a + t / k for a, t, k in zip(q, hung, nominal.stiffness, strict=True)), *q]
        self._centre = [*(float(x.mid()) for x in start), *[0.0] * 4]
        self._memory, self._known, self._begin = [0.0, 0.0], [(0.0, 0.0)] * 2, list[Any]()
        # rows: ξ with δu, then x_I; columns: the constants, then the disturbances so far, each with a tag
        self._G, self._tags, self._tag = np.zeros((12, len(plant.column))), np.zeros(0, dtype=int), 0
        self._move([start, [arb(0)] * 4])
        self._last = self._tip(0.0)

    def __iter__(self) -> Iterator[int]:
        """Yield each control step's index; of endless laps, repeat the last until it ends in its initial set."""
        steps, count, place, again = len(self._claim.steps), self._claim.count, 0, _AGAIN
        while place < steps:
            yield place
            place += 1
            if self._claim.ever and place % count == 0 and not self._is_inside() and place == steps:
                place, again = place - count, again - 1
                if not again:
                    raise _Refused("the set in which the final lap ends is not inside the set in which it begins")

    def step(self, place: int) -> tuple[float, float]:
        """Take the control step of this index; return bounds on the tip error during the step and at its end [m]."""
        self._tag = _ROW * (k := place % self._claim.count)
        torque, begun, most = self._sample(k), 0.0, 0.0
        for part in self._claim.steps[place]:
            most = max(most, self._cross(part, _PERIOD * k + begun, torque))
            begun += part["duration"]
        if begun != _PERIOD:
            raise _Refused(f"its segments last {begun} s in total; needed: {_PERIOD} s")
        self._G[8:10] = 0.0
        if k % 40 == 39:
            self._prune()
        return most, self._last

    def _is_inside(self) -> bool:
        """Return whether the lap ends in its initial set; the next lap will begin in a set that contains this end.

        Such a set is c + C π + G g + B g', |g|, |g'| <= 1, with c, C and G from the end. `rest` is the next end minus
        c + C π + G g, common columns subtracted. It equals B g' with |g'| <= 1 under Lemma 7 of the documentation.
        """
        rows, m, share, inside = [*range(8), 10, 11], len(self._plant.column), _SHARE, False
        point, G = np.array([*self._centre, *self._memory]), self._G[rows]
        unit = np.abs(G).sum(axis=1) + 1e-12
        if self._begin:
            c, S, tags, B, before = self._begin
            _, i, j = np.intersect1d(tags, self._tags, return_indices=True)
            rest = np.column_stack([G, point - c])
            rest[:, [*range(m), *(m + j)]] -= S[:, [*range(m), *(m + i)]]
            W, sizes = np.linalg.inv(B), np.abs(S).sum(axis=1) + unit + np.abs(point - c)
            wide = float((np.abs(W @ rest).sum(axis=1) + _SMALL * np.abs(W) @ sizes).max()) * _UP
            left = (np.abs(np.eye(len(B)) - W @ B) + _SMALL * np.abs(W) @ np.abs(B)).sum(axis=1).max()
            inside, share = wide < 1.0 - left, max(_SHARE, 2.0 * wide * before)
        frame = unit[:, np.newaxis] * np.linalg.svd(G / unit[:, np.newaxis], full_matrices=False)[0]
        B = frame * (share * np.abs(np.linalg.solve(frame, G)).sum(axis=1) + 1e-12)
        self._begin, self._known = [point, G, self._tags, B, share], [(-math.inf, math.inf)] * 2
        self._G = np.zeros((12, G.shape[1] + len(B)))
        self._G[rows] = np.hstack([G, B])
        self._tags, self._last = -1 - np.arange(self._G.shape[1] - m), self._tip(0.0)
        return inside

    def _widen(self, box: np.ndarray, *columns: np.ndarray) -> None:
        """Add a box of these half widths to the first rows of the zonotope, and further columns."""
        wide = np.eye(12)[:, : len(box)] * box
        self._G = np.hstack([self._G, wide[:, box > 0.0], *columns])
        count = self._G.shape[1] - len(self._plant.column) - len(self._tags)
        self._tags, self._tag = np.append(self._tags, self._tag + np.arange(count)), self._tag + count

    def _move(self, of: list[list[Any]]) -> None:
        self._widen(np.array([_upper(x - c) for x, c in zip([*of[0], *of[1]], self._centre, strict=True)]))

    def _prune(self) -> None:
        """Replace the zonotope's smallest columns, in each row at most 1e-4 of its sum, by a box that contains them."""
        m = len(self._plant.column)
        sizes = np.abs(self._G[:, m:])
        share = (sizes / np.maximum(sizes.sum(axis=1, keepdims=True), 1e-300)).max(axis=0)
        order = np.argsort(share)
        small = m + order[np.cumsum(share[order]) < 1e-4]
        box = np.abs(self._G[:, small]).sum(axis=1) * _UP
        self._G, self._tags = np.delete(self._G, small, axis=1), np.delete(self._tags, small - m)
        self._widen(box)

    def _sample(self, k: int) -> np.ndarray:
        """Add the law's torque and its memory at t_k to the zonotope; return the torque at the centre."""
        G, c = self._G[[0, 1, 4, 5, 10, 11]], self._centre
        box, point = np.abs(G).sum(axis=1) * _UP, [*c[:2], *c[4:6], *self._memory]
        answer, slopes, rest, aim = self._law.respond(k, point, box)
        torque = np.array([float(u.mid()) for u in answer])
        rest += _SMALL * np.abs(slopes) @ box
        rest += [_upper(u - c) for u, c in zip(answer, torque.tolist(), strict=True)]
        guest = np.array(self._claim.guest)  # bound on |w|; a limit on a sum only reduces its change by w
        rest += (guest + _ULPS * (np.abs(torque) + np.abs(slopes) @ box)) * _UP * (guest > 0.0)
        after = [x + arb(_PERIOD) * (arb(p) - a) for x, p, a in zip(self._memory, point[:2], aim, strict=True)]
        self._memory = [float(x.mid()) for x in after]
        left = [_upper(x - c) + _SMALL * abs(c) for x, c in zip(after, self._memory, strict=True)]
        self._G[8:10], self._G[10:12] = slopes @ G, G[4:6] + _PERIOD * G[:2]
        self._widen(np.concatenate([np.zeros(8), rest, left + _SMALL * (box[4:] + box[:2])]))
        reach = np.abs(torque) + np.abs(self._G[8:10]).sum(axis=1) * _UP
        if not (reach - guest < self._law.robot["torque_limit"]).all():
            raise _Refused(
                f"motor {np.argmax(reach - guest - self._law.robot['torque_limit']) + 1} may reach its torque limit"
            )
        return torque

    def _cross(self, part: dict[str, Any], begin: float, torque: np.ndarray) -> float:
        """Propagate the zonotope over a segment from `begin` [s], torque held; return a bound on its tip error [m]."""
        p, radii, h = self._plant, np.array(part["tube"], dtype=float), part["duration"]
        whole = radii.shape == (18,) and len(part["plans"]) == len(part["modes"]) == 2
        if not (whole and np.isfinite(radii).all() and (radii >= 0.0).all() and 0.0 < h <= _PERIOD):
            raise _Refused("a segment must have 18 radii >= 0, two plans, two modes, and a duration > 0, up to 1 ms")
        motion, T = _Motion(part["angles"], h, begin), self._claim.duration
        self._move(motion.at(arb(-1)))

        def pull(x: Any, v: Any) -> list[Any]:
            return [p.stiffness[j] * (x[j] - x[2 + j]) + p.damping[j] * (v[j] - v[2 + j]) for j in _BOTH]

        def linear(x: Any, v: Any, a: Any, _: Any) -> list[Any]:
            net = [arb(u) - f - p.viscous[j] * v[j] for j, (u, f) in enumerate(zip(torque, pull(x, v), strict=True))]
            needed = [n - p.inertia[j] * a[j] for j, n in enumerate(net)]
            bent = [y[j] - y[2 + j] for y in (x, v) for j in _BOTH]
            return [*bent, *net, *v[:2], *a[:2], *needed, *x[2:], *v[2:], *a[2:]]

        others = [
            lambda x, v, a, _: [t - r for t, r in zip(pull(x, v), link_torque(p.c, x[2:], v[2:], a[2:]), strict=True)],
            lambda x, _v, _a, t: [a - b for a, b in zip(_tip(x[2:], p.length), _on_circle(t, T), strict=True)],
            lambda _x, v, _a, _t: [p.friction(j, v[j]) for j in _BOTH],
            *(lambda x, v, a, _, c=c: link_torque(c, x[2:], v[2:], a[2:]) for c in p.masses.values()),
        ]
        exact, (defect, errors, slip, *mass) = motion.courses(linear, others)
        names = ("bend", "rate", "net", "v", "a", "needed", "q", "dq", "ddq")
        along = {name: exact[2 * i : 2 * i + 2] for i, name in enumerate(names)} | {"slips": slip, "defect": defect}
        own = [[along[name][j] for name in ("net", "needed", "v", "a", "slips")] for j in _BOTH]
        frictions = [_Friction(p, j, part["plans"][j], part["modes"][j], self._known[j], own[j]) for j in _BOTH]
        middle = [[row[0] for row in of[2:]] for of in motion.polynomials]
        slopes = [np.vectorize(lambda x: float(x.mid()))(_link_slopes(c, *middle)) for c in (p.c, *p.masses.values())]
        drives = self._drives(along, mass, frictions)
        linear_part = self._free(*self._linear(slopes, frictions), drives[0], drives[1], h)
        for room, floor in _ROOMS:
            tube = room * radii + floor * _FLOOR
            try:
                w, reached, spread = self._torques(tube, along, frictions, slopes, drives, linear_part, h)
            except _Refused:
                if room == _ROOMS[-1][0]:
                    raise
                continue
            if (reached < tube).all():
                break
        else:
            row = int(np.argmax(reached / tube))
            raise _Refused(f"row {row + 1} of the tube may reach {reached[row]:.4g}; its radius is {radii[row]:.4g}")
        linear_part[2](w)
        for j, friction in enumerate(frictions):
            if friction.plan == "monotone":
                self._G[4 + j] = 0.0
                self._widen(np.zeros(0), w[j] * np.eye(12)[:, 4 + j : 5 + j])
        self._centre, before = [float(x) for x in part["end"]], self._last
        ends = motion.at(arb(1))
        self._known = [f.after(tube[_V][j], spread[j], h, float(ends[1][j].mid())) for j, f in enumerate(frictions)]
        self._move(ends)
        self._last = self._tip(begin + h)
        return (max(before, self._last) + self._between(tube, along, errors, h)) * _UP

    def _linear(self, slopes: list[Any], frictions: list[_Friction]) -> tuple[Any, Any, Any, Any]:
        """Return A (10, 10), b (10, 6), S (n, 10) and D (n, 6) of ξ̇ = A ξ + b w with outputs S ξ + D w.

        The outputs are the 18 rows of the tube, then the torques on both links that each uncertain mass adds. `slopes`
        are derivatives of link torques with respect to q, q̇, q̈: for the plant at mid-range, then for each mass.
        """
        p, zero, (angle, speed, mass) = self._plant, arb(0), slopes[0]
        A, b, D = ([[zero] * n for _ in range(rows)] for rows, n in ((10, 10), (10, 6), (18, 6)))
        S = [[arb(int(i == j)) for j in range(10)] for i in range(8)]
        pulls, nets = [], []
        for j, friction in enumerate(frictions):
            moves = 0 if friction.plan == "held" else 1
            free, joint = moves / p.inertia[j], [zero] * 10
            joint[j], joint[4 + j] = p.stiffness[j], p.damping[j]
            joint[2 + j], joint[6 + j] = -p.stiffness[j], -p.damping[j]
            net = [-x for x in joint]
            net[4 + j], net[8 + j] = net[4 + j] - p.viscous[j], arb(1)
            nets.append(net)
            A[j][4 + j], A[2 + j][6 + j], A[4 + j] = arb(moves), arb(1), [free * x for x in net]
            A[4 + j][4 + j] += free * arb(friction.slope)
            b[4 + j][j], b[4 + j][2 + j] = free, -free
            for i in _BOTH:
                joint[2 + i], joint[6 + i] = joint[2 + i] - arb(angle[j][i]), joint[6 + i] - arb(speed[j][i])
            pulls.append(joint)
        for i, inverse in enumerate(np.linalg.inv(mass).tolist()):
            A[6 + i] = [inverse[0] * x + inverse[1] * y for x, y in zip(*pulls, strict=True)]
            b[6 + i][2:6] = list(map(arb, inverse + inverse))
        S += [[x - y for x, y in zip(S[at + j], S[at + 2 + j], strict=True)] for at in (0, 4) for j in _BOTH]
        S += nets + [row[:] for row in A[4:8]]
        D[14:18] = [row[:] for row in b[4:8]]
        for j, friction in enumerate(frictions):
            if friction.plan == "monotone":  # its velocity is an input with a separate bound
                v = 4 + j
                A[v], b[v], S[14 + j], D[14 + j] = [zero] * 10, [zero] * 6, [zero] * 10, [zero] * 6
                for row, channel in zip([*A, *S], [*b, *D], strict=True):
                    channel[j], row[v] = row[v], zero
        rows = [[*x, *y] for x, y in zip(S, D, strict=True)]
        seen = arb_mat([rows[i] for i in _SEEN])
        for one in slopes[1:]:
            rows += (arb_mat(np.hstack(one).tolist()) * seen).table()
        return arb_mat(A), arb_mat(b), arb_mat([row[:10] for row in rows]), arb_mat([row[10:] for row in rows])

    def _drives(self, along: Any, mass: Any, frictions: list[_Friction]) -> Any:
        """Return level, slope (6, m) of lines near a(s); bounds (6,) on |(a - lines) π|, (2,) on what a π adds to N."""
        p, m = self._plant, len(self._plant.column)
        level, slope, rest, sizes, made = np.zeros((6, m)), np.zeros((6, m)), np.zeros(6), np.zeros(2), []
        signals = {"stiffness": ("bend", 2, 1.0), "damping": ("rate", 2, 1.0)}
        signals |= {"motor_inertia": ("a", 0, -1.0), "viscous_friction": ("v", 0, -1.0)}
        for (kind, j), column in p.column.items():
            friction = frictions[j]
            if kind == "mass":
                made += [(column, 4 + i, -1.0, course) for i, course in enumerate(mass[list(p.masses).index(j)])]
            elif kind == "dry_friction":
                factor = -friction.side * friction.uncertain if friction.plan == "slip" else 0.0
                made.append((column, j, factor, friction.slips))
            else:
                name, channel, sign = signals[kind]
                sizes[j] += p.half[kind][j] * along[name][j].size() * _UP
                made.append((column, channel + j, sign * p.half[kind][j], along[name][j]))
        for column, channel, factor, course in made:
            if channel not in _BOTH or frictions[channel].plan != "monotone":
                at, by, beside = course.line()
                level[channel, column], slope[channel, column] = factor * at, factor * by
                rest[channel] += abs(factor) * (beside + _SMALL * (abs(at) + abs(by))) * _UP
        return level, slope, rest, sizes

    def _torques(self, tube: Any, along: Any, frictions: Any, slopes: Any, drives: Any, linear: Any, h: float) -> Any:
        """Return w̄ (6,), bounds on |S ξ| (18,) and on |N - N_y| (2,) [N m], while |S ξ| <= a claimed `tube` (18,)."""
        (_, _, rest, sizes), (free, push, _), p = drives, linear, self._plant
        w, half, begin = rest.copy(), p.half, np.abs(self._G[4:6]).sum(axis=1) * _UP
        within = half["stiffness"] * tube[_BEND] + half["damping"] * tube[_RATE]
        own = half["motor_inertia"] * tube[_MOTOR] + half["viscous_friction"] * tube[_V]
        spread = (tube[_NET] + sizes + within + own) * _UP
        w[_JOINTS] += within
        for j, friction in enumerate(frictions):
            if friction.plan == "monotone":
                w[j] = friction.parted(begin[j], h, spread[j])
            else:
                w[j] += friction.bound(tube[_V][j], spread[j], h) + own[j]
        radii = np.array([tube[_Q], tube[_DQ], tube[_LINK]])
        wide = [[along[of][i].ball(float(radii[n, i])) for i in _BOTH] for n, of in enumerate(("q", "dq", "ddq"))]
        w[_LINKS] += [x.size() for x in along["defect"]]
        for c, at in zip((p.c, *p.masses.values()), slopes, strict=True):
            w[_LINKS] += np.einsum("kij,kj->i", _distance(_link_slopes(c, *wide), at), radii) * _UP
        others = w[_LINKS] * _UP
        products = np.einsum("kij,kj->i", np.abs(slopes[1:]).sum(axis=0), radii) * _UP if p.masses else np.zeros(2)
        for _ in range(4):  # products Δp δ, bounded by the tube or by the outputs
            w[_LINKS] = (others + products) * _UP
            products = np.minimum(products, (free + push @ (w * _UP))[18:].reshape(-1, 2).sum(axis=0) * _UP)
        w *= _UP
        reached = ((free + push @ w) * _UP)[:18]
        for j, friction in enumerate(frictions):
            if friction.plan == "monotone":
                pull = spread[j] + friction.needed.size() + friction.share[1] * friction.static[1]
                reached[14 + j] = pull / friction.inertia * _UP
        return w, reached, spread

    def _free(self, A: Any, b: Any, S: Any, D: Any, level: np.ndarray, slope: np.ndarray, h: float) -> tuple[Any, ...]:
        """Return (free, push, f): |S ξ + D w| <= free (n,) + push (n, 6) w̄ if |w| <= w̄; f(w̄) propagates the zonotope.

        a is `level` + `slope` s. Without w, S ξ is within h²/8 sup |S ξ̈| of a line. In f, w adds columns and a box.
        """
        m, G, size_A, size_b, SA = level.shape[1], self._G[:10], _above(A), _above(b), S * A
        E, quarter = _above(arb_mat((size_A * (h * _UP)).tolist()).exp()), (A * (arb(h) / 4)).exp()
        half = quarter * quarter
        phi, rows, feed, Sb, SAb = map(_floats, (half * half, S, D, S * b, SA * b))
        moved = np.einsum("ij,jk", phi[0], G)
        box = (phi[1] + _SMALL / 4 * np.abs(phi[0])) @ np.abs(G).sum(axis=1) * _UP
        if m:  # ∫ e^{A (h - t)} b (level + slope s(t)) dt, by the series in A
            power = b * arb_mat(np.hstack([level, slope]).tolist())
            total, later = power * 0, power * 0
            for i in range(26):
                total, later = total + power * (arb(h) / (i + 1)), later + power * (arb(2 * h) / (i + 2))
                power = A * power * (arb(h) / (i + 1))
            (held, held_left), (ramp, ramp_left) = _floats(total), _floats(total - later)
            moved[:, :m] += held[:, :m] + ramp[:, m:]
            missed = held_left + ramp_left + _SMALL * (np.abs(held) + np.abs(ramp)) + 3.0 * h * E @ _above(power)
            box += missed.sum(axis=1)
        spare = np.abs(level).sum(axis=1) + np.abs(slope).sum(axis=1)
        wide = [left + _SMALL * np.abs(middle) for middle, left in (feed, SAb, Sb)]
        first = _reach(rows, G, feed[0] @ (level - slope)) + wide[0] @ spare
        last = _reach(rows, moved, feed[0] @ (level + slope)) + wide[0] @ spare + _above(S) @ box
        bend = _reach(_floats(SA * A), G, SAb[0] @ (level - slope) + Sb[0] @ slope * (2.0 / h))
        bend += (wide[1] + 2.0 / h * wide[2]) @ spare
        grown = h * _above(SA) @ (E[:, :8] @ bend[:8])  # the first rows of S are ξ; δu is constant
        free = (np.maximum(first, last) + h * h / 8.0 * (bend + grown)) * _UP
        push = _above(D) + h * _above(S * b) + h * h / 2.0 * _above(SA * b) + h**3 / 6.0 * _above(SA * A) @ (E @ size_b)

        def after(w: np.ndarray) -> None:
            columns, missed = [], box.copy()
            for middle in (half * quarter, quarter):  # from the middles of both halves to the end
                for matrix, share in ((middle * b, h / 2.0), (middle * A * b, h * h / 16.0)):
                    made, left = _floats(matrix)
                    columns.append(share * made * w)
                    missed += share * (left + _SMALL * np.abs(made)) @ w
            missed += h**3 / 96.0 * size_A @ (size_A @ (E @ (size_b @ w)))
            new = np.vstack([np.hstack(columns), np.zeros((2, 4 * len(w)))])
            self._G[:10] = moved
            self._widen(missed[:8] * _UP, new[:, new.any(axis=0)])

        return free, push * _UP, after

    def _tip(self, t: float) -> float:
        """Return a bound on |p(q) - p_r| [m] at time t: linear part in `_TURNS` directions, and quadratic remainder."""
        q, length = [arb(x) for x in self._centre[2:4]], self._plant.length
        tip, J = _tip(q, length), _jacobian(lambda x: _tip(x, length), q)
        off = [a - b for a, b in zip(tip, _on_circle(arb(t), self._claim.duration), strict=True)]
        offset, middle = math.hypot(*map(_upper, off)) * _UP, np.array([float(x.mid()) for x in off])
        turns = np.pi * np.arange(_TURNS) / _TURNS
        units, links = np.stack([np.cos(turns), np.sin(turns)], axis=1), self._G[2:4]
        (jacobian, left), radius = _floats(arb_mat(J)), np.abs(links).sum(axis=1) * _UP
        reach = np.abs(np.einsum("ij,jk", units @ jacobian, links)).sum(axis=1) * _UP
        corner = _UP / math.cos(0.5 * math.pi / _TURNS)
        wide = min(offset + reach.max() * corner, (np.abs(units @ middle) + reach).max() * corner + _SMALL * offset)
        missed = ((left + 4.0 * _SMALL * np.abs(jacobian)) @ radius).sum() + 1e-15
        return float((wide + missed + self._bent(*radius)) * _UP)

    def _bent(self, one: float, two: float) -> float:
        """Return a bound [m] on |p(q) - p(q_y) - J δq|, δq = q - q_y, for |δq_1| <= `one` and |δq_2| <= `two`."""
        first, second = map(_upper, self._plant.length)
        return (first * one * one + second * (one + two) ** 2) / 2.0 * _UP

    def _between(self, tube: np.ndarray, along: Any, errors: list[_Course], h: float) -> float:
        """Return by how much [m] the tip error within a segment of h [s] may exceed its values at the segment's ends.

        J δq is within h²/8 Σ L (|δφ̈| + 2 |φ̇| |δφ̇| + (|φ̈| + φ̇²) |δφ|) of its chord, with links of length L at φ.
        `along` is the motion of the centre, `errors` its tip error; `tube` bounds the deviations from it.
        """
        total = 2.0 * math.hypot(*(course.line()[2] for course in errors)) + 2.0 * self._bent(*tube[_Q])
        moves = [[x.size() for x in along[name]] for name in ("dq", "ddq")] + [tube[rows] for rows in (_Q, _DQ, _LINK)]
        for n, length in enumerate(self._plant.length, 1):
            dq, ddq, r, dr, ddr = (float(sum(x[:n])) for x in moves)
            total += h * h / 8.0 * _upper(length) * (ddr + 2.0 * dq * dr + (ddq + dq * dq) * r) * _UP
        return total * _UP
