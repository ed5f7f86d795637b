"""Estimates of policies compared with true values: a force chart and a table for each case and policy."""

import math
import re
from collections.abc import Mapping
from html import escape

import numpy as np

from fuzzyarm.envs.scenario.cases import CASES, Case
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.eval.episodes._beliefs import DEVIATION
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.report._summary import figure

__all__ = ["belief_section"]

_WARNING = (
    "Charts: magnitude of the tip force over the episode; the thin line is the estimate, with a band of one standard "
    "deviation, and the thick line the true force. A policy cannot fully separate payload from force: part of one is "
    "estimated as the other, so neither is a measurement. Tables: estimates with the standard deviation given by the "
    "policy; stiffness, damping, friction, mass and motor inertia are factors relative to the arm that the policy "
    "knows. The simulated arm is that arm, so the true factors are 1. Parameters that the motion does not excite stay "
    "near their initial guess."
)
_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 390, 150, 40, 24  # [px]: size of the chart, margins for its labels
_POINTS = 300  # of a curve
_BAND = 90.0  # percentile of the upper edge of the band up to which the chart reaches; higher parts are cut off
# Unit of an estimate, and the factor that converts to it; other estimates are pure numbers.
_UNITS = {"payload": ("kg", 1.0), "offset": ("N m", 1.0), "lateness": ("ms", 1e3)}


def belief_section(rollouts: list[Rollout], cases: Mapping[str, Case] = CASES) -> str:
    """Return the page's section on estimates: a figure for each case and policy that has them; empty without any.

    A figure shows the first episode; notes on all episodes of this policy in this case follow. `cases` give the true
    loads.
    """
    groups: dict[tuple[str, str], list[Rollout]] = {}
    for run in rollouts:
        groups.setdefault((run.case, run.policy), []).append(run)
    parts = []
    for (case, policy), runs in groups.items():
        if first := next((run for run in runs if run.beliefs.size), None):
            said = [f"seed {run.seed}: {run.note}" if len(runs) > 1 else run.note for run in runs if run.note]
            notes = f'<p class="note">{escape("; ".join(said))}.</p>' if said else ""
            content = _chart(first) + _table(first, cases[case].disturbance) + notes
            parts.append(figure(f"{cases[case].title}, {policy}", content))
    if not parts:
        return ""
    return (
        '<section aria-labelledby="beliefs"><h2 id="beliefs">Estimates of load and arm</h2>'
        "<details><summary>Charts and tables</summary>"
        f'<p class="note">{escape(_WARNING)}</p><div class="charts">{"".join(parts)}</div></details></section>'
    )


def _chart(run: Rollout) -> str:
    """Return the SVG of the estimated and true size of the tip force; an empty string without an estimate of it."""
    believed = run.believed
    forces = [name for name in believed if re.fullmatch("force_[xyz]", name)]
    size, deviation = (
        np.linalg.norm([believed[name + ending] for name in forces], axis=0) if forces else np.array([np.nan])
        for ending in ("", DEVIATION)
    )
    known = np.flatnonzero(np.isfinite(size + deviation))
    if not known.size:
        return ""
    truth = np.linalg.norm(run.external_force, axis=1)
    lower, upper = np.maximum(size - deviation, 0.0), size + deviation
    highest = max(1.0, truth.max(), size[known].max(), float(np.percentile(upper[known], _BAND)))
    thinned, samples = known[:: max(len(known) // _POINTS, 1)], np.arange(0, len(truth), max(len(truth) // _POINTS, 1))

    def curve(force: np.ndarray, at: np.ndarray) -> str:
        x = _LEFT + (_WIDTH - _LEFT) * run.time[at] / run.time[-1]
        y = (_HEIGHT - _BOTTOM) * (1.0 - np.clip(force[at] / highest, 0.0, 1.0)) + 2.0
        return "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))

    words = f"tip force, estimated and true, over {run.time[-1]:.2f} s"
    return (
        f'<svg class="chart" role="img" viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}">'
        f"<title>{escape(words)}</title>"
        f'<text class="tick" x="18" y="12">{highest:.0f} N</text>'
        f'<text class="tick" x="18" y="{_HEIGHT - _BOTTOM + 4}">0</text>'
        f'<path class="grid" d="M{_LEFT} {_HEIGHT - _BOTTOM + 2}H{_WIDTH}"/>'
        f'<g class="p0"><path class="belief-band" d="M{curve(upper, thinned)}L{curve(lower, thinned[::-1])}Z"/>'
        f'<path class="belief" d="M{curve(size, thinned)}"/></g><path class="truth" d="M{curve(truth, samples)}"/>'
        f'<text class="axis" x="{(_LEFT + _WIDTH) / 2}" y="{_HEIGHT - 6}">{escape(words)}</text></svg>'
    )


def _table(run: Rollout, loads: Disturbance) -> str:
    """Return the HTML table of the last estimates, except forces, and the true values under these loads."""
    believed, joints = run.believed, run.torque.shape[1]
    parts: dict[str, list[str]] = {}
    for name in believed:
        if not name.startswith("force_") and not name.endswith(DEVIATION):
            parts.setdefault(re.sub(r"_\d+$", "", name), []).append(name)
    known = np.flatnonzero(~np.isnan(run.beliefs).all(axis=1))
    if not (parts and known.size):
        return ""
    order = sorted(parts, key=["payload", "lateness", "offset"].__contains__)
    rows = []
    for part, names in ((part, parts[part]) for part in order):
        unit, factor = _UNITS.get(part, ("", 1.0))
        cells = [
            _with_deviation(*(factor * believed[name + end][known[-1]] for end in ("", DEVIATION))) for name in names
        ]
        span = f' colspan="{joints}"' if len(cells) == 1 else ""
        said = "".join(f"<td{span}>{cell}</td>" for cell in cells)
        label = part.replace("_", " ") + (f" [{unit}]" if unit else "")
        truth = _truth(part, loads, run.time[-1])
        rows.append(f'<tr><th scope="row">{escape(label)}</th>{said}<td>{escape(truth)}</td></tr>')
    heads = "".join(f'<th scope="col">joint {joint + 1}</th>' for joint in range(joints))
    last = f"at {run.time[known[-1]]:.3f} s"
    return (
        f'<div class="scroll"><table class="believed"><thead><tr><th scope="col">{last}</th>{heads}'
        f'<th scope="col">true</th></tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
    )


def _truth(part: str, loads: Disturbance, time: float) -> str:
    """Return as text the true value of the estimate `part` at a time [s] under these loads.

    The simulated arm is the one that the policy knows.
    """
    if part == "payload":
        return f"{loads.payload.mass:g}"
    if part == "offset" and loads.torque_bias is not None:
        return ", ".join(f"{number:g}" for number in loads.torque_bias.at(np.array(time)))
    return "0" if part in _UNITS else "1"


def _with_deviation(value: float, deviation: float) -> str:
    """Return the text "value ± deviation", or "none" if either is not finite.

    Both have as many decimals as two significant digits of the deviation need, at most four.
    """
    if not (math.isfinite(value) and math.isfinite(deviation)):
        return "none"
    digits = min(max(1 - math.floor(math.log10(deviation)), 0), 4) if deviation > 0.0 else 4
    return f"{round(value, digits) + 0.0:.{digits}f} ± {deviation:.{digits}f}"  # + 0.0: no minus before a zero
