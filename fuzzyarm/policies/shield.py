"""Shielded policies: any other policy, the guest, whose torque is kept within a margin around a law's torque."""

import warnings
from typing import Any

import numpy as np

from fuzzyarm.fuzzy_policy.laws.guest import ShieldedPolicy
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.policies._user_code import UserPolicy, load_code
from fuzzyarm.policies.registry import foreign
from fuzzyarm.policies.spec import ANY_GUEST, PolicySpec, load_policy, without_guest

__all__ = ["shielded", "shielded_of"]


def shielded(law: str | Policy, guest: Any, margin: Any) -> Policy | UserPolicy:
    """Return the policy u = u_f + clip(π - u_f, ±δ), with the torques u_f of a law and π of a guest.

    Args:
        law: a fixed law, or its name.
        guest: a policy's name, a policy, or any object with stable-baselines3's `predict` whose action is the torque
            (n,) [N m] for an observation of ``FuzzyArm-v0``. The law acts if the guest fails or returns no number.
        margin: δ (n,), largest difference from the law's torque [N m].

    Raises:
        ValueError: a name is unknown, the law is not a fixed law, or the margin is not positive for each joint.
        OSError: a file cannot be read.

    Examples:
        >>> policy = shielded("fuzzy-4-tip", "ppo-robust", (4.0, 2.0))
        >>> torque, state = policy.predict(np.zeros(10))
    """
    period = 1e-3
    for one in (law, guest):
        if isinstance(one, Policy):
            period = one.control_period
    law = load_policy(law, control_period=period) if isinstance(law, str) else law
    guest = load_policy(guest, control_period=period, robot=law.parameters) if isinstance(guest, str) else guest
    if isinstance(guest, Policy):
        return ShieldedPolicy(law, guest, margin)
    inside = guest if isinstance(guest, UserPolicy) else UserPolicy(type(guest).__name__, guest, law.control_period)
    return UserPolicy(inside.name, _Beside(ShieldedPolicy(law, law, margin), inside), law.control_period)


def shielded_of(spec: PolicySpec, control_period: float, robot: Any, allow_unproven: bool) -> Policy | UserPolicy:
    """Return the policy of a shield's spec for a control period [s]; arguments and errors as for `load_policy`.

    A guest from another library must have been trained on ``FuzzyArmLearn-v0`` with the argument `shield`.
    """
    assert spec.shield is not None
    _, margin = without_guest(spec.name)
    if spec.shield.guest.name == ANY_GUEST:
        raise ValueError(
            f"{spec.name} stands for a shield with any policy inside, which only fuzzyarm prove accepts; name a policy "
            f"instead of {ANY_GUEST}"
        )
    law = spec.shield.law.load(control_period, robot, allow_unproven)
    assert isinstance(law, Policy)
    guest = spec.shield.guest
    try:
        if not foreign(guest.name):
            return shielded(law, guest.load(control_period, law.parameters), margin)
        action = ActionDefinition(margin, period=control_period)
        other = load_code(guest.name, control_period, law.parameters, action)
        assert isinstance(other, Policy)
        return ShieldedPolicy(law, other, margin, beside=True)
    except ValueError as error:
        raise ValueError(f"{spec.name}: {error}") from None


class _Beside:
    """A law that limits a guest, any other policy; the state is the pair of the law's state and the guest's."""

    def __init__(self, alone: ShieldedPolicy, guest: UserPolicy) -> None:
        self._law, self._margin, self._guest = alone.law, np.array(alone.margin), guest
        self._warned = False

    def predict(
        self, observation: np.ndarray, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Return the torque [N m] and the next state; the first failure of the guest gives a RuntimeWarning."""
        own, other = (None, None) if state is None else state
        torque, own = self._law.predict(observation, own, episode_start)
        try:
            asked, other = self._guest.predict(observation, other, episode_start, deterministic)
            asked = np.asarray(asked, dtype=np.float64)
        except ValueError as error:
            if not self._warned:
                warnings.warn(
                    f"the policy in the shield failed; the shield's law acts alone: {error}",
                    RuntimeWarning,
                    stacklevel=2,
                )
            self._warned, asked = True, np.full_like(torque, np.nan)
        near = np.clip(asked, torque - self._margin, torque + self._margin)
        return np.where(np.isnan(asked), torque, near), (own, other)
