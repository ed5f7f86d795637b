"""What policies out of files declare, as far as the files say it: controller files, tuned and learned folders."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fuzzyarm.common.checks import shown
from fuzzyarm.policies.declaration import ELASTIC, INTEGRAL, LEARNED_OBSERVER, RIGID, SEES, Declared
from fuzzyarm.policies.tuned import ADAPTIVE_OBSERVER, COMPUTED_TORQUE, ELASTIC_OBSERVER

__all__ = ["of_controller", "of_learned", "of_tuned"]

_FUZZY = "fuzzy-4"  # the controller file that a tuning writes; others may lie beside it
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
# For a serial robot: objective and tuned on.
_POSTURES = "margins at random postures and along the default path of the arm of {}"
_ROBOT = {
    COMPUTED_TORQUE: ("largest bandwidth within margins", _POSTURES),
    ELASTIC_OBSERVER: ("weights of Table 1, softened to have margins", _POSTURES),
}


def of_controller(path: Path) -> Declared:
    """Return the declaration of a controller file; ValueError and OSError as of `load_controller`."""
    from fuzzyarm.fuzzy_policy.controller import Controller
    from fuzzyarm.fuzzy_policy.controller_files import load_controller

    controller = load_controller(path)
    integral = not isinstance(controller, Controller) or controller.integral
    return Declared(
        f"{_text(controller.origin.get('objective'))}, by linear matrix inequalities at proven bounds",
        f"the rigid model of its arm, no motion; who chose the bounds, and how, is {_UNKNOWN}",
        RIGID,
        SEES,
        INTEGRAL if integral else "nothing",
    )


def of_tuned(path: Path, laws: Mapping[str, Declared]) -> Declared:
    """Return the declaration of a law of a tuned folder.

    Args:
        path: of the law in the folder, or of its controller file.
        laws: the declarations of the shipped laws, by name.

    Raises:
        ValueError: the folder is damaged.
        OSError: a file cannot be read.
    """
    from fuzzyarm.envs.physics.equations import chosen_arm
    from fuzzyarm.envs.physics.parameters import ArmParameters

    folder, law = path.parent.name, path.name.removesuffix(".json")
    if law != path.name and law != _FUZZY:
        return of_controller(path)
    two_joints = isinstance(chosen_arm(path.parent, None), ArmParameters)
    if law == _FUZZY:
        own = laws[_FUZZY]
        if not two_joints:
            own = own._replace(objective="largest decay rate within margins, at a proven bound")
        return own._replace(tuned_on=(_TWO_JOINTS[COMPUTED_TORQUE] if two_joints else _POSTURES).format(folder))
    if two_joints or law not in _ROBOT:
        return laws[law]._replace(tuned_on=_TWO_JOINTS[law].format(folder))
    objective, tuned_on = _ROBOT[law]
    return laws[law]._replace(objective=objective, tuned_on=tuned_on.format(folder))


def of_learned(folder: Path) -> Declared | None:
    """Return the declaration of a learned policy's folder; None if there is none.

    Raises:
        ValueError: the folder is damaged.
        OSError: a file cannot be read.
    """
    from fuzzyarm.learned_policy.bundle import PolicyBundle
    from fuzzyarm.learned_policy.folder import is_observer

    if not folder.is_dir():
        return None
    if is_observer(folder):
        return LEARNED_OBSERVER
    bundle = PolicyBundle.load(folder)
    training, base = bundle.training, bundle.action.base
    elastic = [ELASTIC] if bundle.features.elastic_target else []
    return Declared(
        f"{_reward(training.get('tip_error_scale'))}{_smooth(training)}, by {_text(training.get('algorithm'))}",
        f"{_distribution(training.get('distribution'))}; how its settings were chosen is {_UNKNOWN}",
        "; ".join([f"what {base} knows"] if base else elastic) or "nothing",
        SEES,
        "; ".join([*([f"as {base}"] if base else []), _memory(bundle)]),
    )


def _memory(bundle: Any) -> str:
    """Return what the network of a bundle is told of the past."""
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


def _reward(scale: Any) -> str:
    if not isinstance(scale, int | float):
        return f"discounted reward, {_UNKNOWN} which"
    return f"discounted reward: {'logarithm of the tip error, effort' if scale > 0.0 else 'that of the environment'}"


def _smooth(training: Mapping[str, Any]) -> str:
    weight = training.get("smoothness")
    return "; smooth actions" if isinstance(weight, int | float) and weight > 0.0 else ""


def _distribution(name: Any) -> str:
    known = {
        "nominal": "nominal case of its arm",
        "robust": "random plants, forces, payloads and references of its arm",
    }
    return known.get(name, _UNKNOWN) if isinstance(name, str) else _UNKNOWN


def _text(text: Any) -> str:
    """Return a text out of a file as it may be shown."""
    if not isinstance(text, str) or not text.strip():
        return _UNKNOWN
    return text if text.isprintable() and len(text) <= _LONGEST else shown(text)
