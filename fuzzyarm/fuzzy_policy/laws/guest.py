"""A guest in a shield: any policy, with its torque kept near the torque of a law.

    u = u_f + clip(π - u_f, ±δ),      u_f the torque of the law within the motors' limits, π the torque of the guest.

Where π is not a number, u = u_f. Since |u - u_f| <= δ whatever the guest does, a proof for the law with any additional
torque of that size holds for every guest, see `docs/theory/shield.md`. The law receives no data from the guest. A guest
that integrates an error, or predicts the arm under its own torque, receives u.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from fuzzyarm.common.checks import instance, reals
from fuzzyarm.envs.observation import Observation
from fuzzyarm.fuzzy_policy.law import Law, LawPolicy, held_at_limits, law_of, within_limits
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.functions import maximum, minimum, select

__all__ = ["ShieldedPolicy"]


def _admitted(law: Any, asked: Any, margin: Any) -> tuple[Any, ...]:
    """Return u_f + clip(π - u_f, ±δ) [N m] joint by joint, u_f if π is nan, for `law` u_f, `asked` π, `margin` δ."""
    return tuple(
        select(wanted == wanted, maximum(minimum(wanted, own + most), own - most), own)
        for own, wanted, most in zip(law, asked, margin, strict=True)
    )


class ShieldedPolicy(LawPolicy):
    """The policy `guest`, with torques kept within δ of those of `law`; the memory is the law's, then the guest's."""

    def __init__(self, law: Policy, guest: Policy, margin: Any, *, beside: bool = False) -> None:
        """Store law, guest and the bound δ = `margin` (n,) [N m] on |u - u_f|.

        π is the guest's torque, plus u_f if `beside` is true. ValueError if the law is not a `Law`, guest and law are
        for different arms or control periods, or δ is not a positive number for each joint.
        """
        super().__init__(instance("law", law, Policy).parameters, law.control_period)  # type: ignore[type-abstract]
        instance("guest", guest, Policy)  # type: ignore[type-abstract]
        if law_of(law) is None:
            raise ValueError(
                "a shield needs a policy whose control law is defined as a `Law`, such as fuzzy-4-tip; "
                f"{type(law).__name__} does not define one"
            )
        if guest.parameters != law.parameters or guest.control_period != law.control_period:
            raise ValueError("law and guest (the policy in the shield) must be for the same arm and control period")
        self.law, self.guest, self.beside = law, guest, beside
        self.margin = tuple(map(float, reals("margin", margin, self.joints, "N m", above=0.0)))
        self.memory_size = law.memory_size + guest.memory_size

    def without_dry_friction(self) -> ShieldedPolicy:
        """Return this policy for an arm without dry friction."""
        smooth = self.law.without_dry_friction(), self.guest.without_dry_friction()
        return ShieldedPolicy(*smooth, self.margin, beside=self.beside)

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Act as in `Policy.act`; if the guest raises ValueError or ArithmeticError, u = u_f, the law's torque."""
        if self.control_law is not None:
            super().act(observation, memory, torque)
            return
        own, other = np.split(memory, [self.law.memory_size], axis=1)  # views
        asked, before = np.empty_like(torque), other.copy()
        self.law.command(observation, own, torque)
        try:
            self.guest.command(observation, other, asked)
        except (ValueError, ArithmeticError):
            asked[:], other[:] = np.nan, before
        if self.beside:
            asked += torque
        margin = np.array(self.margin)
        torque[:] = np.where(np.isnan(asked), torque, np.clip(asked, torque - margin, torque + margin))

    @functools.cached_property
    def control_law(self) -> Law | None:  # type: ignore[override]
        """The law that clips the guest's torque to within δ of the torque of `law`; None if the guest has no `Law`."""
        law, guest = law_of(self.law), law_of(self.guest)
        if law is None or guest is None:
            return None
        command, at, own = (
            within_limits(law, self.joints, self.law.integral_at),
            self.guest.integral_at,
            len(law.tables),
        )

        def shielded(memory: Any, seen: Observation, given: Any, *tables: Any) -> tuple[Any, Any]:
            (m, behind), (of_law, of_guest, margin) = memory, given
            m, u_f = command(m, seen, of_law, *tables[:own])

            def whole(asked: Any) -> Any:
                return [u + v for u, v in zip(u_f, asked, strict=True)] if self.beside else asked

            def admit(asked: Any) -> Any:
                return type(u_f)(*_admitted(u_f, whole(asked), margin))

            told = {"admit": admit} if guest.told else {}
            after, asked = guest.act(behind, seen, of_guest, *tables[own:], **told)
            if at is not None:
                limits = [(u - most, u + most) for u, most in zip(u_f, margin, strict=True)]
                after = held_at_limits(behind, after, at, whole(asked), limits)
            return (m, after), admit(asked)

        limit = tuple(map(float, self.law.torque_limit))
        constants = ((law.constants, limit), guest.constants, self.margin)
        return Law(shielded, (law.memory, guest.memory), constants, (*law.tables, *guest.tables))
