"""The registry of policies known by name; `add_policy` adds a policy."""

from __future__ import annotations

import dataclasses
import enum
import pkgutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from fuzzyarm.common.registry import Registry

if TYPE_CHECKING:
    from fuzzyarm.envs.physics.equations import AnyArm
    from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = [
    "ADAPTIVE_OBSERVER", "ANY_ROBOT", "COMPARED", "COMPUTED_TORQUE", "ELASTIC_OBSERVER", "FOREIGN", "LAWS", "LEARNED",
    "NAMES", "PAPERS", "POLICIES", "TIP", "Kind", "add_policy", "foreign", "known_names", "make_law",
]  # fmt: skip

FOREIGN = {"sb3:": ".zip", "onnx:": ".onnx"}
"""Prefixes that mark the paths of other libraries' models, with the suffixes of such files."""

TIP = "-tip"
"""Suffix of a policy's name with which its law is wrapped in `fuzzy_policy.laws.tip.TipPolicy`, which guides the tip
along the reference instead of the motors."""

Factory: TypeAlias = "Callable[[AnyArm, float], Policy]"
"""A function that makes a law from its arm and the control period [s]."""


class Kind(enum.StrEnum):
    """What a policy is made from."""

    LAW = "law"  # a function in this process with the arguments arm and control period
    CONTROLLER = "controller"  # a controller file
    LEARNED = "learned"  # the folder of a learned policy
    TUNED = "tuned"  # a law with the parameters in a folder of `fuzzyarm tune`
    SHIELD = "shield"  # a law with a guest, see `fuzzy_policy.laws.guest`; `CODE` where the guest is code
    CODE = "code"  # the user's own code, ``package.module:factory``, or a foreign model, see `FOREIGN`


@dataclasses.dataclass(frozen=True)
class _NamedPolicy:
    """What a policy known by name is made from."""

    kind: Kind  # never `Kind.CODE`
    factory: Factory | None = None  # for `Kind.LAW`, the function that makes the law
    path: Path | None = None  # otherwise, the controller file or the folder of the learned policy
    has_tip: bool = False  # whether the name with the suffix `TIP` is known as well


LAWS = {
    "computed-torque": "computed_torque:ComputedTorquePolicy",
    "elastic-observer": "elastic_observer:ElasticObserverPolicy",
    "adaptive-observer": "adaptive.policy:AdaptiveObserverPolicy",
}
"""Laws without a controller file; each is imported when it is made, so that `import fuzzyarm` compiles nothing."""
COMPUTED_TORQUE, ELASTIC_OBSERVER, ADAPTIVE_OBSERVER = LAWS  # their names


def foreign(name: str) -> str:
    """Return the key of `FOREIGN` that a name begins with, or an empty string."""
    return next((prefix for prefix in FOREIGN if name.startswith(prefix)), "")


def make_law(name: str, robot: AnyArm, control_period: float, *given: Any) -> Policy:
    """Return the law `name` of `LAWS`; `given`: its bandwidth or weights, then the fallback of the adaptive law."""
    made: Policy = pkgutil.resolve_name(f"fuzzyarm.fuzzy_policy.laws.{LAWS[name]}")(robot, control_period, *given)
    return made


def _adaptive_observer(robot: AnyArm, control_period: float) -> Policy:
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.fuzzy_policy.controller import Controller
    from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
    from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy

    # The certified law is designed for Table 1; for another arm the policy falls back to computed torque.
    certified = None
    if robot == ArmParameters():
        certified = TipPolicy(FuzzyPolicy(Controller.load(_CONTROLLERS / "fuzzy-4.json"), control_period))
    return make_law(ADAPTIVE_OBSERVER, robot, control_period, None, certified)


def _smooth_observer(robot: AnyArm, control_period: float) -> Policy:
    from fuzzyarm.fuzzy_policy.laws.elastic_observer import SmoothObserverPolicy

    return SmoothObserverPolicy(robot, control_period)


def _printed(robot: AnyArm, control_period: float) -> Policy:
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.fuzzy_policy.controller import Controller
    from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
    from fuzzyarm.fuzzy_policy.laws.printed_gains import with_printed_gains

    if robot != ArmParameters():
        raise ValueError(f"{PAPERS[1]} works only on the arm of Table 1; for another arm, use fuzzyarm design --robot")
    return FuzzyPolicy(with_printed_gains(Controller.load(_PAPERS_FOUR)), control_period)


