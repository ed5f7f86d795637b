"""What each policy declares: the asymmetries by which comparisons of control and learning go wrong.

A policy says what its numbers were chosen for and on what, what it knows of the arm beforehand, what it sees, and what
it remembers from one sample to the next. Its certificate stands with the results. Policies of the package declare it by
their name, files and folders by what is in them, and the user's own code by an attribute ``declared`` (`user_code`).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from fuzzyarm.common.checks import listed, shown
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.policies.registry import TIP, Kind
from fuzzyarm.policies.spec import PolicySpec, resolve
from fuzzyarm.policies.tuned import ADAPTIVE_OBSERVER, COMPUTED_TORQUE, ELASTIC_OBSERVER

__all__ = ["ELASTIC", "HEADINGS", "Declared", "declared", "declared_by_name", "stated"]

HEADINGS = ("objective", "tuned on", "knows of the arm", "sees", "remembers")
"""Of the columns, one for each field of `Declared`."""

_SEES = "motor angles and velocities; reference with two derivatives, no preview"
INTEGRAL = "integral of the joint error"
RIGID, ELASTIC = "rigid model, no friction", "elastic model with friction"


class Declared(NamedTuple):
    """The declaration of a policy, in words."""

    objective: str  # what its numbers make small
    tuned_on: str  # the motions, plants and loads on which they were chosen
    knows: str  # what it knows of the arm beforehand
    sees: str  # what its observation holds
    remembers: str  # what it keeps from one sample to the next


_LEARNED_OBSERVER = Declared(
    "distance to the torque of a teacher who knows plant, load and lateness",
    "random plants, forces, payloads, delays, noise and references",
    f"{ELASTIC}, as a first guess; how far it may be off",
    _SEES,
    "what elastic-observer and adaptive-observer remember; the state of a network",
)
"""Of every learned observer: its training has no other tasks."""


def stated(given: Any) -> Declared:
    """Return the declaration of a mapping, or of an object's attributes; ValueError names a missing or wrong field."""
    fields = Declared._fields
    found = (
        given if isinstance(given, Mapping) else {name: getattr(given, name) for name in fields if hasattr(given, name)}
    )
    allowed = f"needed: {', '.join(fields)}, each a text of one line"
    if unknown := [name for name in found if name not in fields]:
        raise ValueError(f"declared has the unknown field {listed(unknown)}; {allowed}")
    if missing := [name for name in fields if name not in found]:
        raise ValueError(f"declared lacks {', '.join(missing)}; {allowed}")
    for name, text in found.items():
        if not isinstance(text, str) or not text.strip() or not text.isprintable():
            raise ValueError(f"declared: {name} = {shown(text)} is none; {allowed}")
    return Declared(**{name: str(found[name]) for name in fields})


_FUZZY = Declared(
    "smallest gains at a proven bound; the bound by motor error and margins", "nominal case", RIGID, _SEES, INTEGRAL
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
        _SEES,
        INTEGRAL,
    ),
    "computed-torque": Declared("smallest motor error within margins", "nominal case", RIGID, _SEES, INTEGRAL),
    "elastic-observer": Declared(
        "mean rms tip error, and noise in Case 1, within margins",
        "random plants, constant forces and payloads on the paper's circle",
        ELASTIC,
        _SEES,
        "estimate of state and load",
    ),
    _ADAPTIVE: Declared(
        "mean and worst largest tip error, and noise in Case 1",
        "random plants, forces, payloads, delays, noise and references; the paper's circle without load",
        f"{ELASTIC}, as a first guess; how far it may be off",
        _SEES,
        "estimate of state, load, constants and lateness, with covariance",
    ),
    "learned-observer": _LEARNED_OBSERVER,
    "ppo-nominal": Declared(_REWARD, "nominal case" + _HAND, "nothing", _SEES, _LEARNED),
    "ppo-robust": Declared(f"{_REWARD}; smooth actions", _RANDOM, "nothing", _SEES, _LEARNED),
    "ppo-residual": Declared(_REWARD, _RANDOM, "what fuzzy-4-tip knows", _SEES, f"as fuzzy-4-tip; {_LEARNED}"),
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
    """Return what a policy declares; None for one that comes without a declaration.

    The policy as it was loaded is needed of the user's own code alone. With several `passes` over the same path, a
    policy that learns from them remembers those before. `arm` is that for which it was loaded, by default Table 1;
    files and folders say for which arm they are. ValueError if the policy's file or folder is damaged, OSError if it
    cannot be read.
    """
    spec = name if isinstance(name, PolicySpec) else resolve(name)
    own = _own(spec, policy)
    if own is None:
        return None
    if spec.named and arm is not None:
        own = _on_arm(arm, spec.name.removesuffix(TIP), own)
    if spec.tip:
        own = own._replace(knows=ELASTIC, remembers=f"{own.remembers}; three samples of the reference")
    if passes > 1 and _learns_from_passes(spec, policy):
        own = own._replace(remembers=f"{own.remembers}, and the passes before")
    return own


def declared_by_name(name: str) -> Declared | None:
    """Return what a policy of the package declares; None of any other. No file is read."""
    spec = resolve(name)
    return declared(spec) if spec.named else None


def _on_arm(arm: AnyArm, law: str, own: Declared) -> Declared:
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
    if spec.tuned:
        return _of_tuned(spec.path)
    return (_of_controller if spec.kind is Kind.CONTROLLER else _of_learned)(spec.path)


