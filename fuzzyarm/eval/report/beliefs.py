"""What policies believed of the load, beside the truth: a chart for each case and policy that says what it believes."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

from fuzzyarm.envs.scenario.cases import CASES, Case
from fuzzyarm.eval.episodes.beliefs import belief_names
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.report.chart import figure

__all__ = ["WARNING", "belief_charts"]

WARNING = (
    "Size of the force at the tip over the episode: the estimate, with a band of one standard deviation, and, thicker, "
    "the truth. Masses and forces share a load: a part of a payload shows up as a force, and the other way round, so "
    "neither is a measurement."
)
"""What has to be known to read the charts."""
WIDTH, HEIGHT, LEFT, BOTTOM = 390, 150, 40, 24  # [px]: of the chart, and the margins of its labels
POINTS = 300  # of a curve


def belief_charts(rollouts: list[Rollout], cases: Mapping[str, Case] = CASES) -> str:
    """Return a chart of every first episode of a policy with beliefs; an empty text if no policy has any.

    `cases` by name, with the loads that were carried.
    """
    seen: set[tuple[str, str]] = set()
    charts = []
    for run in rollouts:
        if run.beliefs.size and (run.case, run.policy) not in seen:
            seen.add((run.case, run.policy))
            case = cases[run.case]
            charts.append(figure(f"{case.title}, {run.policy}", _chart(run, case.disturbance.payload.mass)))
    return "".join(charts)


def _chart(run: Rollout, mass: float) -> str:
    """Return the SVG of one episode under a payload [kg]."""
    axes = run.external_force.shape[1]
    column = dict(zip(belief_names(axes), run.beliefs.T, strict=True))
    truth = np.linalg.norm(run.external_force, axis=1)
    size = np.linalg.norm(run.beliefs[:, :axes], axis=1)
    deviation = np.linalg.norm(run.beliefs[:, axes : 2 * axes], axis=1)
    highest = max(float(truth.max()), float(size.max()), 1.0)
    every = max(len(size) // POINTS, 1)
    x = LEFT + (WIDTH - LEFT) * run.time / run.time[-1]

    def y(force: np.ndarray) -> np.ndarray:
        return np.asarray((HEIGHT - BOTTOM) * (1.0 - np.clip(force / highest, 0.0, 1.0)) + 2.0)

    def curve(force: np.ndarray) -> str:
        return "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x[::every], y(force)[::every], strict=True))

    back = "L".join(reversed(curve(np.maximum(size - deviation, 0.0)).split("L")))
    words = (
        f"payload: {column['payload'][-1]:.1f} ± {column['payload_deviation'][-1]:.1f} kg believed, {mass:g} kg true"
    )
    return (
        f'<svg class="chart" role="img" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}">'
        f"<title>{escape(words)}</title>"
        f'<text class="tick" x="18" y="12">{highest:.0f} N</text>'
        f'<text class="tick" x="18" y="{HEIGHT - BOTTOM + 4}">0</text>'
        f'<path class="grid" d="M{LEFT} {HEIGHT - BOTTOM + 2}H{WIDTH}"/>'
        f'<g class="p0"><path class="belief-band" d="M{curve(size + deviation)}L{back}Z"/>'
        f'<path class="belief" d="M{curve(size)}"/></g><path class="truth" d="M{curve(truth)}"/>'
        f'<text class="axis" x="{(LEFT + WIDTH) / 2}" y="{HEIGHT - 6}">{escape(words)}</text></svg>'
    )
