"""The requirements of a design."""

import dataclasses

import numpy as np

from fuzzyarm.common.checks import choice, real, texts, truth
from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import FORMS, GAINS, RATES
from fuzzyarm.fuzzy_policy.ts_model import DEFAULT_KEPT

__all__ = ["ALPHAS", "FIRST_ALPHA", "PAPER_WEIGHT", "Specification", "gamma_for"]

ALPHAS = (20.0, 15.0, 10.0, 7.0, 5.0, 3.0, 2.0)
"""Decay rates [1/s] that are tried in turn if no decay rate is specified."""

PAPER_WEIGHT = (1e-5, 1e-5, 1.0, 1.0)
"""Diagonal of the paper's Q, section 6.2."""

FIRST_ALPHA = 1.0
"""Decay rate [1/s] at which the search for the largest one begins."""


@dataclasses.dataclass(frozen=True)
class Specification:
    """The requirements of a design; whichever of `gamma` and `gain_bound` is None is minimised.

    Attributes:
        kept: premises kept as fuzzy rules.
        form: "consistent" or "paper" (theorems 1 and 2).
        alpha: decay rate [1/s], in `controller.RATES`; None for the largest one, which requires gamma and gain_bound.
        gamma: bound on the L2 gain, in `controller.GAINS`; [rad/(N m)] in the consistent form.
        gain_bound: bound on the feedback [N m/rad], in `controller.GAINS`: |K̃| <= bound T_1/U_1, see `_scaling`. So
            joint 1's position gain stays below the bound, and the other gains in proportion to their units.
        integral: whether to feed back the integral of the position error (Remark 2).
        common_multiplier: whether all dropped premises of A share one multiplier, as printed in Theorem 2; otherwise
            each has its own.
        feedforward: L of the paper's form as a fraction in [0, 1] of the consistent form's L. All fractions need the
            same feedback within 0.3 %, so the default is 0. None: the solver chooses L, which is then far too large.
        fastest_pole: upper bound β [1/s] on the decay rate, so that the real part of every pole of the frozen rigid
            loop lies between -β and -alpha; None for no bound. Consistent form only.

    Raises:
        TypeError: a value has the wrong type.
        ValueError: a value is out of range, or more than one of alpha, gamma and gain_bound is None.
    """

    kept: tuple[str, ...] = DEFAULT_KEPT
    form: str = "consistent"
    alpha: float | None = 20.0
    gamma: float | None = 2e-4
    gain_bound: float | None = None
    integral: bool = True
    common_multiplier: bool = False
    feedforward: float | None = 0.0
    fastest_pole: float | None = None

    def __post_init__(self) -> None:
        texts("kept", self.kept)
        choice("form", self.form, FORMS)
        truth("integral", self.integral)
        truth("common_multiplier", self.common_multiplier)
        if self.feedforward is not None:
            object.__setattr__(self, "feedforward", real("feedforward", self.feedforward, "", low=0.0, high=1.0))
        gain_unit = "rad/(N m)" if self.form == "consistent" else ""
        ranges = {
            "alpha": ("1/s", RATES),
            "gamma": (gain_unit, GAINS),
            "gain_bound": ("N m/rad", GAINS),
            "fastest_pole": ("1/s", RATES),
        }
        for name, (unit, (low, high)) in ranges.items():
            if getattr(self, name) is not None:
                object.__setattr__(self, name, real(name, getattr(self, name), unit, low=low, high=high))
        if self.fastest_pole is not None:
            if self.form != "consistent":
                raise ValueError("fastest_pole applies only to the consistent form: leave it out, or choose that form")
            if self.fastest_pole <= self.first_alpha:
                raise ValueError(
                    f"fastest_pole = {self.fastest_pole:g} 1/s is out of range; allowed: above alpha = "
                    f"{self.first_alpha:g} 1/s"
                )
        missing = [name for name in ("alpha", "gamma", "gain_bound") if getattr(self, name) is None]
        if len(missing) > 1:
            raise ValueError(
                f"{', '.join(missing[:-1])} and {missing[-1]} are left open, but only one of alpha, gamma, gain_bound "
                "can be optimised: give numbers for the others"
            )

    @property
    def first_alpha(self) -> float:
        """The specified decay rate [1/s], or the one at which the search for the largest begins."""
        return FIRST_ALPHA if self.alpha is None else self.alpha

    @property
    def objective(self) -> str:
        """The objective, in words."""
        if self.alpha is None:
            return "largest decay rate"
        if self.gamma is None:
            return "smallest L2 gain"
        return "smallest bound on the scaled gains" if self.gain_bound is None else "any point within the bounds"


def gamma_for(arm: ArmParameters, alpha: float = ALPHAS[0], gamma: float = 2e-4) -> float:
    """Return the γ [rad/(N m)] that is as strict for an arm as `gamma` is for Table 1 at the first of `ALPHAS`.

    It is γ I₁/I · max(1, 20/α), to two significant digits, where I is the mean of the joints' largest inertias with
    their rotors and I₁ is that of Table 1; α is in 1/s.
    """
    factor = _inertia(ArmParameters()) / _inertia(arm) * max(1.0, ALPHAS[0] / alpha)
    return float(f"{gamma * factor:.2g}")


def _inertia(arm: ArmParameters) -> float:
    constants = arm_constants(arm)
    return float(np.mean(np.array(arm.motor_inertia) + np.array([constants.c1, constants.c3])))
