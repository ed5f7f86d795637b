"""The controller file: gains, robot, specification and everything a proof needs, as JSON.

Synthesis writes it, the policy reads it, the certificate checks it. Every float is stored exactly, in C99
hexadecimal. Loading a file executes nothing from it.
"""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.files import write_atomically
from fuzzyarm.fuzzy_policy.ts_model import TSModel

SCHEMA = "fuzzyarm-controller/1"
MAX_BYTES = 64 * 1024 * 1024  # far above the largest model's file; a bigger one is not ours


class ControllerFileError(ValueError):
    """A controller file is damaged, foreign or made for another robot; the message says which."""


@dataclasses.dataclass(frozen=True)
class Controller:
    """A parallel distributed compensation u = K_hv e + H_hv x_I + L_hv r with what proves it (`inequality`).

    N vertices of A, N_e of E, n = 6 states with the integral and 4 without, p = N (N + 1) / 2 pairs i <= j,
    m dropped premises. SI units throughout.

    Attributes:
        model: the T-S model, which holds the robot and the kept premises.
        integral: whether x_I = ∫ (q - q_d) dt is fed back.
        alpha: guaranteed decay rate [1/s].
        gamma: guaranteed L2 gain from d [N m] to the position error [rad], in rad/(N m).
        gains: K̄ = [K H], (N, N_e, 2, n).
        P: (n, n) of V = ēᵀ P⁻¹ ē.
        Q: (p, n, n) slack.
        X: (p, n, n) slack.
        tau: (p, N_e, m) multipliers.
        origin: how it was made: form, objective, solver, versions.
    """

    model: TSModel
    integral: bool
    alpha: float
    gamma: float
    gains: np.ndarray
    P: np.ndarray
    Q: np.ndarray
    X: np.ndarray
    tau: np.ndarray
    origin: dict[str, str]

    def __post_init__(self) -> None:
        """Check shapes and values."""
        for name in ("alpha", "gamma"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ControllerFileError(f"{name} = {value} is out of range; allowed: (0, inf)")
        n, N, N_e = (6 if self.integral else 4), len(self.model.A_vertices), len(self.model.E_vertices)
        pairs, m = N * (N + 1) // 2, len(self.model.uncertainties)
        shapes = {
            "gains": (N, N_e, 2, n),
            "P": (n, n),
            "Q": (pairs, n, n),
            "X": (pairs, n, n),
            "tau": (pairs, N_e, m),
        }
        for name, shape in shapes.items():
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise ControllerFileError(f"{name} must hold finite numbers of shape {shape}; it has {array.shape}")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if not np.array_equal(self.P, self.P.T):
            raise ControllerFileError("P must be symmetric")

    def save(self, path: str | Path) -> None:
        """Write the controller file, whole or not at all."""
        write_atomically(Path(path), self.to_json())

    def to_json(self) -> str:
        """Return the text of the controller file."""
        document = {
            "schema": SCHEMA,
            "robot": self.model.parameters.to_dict(),
            "kept": list(self.model.kept),
            "bounds": self.model.bounds,
            "integral": self.integral,
            "alpha": self.alpha,
            "gamma": self.gamma,
            "origin": self.origin,
            **{name: getattr(self, name) for name in ("gains", "P", "Q", "X", "tau")},
        }
        return json.dumps(_encode(document), indent=1) + "\n"

    @classmethod
    def load(cls, path: str | Path) -> Controller:
        """Read a controller file.

        Raises:
            ControllerFileError: not a controller file, of another version, damaged, or inconsistent.
            OSError: the file cannot be read.
        """
        path = Path(path)
        if path.stat().st_size > MAX_BYTES:
            raise ControllerFileError(f"{path} is larger than {MAX_BYTES} bytes: not a controller file")
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise ControllerFileError(f"{path} is not JSON: {str(error)[:80]}") from None
        try:
            return cls._from_document(document)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            problem = f"field {error} is missing" if isinstance(error, KeyError) else str(error)
            raise ControllerFileError(f"{path}: {problem}") from None

    @classmethod
    def _from_document(cls, document: Any) -> Controller:
        if not isinstance(document, dict) or document.get("schema") != SCHEMA:
            found = document.get("schema") if isinstance(document, dict) else None
            raise ControllerFileError(f"schema is {found!r}, this version reads {SCHEMA!r}")
        if not isinstance(document["integral"], bool):
            raise ControllerFileError("integral must be true or false")
        model = TSModel(ArmParameters.from_dict(_decode(document["robot"])), tuple(document["kept"]))
        if not np.array_equal(np.array(_decode(document["bounds"])), model.bounds):
            raise ControllerFileError("the premise bounds do not belong to the robot parameters: the file was changed")
        arrays = {name: np.array(_decode(document[name])) for name in ("gains", "P", "Q", "X", "tau")}
        # A model without dropped premises has no multipliers: JSON keeps no shape of an empty array.
        arrays["tau"] = arrays["tau"].reshape(len(arrays["Q"]), len(model.E_vertices), -1)
        origin = {str(key): str(value) for key, value in document["origin"].items()}
        return cls(
            model=model,
            integral=document["integral"],
            alpha=_decode(document["alpha"]),
            gamma=_decode(document["gamma"]),
            origin=origin,
            **arrays,
        )


def _encode(value: Any) -> Any:
    """Return `value` with every float in exact hexadecimal and arrays as nested lists."""
    if isinstance(value, np.ndarray):
        return _encode(value.tolist())
    if isinstance(value, float):
        return value.hex()
    if isinstance(value, dict):
        return {key: _encode(entry) for key, entry in value.items()}
    return [_encode(entry) for entry in value] if isinstance(value, list) else value


def _decode(value: Any) -> Any:
    """Return nested lists or mappings with every hexadecimal string as a float; anything else raises ValueError."""
    if isinstance(value, str):
        return float.fromhex(value)
    if isinstance(value, list):
        return [_decode(entry) for entry in value]
    if isinstance(value, dict):
        return {key: _decode(entry) for key, entry in value.items()}
    raise ControllerFileError(f"{str(value)[:40]!r} is not an exact hexadecimal float")
