"""A controller of the form "semidefinite", for a serial robot with any number of joints, and its file.

The law for inertia M, Coriolis matrix C, viscous friction f_v, gravity g and errors e = q - q_d, x_I = ∫ e dt is

    u = M̄(q) q̈_d + C(q, q̇) q̇ + f_v q̇ + g(q) - M̂(q) (k_p e + k_d ė + k_i x_I),      M̂(q) = Σ_r h_r(q) S_r,

with M̄ = M + R and reflected rotor inertias R: a rigid arm with disturbance torques d then follows M̄(q) ë = -M̂(q)
(k_p e + k_d ė + k_i x_I) + d. Rule r has the gains k ⊗ S_r and the weight h_r, a product with one factor for each kept
premise z_l, (1 - z_l)/2 or (1 + z_l)/2; the first premise changes fastest with r.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import choice, instance, real, whole
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.controller import GAINS, RATES, Controller
from fuzzyarm.fuzzy_policy.signed_files import SignedController, checked_fields, controller_in, decoded, encoded
from fuzzyarm.fuzzy_policy.ts_model import SCALAR_STATES, rule_products

__all__ = [
    "FORM", "FUNCTIONS", "MOST_PREMISES", "TWIST", "Premise", "ScheduledController", "load_controller",
    "rule_weights", "speeds_of",
]  # fmt: skip

FORM = "semidefinite"
_SCHEMA = "fuzzyarm-semidefinite/1"
FUNCTIONS = ("cos q", "sin q", "cos 2q", "sin 2q")
MOST_PREMISES = 4
TWIST = 6  # entries of a base's twist, linear before angular velocity
_ARRAYS = ("inertia", "rates", "distal_low", "distal_high", "feedback", "lyapunov")
_NUMBERS = ("kappa", "floor", "alpha", "gamma", "fastest_pole")


@dataclasses.dataclass(frozen=True)
class Premise:
    """A premise of a controller: the cosine or sine of the angle of one joint, or of twice that angle."""

    joint: int  # index of the joint in the robot, from 0; joint 0 turns the whole robot and changes no inertia
    function: str  # one of `FUNCTIONS`

    def __post_init__(self) -> None:
        whole("joint", self.joint, low=1)
        choice("function", self.function, FUNCTIONS)

    @property
    def place(self) -> int:
        """Index of the function in (1, cos q, sin q, cos 2q, sin 2q)."""
        return 1 + FUNCTIONS.index(self.function)

    @property
    def name(self) -> str:
        """The name of the premise: its function, then the number of its joint, from 1, as in "cos 2q3"."""
        return f"{self.function}{self.joint + 1}"

    @property
    def turns(self) -> int:
        """Number of periods of the premise in one turn of its joint."""
        return 2 if "2" in self.function else 1

    def at(self, q: np.ndarray) -> np.ndarray:
        """Return the premise's value (...) at angles (..., n) [rad]."""
        angle = self.turns * q[..., self.joint]
        return np.asarray(np.cos(angle) if self.function.startswith("cos") else np.sin(angle))