_FUZZY = ("fuzzy-32", "fuzzy-16", "fuzzy-8", "fuzzy-4", "fuzzy-2", "fuzzy-1", "fuzzy-4-sampled")
_HOME = Path(__file__).parent.parent / "fuzzy_policy"
_CONTROLLERS, _TRAINED = _HOME / "controllers", _HOME / "laws" / "learned" / "policies"
_PAPERS_FOUR = _HOME.parent / "eval" / "paper" / "controllers" / "paper-4-integral-common.json"

SMOOTH_OBSERVER = "smooth-observer"

PAPERS = ("paper-4", "paper-4-printed")
"""The paper's own law with four rules: Theorem 2 solved as printed, and the gains that the paper prints."""

LEARNED = ("ppo-nominal", "ppo-robust", "ppo-residual")
"""Policies trained with PPO, the median seed of each; ``policy.json`` records the training run."""

POLICIES = Registry[_NamedPolicy](
    __name__,
    {
        **{name: _NamedPolicy(Kind.CONTROLLER, path=_CONTROLLERS / f"{name}.json", has_tip=True) for name in _FUZZY},
        COMPUTED_TORQUE: _NamedPolicy(Kind.LAW, partial(make_law, COMPUTED_TORQUE), has_tip=True),
        ELASTIC_OBSERVER: _NamedPolicy(Kind.LAW, partial(make_law, ELASTIC_OBSERVER)),
        ADAPTIVE_OBSERVER: _NamedPolicy(Kind.LAW, _adaptive_observer),
        SMOOTH_OBSERVER: _NamedPolicy(Kind.LAW, _smooth_observer),
        PAPERS[0]: _NamedPolicy(Kind.CONTROLLER, path=_PAPERS_FOUR, has_tip=True),
        PAPERS[1]: _NamedPolicy(Kind.LAW, _printed),
        **{name: _NamedPolicy(Kind.LEARNED, path=_TRAINED / name) for name in (*LEARNED, "learned-observer")},
    },
)
"""All policies by name, without the suffix `TIP`; `add_policy` adds a policy."""

_VARIANTS = (*PAPERS, SMOOTH_OBSERVER)
_TIPS = tuple(name for name, policy in POLICIES.items() if policy.has_tip and name not in _VARIANTS)
NAMES = (*_TIPS, *(name + TIP for name in _TIPS), *(name for name in POLICIES if name not in (*_TIPS, *_VARIANTS)))
"""Names of the policies that are compared in all results, including those with the suffix `TIP`; `PAPERS` and
`SMOOTH_OBSERVER`, variants of other policies, are left out."""

COMPARED = (
    *("fuzzy-4", COMPUTED_TORQUE, "fuzzy-4-tip", "computed-torque-tip"),
    *(ELASTIC_OBSERVER, ADAPTIVE_OBSERVER, "learned-observer", "ppo-robust", "ppo-residual"),
)
"""The policies that `fuzzyarm evaluate` runs by default. `ppo-nominal` is left out: it leaves the domain in conditions
that are absent from its training."""

ANY_ROBOT = ("computed-torque", "computed-torque-tip", "elastic-observer")
"""Policies that are compared by default on a robot other than the two-joint arm."""


def add_policy(name: str, factory: Factory, *, has_tip: bool = False) -> None:
    """Add a policy by name in this process; the defaults of commands and tables do not change.

    Args:
        name: a new name, which neither ends in `TIP` or ``.json`` nor contains a slash or a colon.
        factory: function that is called with the policy's arm and the control period [s].
        has_tip: whether `TipPolicy` may wrap the policy, under the name with the suffix `TIP`.

    Raises:
        ValueError: the name is taken, or names a file or code.
    """
    if not (isinstance(name, str) and name) or name.endswith((TIP, ".json")) or any(mark in name for mark in "/\\:"):
        raise ValueError(
            f"{name!r} cannot name a policy: a name is a non-empty string that neither ends in {TIP} or .json nor "
            "contains a slash, a backslash or a colon"
        )
    if not callable(factory):
        raise TypeError(f"factory = {factory!r:.80} must be a function of the arm and the control period")
    if name in POLICIES:
        raise ValueError(f"policy {name!r} already exists; choose another name")
    POLICIES[name] = _NamedPolicy(Kind.LAW, factory, has_tip=has_tip)


def known_names() -> tuple[str, ...]:
    """Return all known names: `NAMES`, then those added by `add_policy`."""
    added = {name: policy for name, policy in POLICIES.items() if name not in NAMES}
    return (*NAMES, *added, *(name + TIP for name, policy in added.items() if policy.has_tip))
