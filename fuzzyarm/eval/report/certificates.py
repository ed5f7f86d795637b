"""The certified bounds beside the worst observed, and what the certificates say."""

from __future__ import annotations

from collections.abc import Callable
from html import escape

from fuzzyarm.eval.report.chart import Axis, Bound, chart, figure
from fuzzyarm.eval.report.observed import Observed
from fuzzyarm.eval.report.stored import StoredEvaluation
from fuzzyarm.fuzzy_policy.proof.policy_certificate import NOT_COVERED

SCOPE = (
    "A certificate is proven for the rigid arm in continuous time, as long as it stays inside the box, and not for the "
    "sampled elastic arm of the replay. " + NOT_COVERED
)
NOTE = (
    "❘ certified bound, hatched: what it rules out. ● and digits: the worst observed on the rigid arm when this report "
    "was made, that is the slowest decay of the Lyapunov function in undisturbed rollouts, and the largest gain over a "
    "library of torques and the worst torque found by power iteration, along the reference and at the worst held "
    "posture. A -tip policy has its controller file's bounds, observed once for both."
)
# title, label of the axis, key of the certified value, unit, whether it bounds from below, what is observed
_CHARTS: tuple[tuple[str, str, str, float, bool, Callable[[Observed], float]], ...] = (
    ("Decay rate", "decay rate of the error [1/s]", "alpha", 1.0, True, lambda seen: seen.decay),
    ("L2 gain, disturbance to error", "L2 gain [µrad/(N m)]", "gamma", 1e6, False, lambda seen: seen.gain),
)

Observations = dict[str, Observed | str]


def bound_charts(stored: StoredEvaluation, observed: Observations) -> str:
    """Return the charts of both bounds; a policy without a certificate has the words instead."""
    figures = []
    for title, label, key, unit, at_least, worst in _CHARTS:
        rows: list[tuple[str, Bound | str]] = []
        for name, claimed in stored.bounds.items():
            seen = observed.get(name)
            if claimed is None:
                rows.append((name, "no certificate"))
            elif claimed["form"] != "consistent":
                rows.append((name, "of other quantities"))
            else:
                value = unit * worst(seen) if isinstance(seen, Observed) else None
                rows.append((name, Bound(unit * claimed[key], value, at_least)))
        values = [max(b.certified, b.observed or 0.0) for _, b in rows if isinstance(b, Bound)]
        axis = Axis(label, 0.0, 1.25 * max(values, default=1.0))
        figures.append(figure(title, chart(axis, rows, f"{title}: certified bound and worst observed")))
    return "".join(figures)


def bound_note(observed: Observations) -> str:
    """Return what the charts show, and why a bound has nothing observed beside it."""
    reasons = [f" {name}: {text}." for name, text in observed.items() if isinstance(text, str)]
    return escape(NOTE + "".join(reasons))


def statements(certificates: dict[str, str | None]) -> str:
    """Return every certificate in words, folded up, and the policies that have none."""
    parts = [
        f'<details class="note"><summary>{escape(name)}: what is proven</summary><p>{escape(text)}</p></details>'
        for name, text in certificates.items()
        if text is not None
    ]
    without = [name for name, text in certificates.items() if text is None]
    if without:
        parts.append(f'<p class="note">No certificate: {escape(", ".join(without))}.</p>')
    return "".join(parts)
