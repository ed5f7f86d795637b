"""The checks of stored states of the learners: nothing of one is used before all of it fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch

from fuzzyarm.common import checks
from fuzzyarm.rl_baselines.checkpoint import check_finite, check_like

__all__ = ["check_off_policy_state", "check_ppo_state"]

_MOMENTS = ("exp_avg", "exp_avg_sq")  # of Adam, of the shape of their parameter
_STEPS, _MOST_STEPS = "step", 1e9  # below 0, and far beyond, Adam's corrections overflow


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
    _check_episodes(found["episodes"])
    for name in ("features", "returns"):
        _check_moments(name, found["normaliser"][name])


def check_off_policy_state(found: Any, own: dict[str, Any], parameters: Mapping[str, Sequence[torch.Tensor]]) -> None:
    """Check a state of SAC or TQC as `check_ppo_state` does, and the place in the replay buffer.

    Args:
        found: in the checkpoint.
        own: `OffPolicyAlgorithm.state` of a new training with the same configuration.
        parameters: of each optimiser, in its order, each of its own shape.

    Raises:
        TypeError, ValueError: they do not fit together; the message says where.
    """
    check_like("learner", found, own)
    check_finite("learner", found)
    for name, optimizer in own["optimizers"].items():
        _check_optimizer(found["optimizers"][name], optimizer, parameters[name])
    counters = found["counters"]
    for name in ("steps", "updates"):
        checks.whole(f"learner.counters.{name}", counters[name], high=2**62)
    checks.whole("learner.counters.position", counters["position"], high=len(own["buffer"]["rewards"]) - 1)
    _check_episodes(found["episodes"])
    _check_moments("features", found["normaliser"]["features"])


def _check_episodes(episodes: list[Any]) -> None:
    for episode in episodes:
        if set(checks.instance("an episode", episode, dict)) != {"r", "l"}:
            raise ValueError(f"learner.episodes holds {checks.shown(episode)}; needed: r and l")
        checks.real("return of an episode", episode["r"])
        checks.whole("length of an episode", episode["l"])


def _check_moments(name: str, moments: dict[str, Any]) -> None:
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
        checks.real(f"learner.optimizer.state.{place}.step", float(moments[_STEPS]), low=0.0, high=_MOST_STEPS)
