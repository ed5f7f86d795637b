"""The declaration of each policy, which shows where a comparison of control and learning is unequal.

A declaration states for which objective and on which plants a policy was tuned, its prior knowledge of the arm, its
observations, and its memory between samples. This module declares the package's policies by name, and files and folders
by their content; the user's own code declares itself by its attribute ``declared`` (`_user_code`).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from fuzzyarm.common.checks import listed, shown
from fuzzyarm.envs.physics.equations import AnyArm, chosen_arm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.policies.registry import (
    ADAPTIVE_OBSERVER,
    COMPUTED_TORQUE,
    ELASTIC_OBSERVER,
    PAPERS,
    SMOOTH_OBSERVER,
    TIP,
    Kind,
)
from fuzzyarm.policies.spec import PolicySpec, resolve

__all__ = ["HEADINGS", "Declared", "declared", "declared_by_name", "stated"]

HEADINGS = ("objective", "tuned on", "knows of the arm", "sees", "remembers")
"""Column headings for the fields of `Declared`."""


class Declared(NamedTuple):
    """The declaration of a policy, in words: its tuning, and what it knows, sees and remembers."""

    objective: str  # the quantity that its tuning minimised
    tuned_on: str  # motions, plants and loads of its tuning
    knows: str  # prior knowledge of the arm
    sees: str  # content of its observation
    remembers: str  # memory from one sample to the next


def stated(given: Any) -> Declared:
    """Return the declaration in a mapping or an object's attributes; ValueError names a missing or wrong field."""
    fields = Declared._fields
    found = (
        given if isinstance(given, Mapping) else {name: getattr(given, name) for name in fields if hasattr(given, name)}
    )
    allowed = f"needed: {', '.join(fields)}, each a string of one line"
    if unknown := [name for name in found if name not in fields]:
        raise ValueError(f"declared has the unknown field(s) {listed(unknown)}; {allowed}")
    if missing := [name for name in fields if name not in found]:
        raise ValueError(f"declared lacks {', '.join(missing)}; {allowed}")
    for name, text in found.items():
        if not isinstance(text, str) or not text.strip() or not text.isprintable():
            raise ValueError(f"declared: {name} = {shown(text)} is not allowed; {allowed}")
    return Declared(**{name: str(found[name]) for name in fields})


_SEES = "motor angles and velocities; reference with two derivatives, no preview"
_INTEGRAL = "integral of the joint error"
_RIGID, _ELASTIC = "rigid model, no friction", "elastic model with friction"
_GUESS = f"{_ELASTIC}, as a first guess; how far it may be off"
_HAND = "; settings by hand on Cases 1 to 3"
_REWARD = "discounted reward: logarithm of the tip error, effort"
_RANDOM = "random plants, forces, payloads and references"
_LEARNED = "two errors and actions, leaky integral of the error"
_FUZZY, _LEARNED_OBSERVER = "fuzzy-4", "learned-observer"

_NAMED = {
    name: Declared(objective, tuned_on, knows, _SEES, remembers)
    for name, objective, tuned_on, knows, remembers in (
        *(
            (
                f"fuzzy-{rules}",
                "smallest gains at a proven bound; the bound by motor error and margins",
                "nominal case",
                _RIGID,
                _INTEGRAL,
            )
            for rules in (32, 16, 8, 4, 2, 1)
        ),
        (
            "fuzzy-4-sampled",
            "deviation of the tip by any friction on the sampled elastic arm, within margins and at a proven bound",
            "nominal case, stiffness ± 10 %",
            _RIGID,
            _INTEGRAL,
        ),
        (PAPERS[0], "smallest gains at the paper's alpha and Q", "nothing", _RIGID, _INTEGRAL),
        (PAPERS[1], "the paper's", "not recorded", _RIGID, _INTEGRAL),
        (COMPUTED_TORQUE, "smallest motor error within margins", "nominal case", _RIGID, _INTEGRAL),
        (
            ELASTIC_OBSERVER,
            "mean rms tip error, and noise in Case 1, within margins",
            "random plants, constant forces and payloads on the paper's circle",
            _ELASTIC,
            "estimate of state and load",
        ),
        (
            SMOOTH_OBSERVER,
            "that of elastic-observer, whose gains it has",
            "nothing of its own",
            _ELASTIC,
            "estimate of state and load",
        ),
        (
            ADAPTIVE_OBSERVER,
            "mean and worst largest tip error, and noise in Case 1",
            "random plants, forces, payloads, delays, noise and references; the paper's circle without load",
            _GUESS,
            "estimate of state, load, constants and lateness, with covariance",
        ),
        (
            _LEARNED_OBSERVER,
            "distance to the torque of a teacher who knows plant, load and lateness",
            "random plants, forces, payloads, delays, noise and references",
            _GUESS,
            "what elastic-observer and adaptive-observer remember; the state of a network",
        ),
        ("ppo-nominal", _REWARD, "nominal case" + _HAND, "nothing", _LEARNED),
        ("ppo-robust", f"{_REWARD}; smooth actions", _RANDOM + _HAND, "nothing", _LEARNED),
        ("ppo-residual", _REWARD, _RANDOM + _HAND, "what fuzzy-4-tip knows", f"as fuzzy-4-tip; {_LEARNED}"),
    )
}

