"""What each policy declares: the asymmetries by which comparisons of control and learning go wrong.

A policy says what its numbers were chosen for and on what, what it knows of the arm beforehand, what it sees, and what
it remembers from one sample to the next. Its certificate stands with the results. Policies of the package declare it by
their name, files and folders by what is in them (`declared_files`), and the user's own code by an attribute
``declared`` (`user_code`).
"""

from __future__ import annotations

from typing import Any

from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.policies.declaration import ELASTIC, HEADINGS, INTEGRAL, LEARNED_OBSERVER, RIGID, SEES, Declared, stated
from fuzzyarm.policies.registry import TIP, Kind
from fuzzyarm.policies.spec import PolicySpec, resolve

__all__ = ["HEADINGS", "Declared", "declared", "declared_by_name", "stated"]

_FUZZY = Declared(
    "smallest gains at a proven bound; the bound by motor error and margins", "nominal case", RIGID, SEES, INTEGRAL
)
_REWARD = "discounted reward: logarithm of the tip error, effort"
_HAND = "; settings by hand on Cases 1 to 3"
_RANDOM = "random plants, forces, payloads and references" + _HAND
_LEARNED = "two errors and actions, leaky integral of the error"
_ADAPTIVE = "adaptive-observer"
_NAMED = {
    **{f"fuzzy-{rules}": _FUZZY for rules in (32, 16, 8, 4, 2, 1)},
    "fuzzy-4-sampled": Declared(
        "deviation of the tip by any friction on the sampled elastic arm, within margins and at a proven bound",
        "nominal case, stiffness ± 10 %",
        RIGID,
        SEES,
        INTEGRAL,
    ),
    "computed-torque": Declared("smallest motor error within margins", "nominal case", RIGID, SEES, INTEGRAL),
    "elastic-observer": Declared(
        "mean rms tip error, and noise in Case 1, within margins",
        "random plants, constant forces and payloads on the paper's circle",
        ELASTIC,
        SEES,
        "estimate of state and load",
    ),
    _ADAPTIVE: Declared(
        "mean and worst largest tip error, and noise in Case 1",
        "random plants, forces, payloads, delays, noise and references; the paper's circle without load",
        f"{ELASTIC}, as a first guess; how far it may be off",
        SEES,
        "estimate of state, load, constants and lateness, with covariance",
    ),
    "learned-observer": LEARNED_OBSERVER,
    "ppo-nominal": Declared(_REWARD, "nominal case" + _HAND, "nothing", SEES, _LEARNED),
    "ppo-robust": Declared(f"{_REWARD}; smooth actions", _RANDOM, "nothing", SEES, _LEARNED),
    "ppo-residual": Declared(_REWARD, _RANDOM, "what fuzzy-4-tip knows", SEES, f"as fuzzy-4-tip; {_LEARNED}"),
}


# On a robot the laws take their numbers from those of Table 1: objective and tuned on; {} is the robot.
_POSTURES = "random postures of {}; all else of the arm of Table 1"
_ON_ROBOTS = {
    "computed-torque": ("bandwidth of Table 1, lowered until there are margins", _POSTURES),
    "elastic-observer": ("weights of Table 1, softened until there are margins", _POSTURES),
    _ADAPTIVE: (
        "weights of Table 1, softened until the regulator is stable",
        f"{_POSTURES}; two numbers for all robots on passes of the UR5 in Case 2",
    ),
}


def declared(name: str | PolicySpec, policy: Any = None, passes: int = 1, arm: AnyArm | None = None) -> Declared | None:
    """Return what a policy declares; None of one that comes without a declaration.

    Args:
        name: its name, or what that refers to.
        policy: the policy as it was loaded; needed of the user's own code alone.
        passes: over the same path; with several, a policy that learns from them remembers those before.
        arm: for which it was loaded; None: that of Table 1. Files and folders say for which arm they are.

    Raises:
        ValueError: the policy's file or folder is damaged.
        OSError: it cannot be read.
    """
    spec = name if isinstance(name, PolicySpec) else resolve(name)
    own = _own(spec, policy)
    if own is None:
        return None
    if spec.named and arm is not None:
        own = _on(arm, spec.name.removesuffix(TIP), own)
    if spec.tip:
        own = own._replace(knows=ELASTIC, remembers=f"{own.remembers}; three samples of the reference")
    if passes > 1 and _learns_from_passes(spec, policy):
        own = own._replace(remembers=f"{own.remembers}, and the passes before")
    return own


def declared_by_name(name: str) -> Declared | None:
    """Return what a policy of the package declares; None of any other. No file is read."""
    spec = resolve(name)
    return declared(spec) if spec.named else None


def _on(arm: AnyArm, law: str, own: Declared) -> Declared:
    """Return the declaration of a named law on an arm."""
    from fuzzyarm.envs.physics.parameters import ArmParameters

    if arm == ArmParameters():
        return own
    if isinstance(arm, ArmParameters) or law not in _ON_ROBOTS:
        return own._replace(tuned_on=f"{own.tuned_on}; all of the arm of Table 1")
    objective, tuned_on = _ON_ROBOTS[law]
    return own._replace(objective=objective, tuned_on=tuned_on.format(arm.name))


def _own(spec: PolicySpec, policy: Any) -> Declared | None:
    """Return the declaration of a law, without what the ending `TIP` and passes add."""
    if spec.named:
        return _NAMED.get(spec.name.removesuffix(TIP))
    if spec.kind is Kind.CODE:
        own: Declared | None = getattr(policy, "declared", None)
        return own
    if spec.path is None:
        return None
    from fuzzyarm.policies import declared_files

    if spec.tuned:
        return declared_files.of_tuned(spec.path, _NAMED)
    if spec.kind is Kind.CONTROLLER:
        return declared_files.of_controller(spec.path)
    return declared_files.of_learned(spec.path)


def _learns_from_passes(spec: PolicySpec, policy: Any) -> bool:
    """Return whether a policy has `repeated`, see `Policy`."""
    if spec.kind is Kind.CODE:
        return policy is not None and policy.repeated() is not None
    return spec.tip or (spec.kind in (Kind.LAW, Kind.TUNED) and spec.label == _ADAPTIVE)