def _learns_from_passes(spec: PolicySpec, policy: Any) -> bool:
    """Return whether a policy has `repeated`, see `Policy`."""
    if spec.kind is Kind.CODE:
        return policy is not None and policy.repeated() is not None
    return spec.tip or (spec.kind in (Kind.LAW, Kind.TUNED) and spec.label == _ADAPTIVE)


_TUNED_FUZZY = "fuzzy-4"  # the controller file that a tuning writes; others may lie beside it
_UNKNOWN = "not recorded"
_LONGEST = 80  # characters that are shown of a text out of a file

# Of a tuned folder for two joints, by the rules of the shipped policies: what each law is tuned on; {} is the folder.
_TWO_JOINTS = {
    COMPUTED_TORQUE: "nominal case of the arm of {}",
    ELASTIC_OBSERVER: "random plants, constant forces and payloads on the default path of the arm of {}",
    ADAPTIVE_OBSERVER: (
        "random plants, forces, payloads, delays, noise and references of the arm of {}; its default path without load"
    ),
}
_DISTRIBUTIONS = {
    "nominal": "nominal case of its arm",
    "robust": "random plants, forces, payloads and references of its arm",
}
# For a serial robot: objective and tuned on.
_MARGINS = "margins at random postures and along the default path of the arm of {}"
_ROBOT = {
    COMPUTED_TORQUE: ("largest bandwidth within margins", _MARGINS),
    ELASTIC_OBSERVER: ("weights of Table 1, softened to have margins", _MARGINS),
}


def _of_controller(path: Path) -> Declared:
    from fuzzyarm.fuzzy_policy.controller import Controller
    from fuzzyarm.fuzzy_policy.scheduled import load_controller

    controller = load_controller(path)
    integral = not isinstance(controller, Controller) or controller.integral
    return Declared(
        f"{_text(controller.origin.get('objective'))}, by linear matrix inequalities at proven bounds",
        f"the rigid model of its arm, no motion; who chose the bounds, and how, is {_UNKNOWN}",
        RIGID,
        _SEES,
        INTEGRAL if integral else "nothing",
    )


def _of_tuned(path: Path) -> Declared:
    """Return the declaration of a law of a tuned folder, by its path in it, or that of its controller file."""
    from fuzzyarm.envs.physics.equations import chosen_arm
    from fuzzyarm.envs.physics.parameters import ArmParameters

    folder, law = path.parent.name, path.name.removesuffix(".json")
    if law != path.name and law != _TUNED_FUZZY:
        return _of_controller(path)
    two_joints = isinstance(chosen_arm(path.parent, None), ArmParameters)
    if law == _TUNED_FUZZY:
        own = _NAMED[_TUNED_FUZZY]
        if not two_joints:
            own = own._replace(objective="largest decay rate within margins, at a proven bound")
        return own._replace(tuned_on=(_TWO_JOINTS[COMPUTED_TORQUE] if two_joints else _MARGINS).format(folder))
    if two_joints or law not in _ROBOT:
        return _NAMED[law]._replace(tuned_on=_TWO_JOINTS[law].format(folder))
    objective, tuned_on = _ROBOT[law]
    return _NAMED[law]._replace(objective=objective, tuned_on=tuned_on.format(folder))


def _of_learned(folder: Path) -> Declared | None:
    """Return the declaration of a learned policy's folder; None if there is none."""
    from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle, is_observer

    if not folder.is_dir():
        return None
    if is_observer(folder):
        return _LEARNED_OBSERVER
    bundle = PolicyBundle.load(folder)
    training, base = bundle.training, bundle.action.base
    scale, smoothness, drawn = (training.get(name) for name in ("tip_error_scale", "smoothness", "distribution"))
    reward = f", {_UNKNOWN} which"
    if isinstance(scale, int | float):
        reward = f": {'logarithm of the tip error, effort' if scale > 0.0 else 'that of the environment'}"
    smooth = "; smooth actions" if isinstance(smoothness, int | float) and smoothness > 0.0 else ""
    elastic = [ELASTIC] if bundle.features.elastic_target else []
    return Declared(
        f"discounted reward{reward}{smooth}, by {_text(training.get('algorithm'))}",
        f"{_DISTRIBUTIONS.get(str(drawn), _UNKNOWN)}; how its settings were chosen is {_UNKNOWN}",
        "; ".join([f"what {base} knows"] if base else elastic) or "nothing",
        _SEES,
        "; ".join([*([f"as {base}"] if base else []), _memory(bundle)]),
    )


def _memory(bundle: Any) -> str:
    """Return what the network of a bundle remembers."""
    features = bundle.features
    kept = [
        f"{number} {word}{'' if number == 1 else 's'}"
        for number, word in ((features.past_errors, "error"), (features.past_actions, "action"))
        if number
    ]
    kept += ["leaky integral of the error"] if features.integral_time > 0.0 else []
    kept += ["filtered action"] if bundle.action.smoothing_time > 0.0 else []
    kept += ["means of the innovation"] if features.innovation_times else []
    kept += ["the state of a network"] if bundle.network.cell is not None else []
    return ", ".join(kept) or "nothing"


def _text(text: Any) -> str:
    """Return a text out of a file as it may be shown."""
    if not isinstance(text, str) or not text.strip():
        return _UNKNOWN
    return text if text.isprintable() and len(text) <= _LONGEST else shown(text)
