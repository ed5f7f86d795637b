"""The controller file: gains, robot, specification and all data for the proof, as JSON.

The synthesis writes it, the policy reads it, and the certificate proves its claims.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np

from fuzzyarm.common.checks import choice, instance, real, truth
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.signed_files import SignedController, checked_fields, decoded, encoded
from fuzzyarm.fuzzy_policy.ts_model import ERROR_STATES, PLANT_STATES, VELOCITY, TSModel

__all__ = ["FORMS", "GAINS", "POLE_ARRAYS", "RATES", "Controller", "consistent_feedforward"]

_SCHEMA = "fuzzyarm-controller/1"
FORMS = ("consistent", "paper")  # forms of Theorem 2: with a consistent feedforward, and as printed in the paper
_STATED = ("form", "integral", "common_multiplier")
_ARRAYS = ("weight", "gains", "feedforward", "P", "Q", "X", "tau")
POLE_ARRAYS = ("pole_Q", "pole_X", "pole_tau")  # arrays of the bound on the fastest pole
_OPTIONAL = ("fastest_pole", *POLE_ARRAYS)  # fields that the file omits if they are None
# Far wider than any useful range; products with an arm's parameters stay finite.
RATES = (1e-6, 1e6)  # [1/s], alpha and fastest_pole
GAINS = (1e-30, 1e30)  # gamma, in the units of either form
# Types in the file, where numbers are hexadecimal strings and arrays nested lists.
_FIELDS = {
    "robot": dict[str, Any], "kept": tuple[str, ...], "bounds": Any, "form": str, "integral": bool,
    "common_multiplier": bool, "alpha": Any, "gamma": Any, "origin": dict[str, str], **dict.fromkeys(_ARRAYS, Any),
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Controller(SignedController):
    """A law u = K_hv e + H_hv x_I + L_hv r, with gains weighted by memberships h and v, and the matrices of its proof.

    Sizes: N vertices of A and N_e of E, n_e = 6 error states with the integral and 4 without, p = N (N + 1) / 2 pairs
    i <= j, m multipliers; n = n_e, in the paper's form n_e + 4 with the reference's states x_r. SI units throughout.
    """

    model: TSModel  # contains the robot and the kept premises
    form: str  # "consistent" or "paper" (Theorem 2, or 1 if all premises are kept), see `proof._theorems`
    integral: bool  # whether x_I = ∫ (q - q_d) dt is fed back
    alpha: float  # guaranteed decay rate [1/s], in `RATES`
    # guaranteed L2 gain, in `GAINS`; consistent form: from d [N m] to the position error [rad]; paper's form: from
    # (d, r) to Q^(1/2) e
    gamma: float
    weight: np.ndarray | None  # diagonal (4,) of the paper's Q; None in the consistent form: z is the position error
    common_multiplier: bool  # whether the dropped premises of A share one multiplier, as printed in Theorem 2
    gains: np.ndarray  # K̄ = [K H], (N, N_e, 2, n_e)
    # L, (N, N_e, 2, 6), on r = (q_d, q̇_d, q̈_d); None in the consistent form, where L follows from the model
    feedforward: np.ndarray | None
    P: np.ndarray  # (n, n) of V = xᵀ P⁻¹ x, block diagonal over error and x_r
    Q: np.ndarray  # (p, n, n) slack
    X: np.ndarray  # (p, n, n) slack
    tau: np.ndarray  # (p, N_e, m) multipliers
    origin: dict[str, str]  # how it was made: objective, solver, versions
    # β [1/s], above alpha and in `RATES`: V falls no faster than exp(-2βt). Without this claim, β and the slack and
    # multipliers of the claim below are None. Consistent form only.
    fastest_pole: float | None = None
    pole_Q: np.ndarray | None = None
    pole_X: np.ndarray | None = None
    pole_tau: np.ndarray | None = None

    def _check(self) -> None:
        instance("model", self.model, TSModel)
        for text in itertools.chain(*instance("origin", self.origin, dict).items()):
            instance("origin: entry", text, str)
        choice("form", self.form, FORMS)
        truth("integral", self.integral)
        truth("common_multiplier", self.common_multiplier)
        alpha = real("alpha", self.alpha, "1/s", low=RATES[0], high=RATES[1])
        self._take(alpha=alpha, gamma=real("gamma", self.gamma, low=GAINS[0], high=GAINS[1]))
        if self.fastest_pole is not None:
            self._take(fastest_pole=real("fastest_pole", self.fastest_pole, "1/s", above=alpha, high=RATES[1]))
        for name, shape in self._shapes().items():
            if (shape is None) != (getattr(self, name) is None):
                of_pole = name in POLE_ARRAYS and self.form == "consistent"
                other = f"fastest_pole = {self.fastest_pole}" if of_pole else f"the {self.form} form"
                raise ValueError(f"{name} must {'not ' * (shape is None)}be given with {other}")
            if shape is not None:
                self._take(**{name: self._array(name, shape)})
        if self.fastest_pole is not None and self.form != "consistent":
            raise ValueError(f"fastest_pole must not be given with the {self.form} form")
        n_e = self.gains.shape[-1]
        if not np.array_equal(self.P, self.P.T) or self.P[:n_e, n_e:].any():
            raise ValueError(f"P must be symmetric, and block diagonal with a first block of {n_e} x {n_e}")
        if self.weight is not None and self.weight.min() <= 0.0:
            raise ValueError(f"weight = {self.weight.tolist()} must contain only numbers above 0")

    def _shapes(self) -> dict[str, tuple[int, ...] | None]:
        """Return the shape of each array by name; None for an array that this controller lacks."""
        paper, pole = self.form == "paper", self.fastest_pole is not None and self.form == "consistent"
        n_e, reference_states = ERROR_STATES if self.integral else PLANT_STATES, PLANT_STATES if paper else 0
        N, N_e, m = len(self.model.A_vertices), len(self.model.E_vertices), len(self.model.uncertainties)
        n, pairs = n_e + reference_states, N * (N + 1) // 2
        if self.common_multiplier:
            m = len({u.on for u in self.model.uncertainties})
        slack = {"Q": (pairs, n, n), "X": (pairs, n, n), "tau": (pairs, N_e, m)}
        return {
            "weight": (PLANT_STATES,) if paper else None,
            "gains": (N, N_e, JOINTS, n_e),
            "feedforward": (N, N_e, JOINTS, 3 * JOINTS) if paper else None,
            "P": (n, n),
            **slack,
            **{f"pole_{name}": shape if pole else None for name, shape in slack.items()},
        }

    @property
    def feedforward_gains(self) -> np.ndarray:
        """Gains L (N, N_e, 2, 6) on (q_d, q̇_d, q̈_d): stored, or computed in the consistent form."""
        return consistent_feedforward(self.model) if self.feedforward is None else self.feedforward

    @property
    def _encoded(self) -> dict[str, Any]:
        document = {
            "schema": _SCHEMA,
            "robot": self.model.parameters.to_dict(),
            "kept": list(self.model.kept),
            "bounds": self.model.bounds,
            **{name: getattr(self, name) for name in (*_STATED, "alpha", "gamma", "origin", *_ARRAYS)},
            **{name: getattr(self, name) for name in _OPTIONAL if getattr(self, name) is not None},
        }
        content: dict[str, Any] = encoded(document)
        return content

    @classmethod
    def from_document(cls, content: Any) -> Controller:
        """Return the controller in a file's parsed JSON; ValueError if it is of another form or damaged."""
        document = checked_fields(content, _SCHEMA, _FIELDS, _OPTIONAL)
        model = TSModel(ArmParameters.from_dict(decoded(document["robot"])), document["kept"])
        if not np.array_equal(np.array(decoded(document["bounds"])), model.bounds):
            raise ValueError(
                "the premise bounds are not those of the robot: the file was changed; design the controller again"
            )
        arrays: dict[str, Any] = {
            name: None if document[name] is None else np.array(decoded(document[name]))
            for name in (*_ARRAYS, *POLE_ARRAYS)
            if name in document
        }
        # Without dropped premises there are no multipliers, and JSON does not store the shape of an empty array.
        if arrays["tau"] is not None and arrays["tau"].size == 0:
            arrays["tau"] = np.zeros((len(document["Q"]), len(model.E_vertices), 0))
        numbers = {name: decoded(document[name]) for name in ("alpha", "gamma", "fastest_pole") if name in document}
        asked = {name: document[name] for name in (*_STATED, "origin")}
        return cls(model=model, **asked, **numbers, **arrays)


def consistent_feedforward(model: TSModel) -> np.ndarray:
    """Return the feedforward gains L (N, N_e, 2, 6) of the consistent form, in SI units.

    L_ik has rows 3 and 4 of -A_pi, then those of E_pk in its columns 3 and 4.
    """
    pairs = [[(-A[VELOCITY], E[VELOCITY, VELOCITY]) for E in model.E_vertices] for A in model.A_vertices]
    return np.array([[np.hstack(pair) for pair in row] for row in pairs])