# Types in the file, where numbers are hexadecimal strings, except those of the robot, whose JSON is exact.
_FIELDS = {
    "form": str, "robot": Robot, "robot_digest": str, "premises": tuple[Premise, ...], "split": int,
    "origin": dict[str, str], **dict.fromkeys((*_ARRAYS, *_NUMBERS), Any),
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class ScheduledController(SignedController):
    """Gains of the law in the module's docstring, and the data of its proof; n joints, N = 2^premises rules."""

    robot: Robot  # the robot it was designed for
    premises: tuple[Premise, ...]  # the kept premises, of different joints up to `split`
    inertia: np.ndarray  # S_r, (N, n, n) [kg m²]
    kappa: float  # κ, M̂ < M̄ < κ M̂ in the box
    floor: float  # σ [kg m²], σ I < M̂
    rates: np.ndarray  # μ_k [1/rad], (premises,): -2 μ_k M̂ < ∂M̂/∂q_k < 2 μ_k M̂
    split: int  # a, number of the link behind which the chain is split for the proof, n for no split
    distal_low: np.ndarray  # D_low, (6 + n - a, 6 + n - a), see `proof.inertia_bounds`; (0, 0) without a split
    distal_high: np.ndarray  # D_high, likewise
    feedback: np.ndarray  # k = (k_p [1/s²], k_d [1/s], k_i [1/s³])
    lyapunov: np.ndarray  # X (3, 3), see `proof.scheduled_certificate`
    alpha: float  # guaranteed decay rate [1/s]
    gamma: float  # guaranteed L2 gain [s²], from d in the norm (dᵀ M̂⁻¹ d)^½ to e in the norm (eᵀ M̂ e)^½
    fastest_pole: float  # β [1/s]; no pole of the loop frozen at a state of the box has a modulus above β
    origin: dict[str, str]  # how it was made: objective, versions

    def _check(self) -> None:
        n = len(instance("robot", self.robot, Robot))
        whole("split", self.split, low=1, high=n)
        joints = [instance("premises", premise, Premise).joint for premise in self.premises]
        if len(joints) > MOST_PREMISES or len(set(joints)) < len(joints) or any(j >= self.split for j in joints):
            raise ValueError(
                f"premises belong to the joints {[joint + 1 for joint in joints]}; allowed: at most {MOST_PREMISES} "
                f"premises, each for a different joint from 2 to split = {self.split}"
            )
        alpha = real("alpha", self.alpha, "1/s", low=RATES[0], high=RATES[1])
        values: dict[str, Any] = {
            "alpha": alpha,
            "kappa": real("kappa", self.kappa, above=1.0, high=1.0 / GAINS[0]),
            "floor": real("floor", self.floor, "kg m^2", above=0.0),
            "gamma": real("gamma", self.gamma, "s^2", low=GAINS[0], high=GAINS[1]),
            "fastest_pole": real("fastest_pole", self.fastest_pole, "1/s", above=alpha, high=RATES[1]),
        }
        distal = TWIST + n - self.split if self.split < n else 0
        shapes = {
            "inertia": (2 ** len(joints), n, n),
            "rates": (len(joints),),
            "distal_low": (distal, distal),
            "distal_high": (distal, distal),
            "feedback": (SCALAR_STATES,),
            "lyapunov": (SCALAR_STATES, SCALAR_STATES),
        }
        for name, shape in shapes.items():
            array = self._array(name, shape)
            if name not in ("rates", "feedback") and not np.array_equal(array, np.swapaxes(array, -1, -2)):
                raise ValueError(f"{name} is not symmetric")
            values[name] = array
        if len(joints) and values["rates"].min() < 0.0:
            raise ValueError(f"rates = {values['rates'].tolist()} 1/rad is out of range; allowed: each 0 or more")
        self._take(**values)

    @property
    def rules(self) -> int:
        """Number of rules, N."""
        return len(self.inertia)

    @property
    def speeds(self) -> np.ndarray:
        """Velocity limits (premises,) [rad/s] of the joints on which the premises depend, see `speeds_of`."""
        return speeds_of(self.robot, self.premises)

    def inertia_at(self, q: np.ndarray) -> np.ndarray:
        """Return the weighted inertia M̂ (..., n, n) [kg m²] at angles (..., n) [rad]."""
        return np.asarray(np.tensordot(rule_weights(self.premises, q), self.inertia, axes=1))

    @functools.cached_property
    def _encoded(self) -> dict[str, Any]:
        numbers = {name: getattr(self, name) for name in (*_ARRAYS, *_NUMBERS)}
        return {
            "schema": _SCHEMA,
            "form": FORM,
            "robot": dataclasses.asdict(self.robot),
            "robot_digest": self.robot.digest,
            "premises": [dataclasses.asdict(premise) for premise in self.premises],
            "split": self.split,
            "origin": self.origin,
            **encoded(numbers),
        }

    @classmethod
    def from_document(cls, content: Any) -> ScheduledController:
        """Return the controller in a file's parsed JSON; ValueError if it is of another form or damaged."""
        document = checked_fields(content, _SCHEMA, _FIELDS)
        robot = document["robot"]
        choice("form", document["form"], (FORM,))
        if document["robot_digest"] != robot.digest:
            raise ValueError(
                "the robot's digest does not match: the file was changed; restore it, or design a new controller"
            )
        arrays: dict[str, Any] = {name: np.array(decoded(document[name]), dtype=np.float64) for name in _ARRAYS}
        if document["split"] == len(robot):  # JSON does not store the shape of an empty array
            arrays |= {name: np.zeros((0, 0)) for name in ("distal_low", "distal_high")}
        numbers = {name: decoded(document[name]) for name in _NUMBERS}
        return cls(**{name: document[name] for name in ("robot", "premises", "split", "origin")}, **arrays, **numbers)


def load_controller(path: str | Path) -> Controller | ScheduledController:
    """Read a controller file of any form; ControllerFileError if it is damaged, OSError if it is unreadable."""

    def build(content: Any) -> Controller | ScheduledController:
        form = ScheduledController if isinstance(content, dict) and content.get("schema") == _SCHEMA else Controller
        return form.from_document(content)

    return controller_in(path, build)


def speeds_of(robot: Robot, premises: Sequence[Premise]) -> np.ndarray:
    """Return the velocity limits (premises,) [rad/s] of the premises' joints, which bound the box of the proof."""
    return np.array([robot.joints[premise.joint].velocity_limit for premise in premises])


def rule_weights(premises: Sequence[Premise], q: np.ndarray) -> np.ndarray:
    """Return the weights h (..., 2^premises) of the rules at angles (..., n) [rad]: >= 0, with the sum 1."""
    return rule_products((0.5 * (1.0 + premise.at(q)) for premise in premises), q.shape[:-1])
