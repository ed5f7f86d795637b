"""What each policy declares: the asymmetries by which comparisons of control and learning go wrong.

A policy says what its numbers were chosen for and on what, what it knows of the arm beforehand, what it sees, and what
it remembers from one sample to the next. Its certificate stands with the results.
"""

from __future__ import annotations

from typing import NamedTuple

from fuzzyarm.policies.registry import TIP
from fuzzyarm.policies.spec import resolve

__all__ = ["HEADINGS", "Declared", "declared"]

HEADINGS = ("objective", "tuned on", "knows of the arm", "sees", "remembers")
"""Of the columns, one for each field of `Declared`."""


class Declared(NamedTuple):
    """The declaration of a policy, in words.

    Attributes:
        objective: what its numbers make small.
        tuned_on: the motions, plants and loads on which they were chosen.
        knows: what it is told of the arm.
        sees: what its observation holds.
        remembers: what it keeps from one sample to the next.
    """

    objective: str
    tuned_on: str
    knows: str
    sees: str
    remembers: str


_SEES = "motor angles and velocities; reference with two derivatives, no preview"
_INTEGRAL = "integral of the joint error"
_RIGID, _ELASTIC = "rigid model, no friction", "elastic model with friction"
_FUZZY = Declared(
    "smallest gains at a proven bound; the bound by motor error and margins", "nominal case", _RIGID, _SEES, _INTEGRAL
)
_REWARD = "discounted reward: logarithm of the tip error, effort"
_HAND = "; settings by hand on Cases 1 to 3"
_RANDOM = "random plants, forces, payloads and references" + _HAND
_LEARNED = "two errors and actions, leaky integral of the error"
_NAMED = {
    **{f"fuzzy-{rules}": _FUZZY for rules in (32, 16, 8, 4, 2, 1)},
    "fuzzy-4-sampled": Declared(
        "deviation of the tip by any friction on the sampled elastic arm, within margins and at a proven bound",
        "nominal case, stiffness ± 10 %",
        _RIGID,
        _SEES,
        _INTEGRAL,
    ),
    "computed-torque": Declared("smallest motor error within margins", "nominal case", _RIGID, _SEES, _INTEGRAL),
    "elastic-observer": Declared(
        "mean rms tip error, and noise in Case 1, within margins",
        "random plants, constant forces and payloads on the paper's circle",
        _ELASTIC,
        _SEES,
        "estimate of state and load",
    ),
    "adaptive-observer": Declared(
        "mean and worst largest tip error, and noise in Case 1",
        "random plants, forces, payloads, delays, noise and references",
        f"{_ELASTIC}, as a first guess; how far it may be off",
        _SEES,
        "estimate of state, load, constants and lateness, with covariance",
    ),
    "learned-observer": Declared(
        "distance to the torque of a teacher who knows plant, load and lateness",
        "random plants, forces, payloads, delays, noise and references",
        f"{_ELASTIC}, as a first guess; how far it may be off",
        _SEES,
        "what elastic-observer and adaptive-observer remember; the state of a network",
    ),
    "ppo-nominal": Declared(_REWARD, "nominal case" + _HAND, "nothing", _SEES, _LEARNED),
    "ppo-robust": Declared(_REWARD, _RANDOM, "nothing", _SEES, _LEARNED),
    "ppo-residual": Declared(_REWARD, _RANDOM, "what fuzzy-4-tip knows", _SEES, f"as fuzzy-4-tip; {_LEARNED}"),
}


def declared(name: str) -> Declared | None:
    """Return what a policy declares, by its name; None of a policy that comes without a declaration."""
    spec = resolve(name)
    own = _NAMED.get(name.removesuffix(TIP)) if spec.named else None
    if own is None or not spec.tip:
        return own
    return own._replace(knows=_ELASTIC, remembers=f"{own.remembers}; three samples of the reference")