_MARGINS = "margins at random postures and along the default path of the arm of {}"
_POSTURES = "random postures of {}; all else of the arm of Table 1"
# For a law on another arm: the objective (empty: unchanged) and `tuned_on` that replace the law's; {}: arm.
_ON_ROBOTS = {  # the law's parameters are derived from those for Table 1
    COMPUTED_TORQUE: ("bandwidth of Table 1, lowered until there are margins", _POSTURES),
    ELASTIC_OBSERVER: ("weights of Table 1, softened until there are margins", _POSTURES),
    SMOOTH_OBSERVER: ("that of elastic-observer, whose gains it has", "nothing of its own"),
    ADAPTIVE_OBSERVER: (
        "weights of Table 1, softened until the regulator is stable",
        f"{_POSTURES}; two numbers for all robots on passes of the UR5 in Case 2",
    ),
}
_TUNED = {  # a law from a tuned folder, tuned by the rules of the shipped policies
    _FUZZY: ("", "nominal case of the arm of {}"),
    COMPUTED_TORQUE: ("", "nominal case of the arm of {}"),
    ELASTIC_OBSERVER: ("", "random plants, constant forces and payloads on the default path of the arm of {}"),
    ADAPTIVE_OBSERVER: (
        "",
        "random plants, forces, payloads, delays, noise and references of the arm of {}; its default path without load",
    ),
}
_TUNED_SERIAL = _TUNED | {  # a law from the tuned folder of a serial robot
    _FUZZY: ("largest decay rate within margins, at a proven bound", _MARGINS),
    COMPUTED_TORQUE: ("largest bandwidth within margins", _MARGINS),
    ELASTIC_OBSERVER: ("weights of Table 1, softened to have margins", _MARGINS),
}


def _instead(own: Declared, table: Mapping[str, tuple[str, str]], law: str, arm: str) -> Declared:
    objective, tuned_on = table[law]
    return own._replace(objective=objective or own.objective, tuned_on=tuned_on.format(arm))


def declared(name: str | PolicySpec, policy: Any = None, passes: int = 1, arm: AnyArm | None = None) -> Declared | None:
    """Return the declaration of a policy; None without a declaration.

    `policy` is the loaded policy, needed only for the user's own code. With several `passes` over the same path, a
    policy that learns from pass to pass also remembers the previous passes. `arm` is the arm for which a named policy
    was loaded, by default that of Table 1; files and folders state theirs. ValueError if the policy's file or folder is
    damaged, OSError if it cannot be read.
    """
    spec = name if isinstance(name, PolicySpec) else resolve(name)
    own, law = _own(spec, policy), spec.name.removesuffix(TIP)
    if own is None:
        return None
    if spec.named and arm is not None and arm != ArmParameters():
        if isinstance(arm, ArmParameters) or law not in _ON_ROBOTS:
            own = own._replace(tuned_on=f"{own.tuned_on}; all of the arm of Table 1")
        else:
            own = _instead(own, _ON_ROBOTS, law, arm.name)
    if spec.tip:
        own = own._replace(knows=_ELASTIC, remembers=f"{own.remembers}; three samples of the reference")
    if spec.kind is Kind.CODE:
        learns = policy is not None and policy.repeated() is not None
    else:
        learns = spec.tip or (spec.kind in (Kind.LAW, Kind.TUNED) and spec.label == ADAPTIVE_OBSERVER)
    if passes > 1 and learns:
        own = own._replace(remembers=f"{own.remembers}, and the passes before")
    return own


