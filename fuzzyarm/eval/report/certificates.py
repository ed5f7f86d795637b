"""Proofs about the policies: certificates of the rigid arm in words, and tubes of the tip.

The section of tubes draws the proven tube of the elastic, sampled arm's tip around the path.
"""

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.arithmetic import at_least
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.report._summary import figure
from fuzzyarm.policies.tip_bound import plain
from fuzzyarm.policies.tip_files import BoundCheck, check_bound

__all__ = ["checked_bounds", "statements", "tube_section"]


def statements(certificates: Mapping[str, str | None], bounds: Mapping[str, Mapping[str, Any] | None]) -> str:
    """Return HTML: a line for each certificate, which expands to its text, and the names of the policies without one.

    `bounds` are the numerical bounds of the certificates; None where the claim is void along the reference.
    """
    parts = [
        f'<details class="note"><summary>{escape(name)}: {_claim(bounds[name])}</summary>'
        f"<p>{escape(text)}</p></details>"
        for name, text in certificates.items()
        if text is not None
    ]
    if without := ", ".join(name for name, text in certificates.items() if text is None):
        parts.append(f'<p class="note">Nothing is proven about the rigid arm with {escape(without)}.</p>')
    return "".join(parts)


def _claim(numbers: Mapping[str, Any] | None) -> str:
    if numbers is None:
        return "void along this path"
    only = ", with zero reference input" if numbers["form"] == "paper" else ""
    return f"error decays at least as fast as exp(−{at_least(numbers['alpha'], 6)} t){only}"


_SIZE, _EDGE = 440.0, 26.0  # of the drawing, and of its margin [px]
_PERCENT = 150.0  # room for the number beside a bar [px]
_WIDEST = 0.12  # largest half width of a drawn tube, as a share of the path's extent
_TUBE_NOTE = (
    "Band: the proven bound on the tip error at every instant, for every plant of the set, to either side of the path. "
    "Line in the band: the tip in the replayed episode. Both are magnified around the path. Bar: the largest tip error "
    "of that episode as a share of the bound. The files were checked again when this report was made."
)


def checked_bounds(paths: Sequence[Path]) -> list[BoundCheck]:
    """Return the result of checking each file of a tip bound; ValueError names the first that is not proven."""
    found = [check_bound(path) for path in paths]
    for check in found:
        if not check.proven:
            raise ValueError(f"the bound in {check.path} is not proven: {check.reason}")
    return found


def tube_section(checks: Sequence[BoundCheck], rollouts: Sequence[Rollout]) -> str:
    """Return the section on proven tubes, empty without bounds; ValueError if a bound has no matching episode."""
    if not checks:
        return ""
    drawn = "".join(_tube(check, _episode(check, rollouts)) for check in checks)
    sentences = "".join(f"<li>{escape(plain(check.claim.policy))}: {escape(check.sentence)}.</li>" for check in checks)
    return (
        '<section aria-labelledby="tubes"><h2 id="tubes">Proven about the tip</h2>'
        f'<ul>{sentences}</ul><div class="charts">{drawn}</div><p class="note">{escape(_TUBE_NOTE)}</p></section>'
    )


def _episode(check: BoundCheck, rollouts: Sequence[Rollout]) -> Rollout:
    claim = check.claim
    for run in rollouts:
        if (run.policy, run.case) == (claim.policy, claim.case) and len(run.tip) >= len(check.tip):
            wanted = check.reference().tip(run.time[: len(check.tip)]).position
            found = run.tip_reference[: len(check.tip)]
            if found.shape == wanted.shape and np.abs(found - wanted).max() < 1e-9:
                return run
    raise ValueError(
        f"{check.path}: the evaluation has no episode of {claim.policy} in case {claim.case} on the {claim.path} that "
        f"lasts {claim.duration:g} s; run one with fuzzyarm evaluate, or leave the bound out"
    )


def _tube(check: BoundCheck, run: Rollout) -> str:
    """Return the SVG of a proven tube around the path and of an episode in it, with x to the right and y upwards."""
    count = len(check.tip)
    path, tip = run.tip_reference[:count], run.tip[:count]
    along = np.gradient(path, axis=0)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(np.hypot(*along.T), 1e-12)[:, np.newaxis]
    extent = float(np.ptp(path, axis=0).max())
    most = _WIDEST * extent / max(float(check.tip.max()), 1e-12)
    power = 10.0 ** math.floor(math.log10(most))
    times = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most * (1 + 1e-12))
    middle = 0.5 * (path.min(axis=0) + path.max(axis=0))
    scale = (_SIZE - 2.0 * _EDGE) / (extent * (1.0 + 2.0 * _WIDEST))

    def points(places: np.ndarray) -> str:
        pixels = 0.5 * _SIZE + scale * (places - middle) * [1.0, -1.0]
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels)

    half = times * check.tip[:, np.newaxis] * across
    band = np.concatenate([path + half, (path - half)[::-1]])
    title = f"{plain(check.claim.policy)}, set {check.claim.named_set(check.arm)}: errors magnified {times:g} times"
    svg = (
        f'<svg class="chart tube" role="img" viewBox="0 0 {_SIZE:g} {_SIZE:g}"><title>{escape(title)}</title>'
        f'<polygon class="band" points="{points(band)}"/><polyline class="path" points="{points(path)}"/>'
        f'<polyline class="tip" points="{points(path + times * (tip - path))}"/></svg>'
    )
    return figure(title, svg + _share(float(run.tip_error[:count].max()) / check.bound))


def _share(share: float) -> str:
    """Return the SVG of a bar that shows `share`, the largest tip error as a fraction of its bound."""
    room, words = _SIZE - _PERCENT, f"{100.0 * share:.3g} % of the bound"
    return (
        f'<svg class="chart share" role="img" viewBox="0 0 {_SIZE:g} 18"><title>largest tip error: {words}</title>'
        f'<rect class="whole" width="{room:g}" height="18" rx="3"/>'
        f'<rect class="part" width="{room * min(share, 1.0):.1f}" height="18" rx="3"/>'
        f'<text class="value" x="{_SIZE:g}" y="14">{words}</text></svg>'
    )
