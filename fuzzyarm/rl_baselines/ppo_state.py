"""The check of a stored state of PPO: nothing of it is used before all of it fits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from fuzzyarm.common import checks
from fuzzyarm.rl_baselines.checkpoint import check_finite, check_like

__all__ = ["check_ppo_state"]

_MOMENTS = ("exp_avg", "exp_avg_sq")  # of Adam, of the shape of their parameter
_STEPS = "step"


def check_ppo_state(found: Any, own: dict[str, Any], parameters: Sequence[torch.Tensor]) -> None:
    """Check a state of PPO: names, types and shapes of tensors, and ranges of numbers.

    Args:
        found: in the checkpoint.
        own: `PPOAlgorithm.state` of a new training with the same configuration.
        parameters: of the networks, in the order of the optimiser, each of its own shape.

    Raises:
        TypeError, ValueError: they do not fit together; the message says where.
    """
    check_like("learner", found, own)
    check_finite("learner", found)
    _check_optimizer(found["optimizer"], own["optimizer"], parameters)
    for name, count in found["counters"].items():
        checks.whole(f"learner.counters.{name}", count, high=2**62)
    for episode in found["episodes"]:
        if set(checks.instance("an episode", episode, dict)) != {"r", "l"}:
            raise ValueError(f"learner.episodes holds {checks.shown(episode)}; needed: r and l")
        checks.real("return of an episode", episode["r"])
        checks.whole("length of an episode", episode["l"])
    for name in ("features", "returns"):
        moments = found["normaliser"][name]
        checks.real(f"learner.normaliser.{name}.count", moments["count"], low=0.0, high=2.0**62)
        if bool((moments["var"] < 0.0).any()):
            raise ValueError(f"learner.normaliser.{name}.var is negative")


def _check_optimizer(found: dict[str, Any], own: dict[str, Any], parameters: Sequence[torch.Tensor]) -> None:
    """Check the settings of Adam, of which only the learning rate changes, and its moments."""
    groups, own_groups = found["param_groups"], own["param_groups"]
    for group, expected in zip(groups, own_groups, strict=True):
        check_like("learner.optimizer", group, expected)
        checks.real("learner.optimizer.lr", group["lr"], low=0.0)
        changed = [name for name, value in expected.items() if name != "lr" and group[name] != value]
        if changed:
            raise ValueError(f"learner.optimizer has another {', '.join(changed)} than this training")
    for place, moments in checks.instance("learner.optimizer.state", found["state"], dict).items():
        parameter = parameters[checks.whole("learner.optimizer.state: parameter", place, high=len(parameters) - 1)]
        like = {_STEPS: torch.zeros(()), **{name: parameter.detach() for name in _MOMENTS}}
        check_like(f"learner.optimizer.state.{place}", moments, like)
