"""What a proven controller file promises, in words; every number is rounded so that it holds."""

from __future__ import annotations

import math

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.proof.definiteness import largest_growth

__all__ = ["NOT_COVERED", "decay_words", "statement"]

# What every certificate says of its limits.
NOT_COVERED = (
    "Not covered: the elastic joints, sampling and hold, measurement noise, torque limits, and any motion that leaves "
    "the box; those are measured, not proven."
)
ERROR = "the tracking error x = (e, de/dt, integral of e if it is fed back) in rad and s"
_OF_THE_TIP = (
    " Of the tip of the elastic, sampled arm a bound can be proven along one motion and for a set of plants: fuzzyarm "
    "prove."
)


def statement(controller: Controller) -> str:
    """Return what the certificate proves and what it does not, with the numbers of this controller."""
    p, model = controller.model.parameters, controller.model
    # A smaller box, decay rate or strip than proven is proven as well, and so is a larger gain.
    angles, speeds = (", ".join(at_least(x, 6) for x in limit) for limit in (p.joint_limit, p.velocity_limit))
    alpha, gamma, strip = at_least(controller.alpha, 6), at_most(controller.gamma, 3), ""
    box = (
        f"For the rigid arm in continuous time, as long as it stays in the box |q| <= ({angles}) rad, |dq/dt| <= "
        f"({speeds}) rad/s, and for every twice differentiable reference: "
    )
    if controller.form == "paper":
        both = decay_words(alpha, largest_growth(controller.P, len(controller.P)), x="x = (error, x_r)")
        claim = (
            "with V over error and reference model, dV/dt + e'Qe - gamma^2 w'w + 2 alpha V < 0, w = (d, r): where w "
            f"vanishes {both}, and from zero initial conditions the L2 gain from w to Q^(1/2) e is at most {gamma}. "
            "d is friction, tip forces and payload as joint torques. "
        )
        return box + claim + NOT_COVERED + _OF_THE_TIP
    dropped = [name for u in model.uncertainties for name in u.premises]
    residual = f", and the feedforward residual of the dropped premises {', '.join(dropped)}" if dropped else ""
    if controller.fastest_pole is not None:
        beta = at_most(controller.fastest_pole, 6)
        strip = (
            f"; the root of V = x'P^-1 x decays no faster than exp(-{beta} t), so that the poles of the loop frozen at "
            f"any such state have real parts between -{beta} and -{alpha} 1/s"
        )
    growth = (largest_growth(controller.P, size) for size in (len(controller.P), JOINTS))
    claim = (
        f"without disturbance {decay_words(alpha, *growth)}{strip}; and from zero error the L2 gain from the "
        f"disturbance torque d to the position error is at most {gamma} rad/(N m). d "
        f"holds friction, tip forces and payload as joint torques{residual}. "
    )
    return box + claim + NOT_COVERED + _OF_THE_TIP


def decay_words(alpha: str, *growth: float, x: str = ERROR) -> str:
    """Return how x decays, given α and the bounds c² of `largest_growth` of all of it and, if given, of e."""
    c = [at_most(math.sqrt(one) * (1.0 + 1e-12), 4) if math.isfinite(one) else "C" for one in growth]
    words = f"{x} decays at least as exp(-{alpha} t) up to a constant, |x(t)| <= {c[0]} exp(-{alpha} t) |x(0)|"
    return words + f", and |e(t)| <= {c[-1]} exp(-{alpha} t) |e(0)| where at first only e is not zero" * (len(c) > 1)
