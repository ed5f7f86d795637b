"""The section of certificates: certified bounds beside the worst observed values, and the certificates in words."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from decimal import Decimal
from html import escape
from typing import Any

from fuzzyarm.common.rounding import at_least, at_most
from fuzzyarm.eval.report.chart import Axis, Bound, draw_chart, figure
from fuzzyarm.eval.report.observed import Observed
from fuzzyarm.eval.report.stored import StoredEvaluation
from fuzzyarm.fuzzy_policy.proof.policy_certificate import NOT_COVERED

__all__ = ["SCOPE", "Observations", "bound_charts", "bound_note", "statements"]

SCOPE = (
    "A certificate is proven for the rigid arm in continuous time, as long as it stays inside the box, and not for the "
    "sampled elastic arm of the replay. " + NOT_COVERED
)
NOTE = (
    "❘ certified bound; the hatched range is what it rules out. ● and digits: the worst observed on the rigid arm when "
    "this report was made, that is the slowest decay of the Lyapunov function in undisturbed rollouts, and the largest "
    "gain over a library of torques and the worst torque found by power iteration, along the reference and at the "
    "worst held posture. A -tip policy has the bounds of its controller file, which is observed once for both policies."
)

Observations = Mapping[str, Observed | str]
"""What was observed by policy, or in words why nothing was, see `observe_policies`."""


@dataclasses.dataclass(frozen=True)
class _BoundChart:
    """A chart of one certified bound.

    Attributes:
        title: above the chart.
        label: of the axis, with the unit.
        key: of the certified value in the bounds.
        digits: decimal digits from SI units to the unit of the axis.
        at_least: whether the certified value is a lower bound.
        worst: the worst value observed, in SI units.
        forms: of controllers that claim this quantity.
    """

    title: str
    label: str
    key: str
    digits: int
    at_least: bool
    worst: Callable[[Observed], float]
    forms: tuple[str, ...]


DECAY, GAIN = ("consistent", "semidefinite"), ("consistent",)  # forms whose bounds are of the rigid arm's error
_CHARTS = (
    _BoundChart("Decay rate", "decay rate of the root of V [1/s]", "alpha", 0, True, lambda seen: seen.decay, DECAY),
    _BoundChart(
        "L2 gain, disturbance to error", "L2 gain [µrad/(N m)]", "gamma", 6, False, lambda seen: seen.gain, GAIN
    ),
)


def bound_charts(stored: StoredEvaluation, observed: Observations) -> str:
    """Return a chart of each kind of bound; a policy without comparable bounds has a text in its row."""
    figures = []
    for spec in _CHARTS:
        rows = [(name, _row(spec, claimed, observed.get(name))) for name, claimed in stored.bounds.items()]
        values = [max(bound.certified, bound.observed or 0.0) for _, bound in rows if isinstance(bound, Bound)]
        axis = Axis(spec.label, 0.0, 1.25 * max(values, default=1.0))
        chart = draw_chart(axis, rows, f"{spec.title}: certified bound and worst observed")
        figures.append(figure(spec.title, chart))
    return "".join(figures)


def _row(spec: _BoundChart, claimed: Mapping[str, Any] | None, seen: Observed | str | None) -> Bound | str:
    if claimed is None:
        return "nothing proven"
    if claimed["form"] not in spec.forms:
        return "of other quantities"
    worst = 10.0**spec.digits * spec.worst(seen) if isinstance(seen, Observed) else None
    # Rounded so that it holds before the unit is changed, which is exact in decimal.
    stated = (at_least if spec.at_least else at_most)(claimed[spec.key], 3)
    return Bound(float(Decimal(stated).scaleb(spec.digits)), worst, spec.at_least)


def bound_note(observed: Observations) -> str:
    """Return the note below the charts: what they show, and why a policy was not observed."""
    reasons = [f" {name}: {text}." for name, text in observed.items() if isinstance(text, str)]
    return escape(NOTE + "".join(reasons))


def statements(certificates: Mapping[str, str | None]) -> str:
    """Return every certificate in words, as a folded paragraph, and the names of the policies without one."""
    parts = [
        f'<details class="note"><summary>{escape(name)}: what is proven</summary><p>{escape(text)}</p></details>'
        for name, text in certificates.items()
        if text is not None
    ]
    if without := ", ".join(name for name, text in certificates.items() if text is None):
        parts.append(f'<p class="note">Nothing is proven of the rigid arm: {escape(without)}.</p>')
    return "".join(parts)
