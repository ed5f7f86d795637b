"""The certificate of a policy: the claims of its controller file, for its law and for the same law tracking the tip."""

import dataclasses
import math
from typing import Any

import numpy as np

from fuzzyarm.common.arithmetic import at_most
from fuzzyarm.envs.scenario.elastic_reference import CHECKED_INSTANTS, ElasticReference
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.scheduled import ScheduledPolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.fuzzy_policy.scheduled_controller import FORM, ScheduledController
from fuzzyarm.proof.certificate import PROVEN, certify, controller_statement
from fuzzyarm.proof.scheduled_certificate import certify_scheduled, scheduled_statement

__all__ = ["PolicyCertificate", "certificate_of", "tip_statement"]


@dataclasses.dataclass(frozen=True)
class PolicyCertificate:
    """The proven claims of a policy on a reference; see `certificate_of`."""

    text: str  # statement of what is proven and what is not
    # the numbers of the claim, ready for JSON: ``form``, ``alpha`` [1/s], ``gamma`` ([rad/(N m)] in the consistent
    # form, [s²] in the semidefinite one) and ``controller_digest``, the digest of the controller file. None if the
    # policy leaves the box along the reference, so that the claim is void.
    bounds: dict[str, Any] | None
    controller: Controller | ScheduledController  # the controller whose inequalities are proven
    # whether the claim holds for the error from every twice differentiable reference, not only from the one in the
    # observation
    any_reference: bool


def certificate_of(policy: object, reference: Reference) -> PolicyCertificate | None:
    """Return the certificate of a policy along a reference; None if nothing is proven.

    A law that tracks the tip inherits the claim of the law that it wraps, for the error from θ_d instead of q_d, unless
    that claim holds for the observed reference alone, as in the paper's form.
    """
    if isinstance(policy, TipPolicy):
        law = certificate_of(policy.law, reference)
        if law is None or not law.any_reference:
            return None
        elastic, text = _along_the_tip(reference)
        bounds = None if elastic is None else law.bounds
        return dataclasses.replace(law, text=f"{law.text} {text}", bounds=bounds, any_reference=False)
    if not isinstance(policy, FuzzyPolicy | ScheduledPolicy):
        return None
    controller: Controller | ScheduledController = policy.controller
    prove: Any = certify if isinstance(controller, Controller) else certify_scheduled
    # The controller may have been loaded with `allow_unproven`, or made by hand.
    if controller.digest not in PROVEN and not prove(controller).proven:
        return None
    if isinstance(controller, Controller):
        form, text = controller.form, controller_statement(controller)
    else:
        form, text = FORM, scheduled_statement(controller)
    numbers = {"alpha": controller.alpha, "gamma": controller.gamma, "controller_digest": controller.digest}
    # The proof of the paper's form includes the reference model, whose state must be the reference itself.
    return PolicyCertificate(text, {"form": form, **numbers}, controller, any_reference=form != "paper")


def tip_statement(reference: Reference) -> str:
    """Return what the certificate states for laws that track the motors' reference θ_d, or why θ_d has none.

    The inequality holds for the error from any reference, with w = d + ρ. For θ_d, ρ has two terms: one from dropped
    premises, which vanishes with the error, and u_ff without friction minus the rigid arm's inverse dynamics at θ_d,
    that is τ_d minus the torque that the links would need at θ_d. The second term is known in advance; its largest
    value and the share of the box that θ_d uses are evaluated at `CHECKED_INSTANTS` instants.
    """
    return _along_the_tip(reference)[1]


def _along_the_tip(reference: Reference) -> tuple[ElasticReference | None, str]:
    """Return θ_d of a reference (None if it leaves the box, which voids the certificate) and `tip_statement`'s text."""
    try:
        elastic = ElasticReference(reference)
    except ValueError as error:
        return None, f"With the tip as its target, it has no certificate along this reference: {error}."
    t = np.linspace(0.0, reference.duration, CHECKED_INSTANTS)
    known = np.abs(elastic.torque(t) - elastic.links_torque(elastic.sample(t))).max(axis=0)
    return elastic, (
        "With the tip as its target, it tracks theta_d = q_d + delta, where the motors must be for the bent joints to "
        "put the links on q_d. theta_d is a twice differentiable reference like any other (its second "
        "derivative jumps where that of q_d has a corner), so the same inequalities hold for the error from theta_d; d "
        "then also holds what the feedforward adds for the elastic joints, and friction only as far as the feedforward "
        f"misses it. Sampled at {CHECKED_INSTANTS} instants of this reference and not bounded between them, what it "
        f"adds reaches ({', '.join(at_most(torque, 2) for torque in known)}) N m, and theta_d takes "
        f"{math.ceil(100.0 * elastic.box_use)} % of the box. The certificate does not say that the tip then follows."
    )