def declared_by_name(name: str) -> Declared | None:
    """Return the declaration of a policy of the package, without reading a file; None for any other policy."""
    spec = resolve(name)
    return declared(spec) if spec.named else None


def _own(spec: PolicySpec, policy: Any) -> Declared | None:
    """Return a policy's declaration, None without one, before `declared` adapts it to arm, tip and passes."""
    path = spec.path
    if spec.shield is not None and spec.kind is not Kind.CODE:
        base, guest = declared(spec.shield.law), declared(spec.shield.guest)
        if base is None or guest is None:
            return None
        beside = f"; within ({spec.shield.margin}) N m of {spec.shield.law.label}, which knows and remembers"
        return guest._replace(knows=f"{guest.knows}{beside}: {base.knows}; {base.remembers}")
    if spec.named:
        return _NAMED.get(spec.name.removesuffix(TIP))
    if spec.kind is Kind.CODE:
        own: Declared | None = getattr(policy, "declared", None)
        return own
    if path is None:
        return None
    law = path.stem if path.stem == _FUZZY else path.name  # the controller file from tuning, or a law
    if spec.tuned and law in _TUNED:
        two_joints = isinstance(chosen_arm(path.parent, None), ArmParameters)
        return _instead(_NAMED[law], _TUNED if two_joints else _TUNED_SERIAL, law, path.parent.name)
    return (_of_controller if spec.kind is Kind.CONTROLLER else _of_learned)(path)


_UNKNOWN = "not recorded"


def _of_controller(path: Path) -> Declared:
    from fuzzyarm.fuzzy_policy.controller import Controller
    from fuzzyarm.fuzzy_policy.scheduled_controller import load_controller

    controller = load_controller(path)
    integral = not isinstance(controller, Controller) or controller.integral
    return Declared(
        f"{_text(controller.origin.get('objective'))}, by linear matrix inequalities at proven bounds",
        f"the rigid model of its arm, no motion; who chose the bounds, and how, is {_UNKNOWN}",
        _RIGID,
        _SEES,
        _INTEGRAL if integral else "nothing",
    )


def _of_learned(folder: Path) -> Declared | None:
    """Return the declaration of a learned policy from its folder; None if there is no such folder."""
    from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle, is_observer

    if not folder.is_dir():
        return None
    if is_observer(folder):
        return _NAMED[_LEARNED_OBSERVER]
    bundle = PolicyBundle.load(folder)
    training, base = bundle.training, bundle.action.base
    scale, smoothness, drawn = (training.get(name) for name in ("tip_error_scale", "smoothness", "distribution"))
    reward = f", {_UNKNOWN} which"
    if isinstance(scale, int | float):
        reward = f": {'logarithm of the tip error, effort' if scale > 0.0 else 'that of the environment'}"
    smooth = "; smooth actions" if isinstance(smoothness, int | float) and smoothness > 0.0 else ""
    drawn = {"nominal": "nominal case of its arm", "robust": f"{_RANDOM} of its arm"}.get(str(drawn), _UNKNOWN)
    knows = f"what {base} knows" if base else _ELASTIC if bundle.features.elastic_target else "nothing"
    return Declared(
        f"discounted reward{reward}{smooth}, by {_text(training.get('algorithm'))}",
        f"{drawn}; how its settings were chosen is {_UNKNOWN}",
        knows,
        _SEES,
        (f"as {base}; " if base else "") + _memory(bundle),
    )


def _memory(bundle: Any) -> str:
    """Return, in words, the memory of a bundle's network."""
    features = bundle.features
    counts = ((features.past_errors, "error"), (features.past_actions, "action"))
    kept = [f"{number} {word}{'' if number == 1 else 's'}" for number, word in counts if number]
    more = {
        "leaky integral of the error": features.integral_time > 0.0,
        "filtered action": bundle.action.smoothing_time > 0.0,
    }
    return ", ".join([*kept, *(words for words, is_kept in more.items() if is_kept)]) or "nothing"


def _text(text: Any) -> str:
    """Return a string from a file, made safe to print."""
    if not isinstance(text, str) or not text.strip():
        return _UNKNOWN
    return text if text.isprintable() and len(text) <= 80 else shown(text)
