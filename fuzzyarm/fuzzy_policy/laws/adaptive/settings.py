"""What the law of the adaptive observer takes, arranged as arrays and numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

__all__ = ["Settings", "tables_of", "with_tables"]


class Settings(NamedTuple):
    """What the law takes, as arrays and numbers.

    Attributes:
        feedback: K, see `FeedbackTable`; in the law, its shape alone counts.
        feedback_rows: K, a row for each payload and point (payloads · points, n · 4 n).
        first_gain: see `AdaptiveWeights`.
        soft_samples: control periods in `AdaptiveWeights.soft_start`.
        kept: joints over whose angles it is tabulated.
        cosine: whether at even cosines rather than angles.
        points: of each angle.
        base: a_0 of `affine_numbers`.
        slopes: S of `affine_numbers`.
        guess: p_0.
        spread: standard deviations of z when an episode begins.
        shared: what numbers of z share when an episode begins, times its standard deviation.
        low: lowest p.
        high: highest p.
        noise: diagonal of Q.
        doubt: deviation of a motor velocity per square of a jump of its commanded torque [rad/s / (N m)²], (n,).
        scale_doubt: see `AdaptiveWeights`.
        calm_walk: see `AdaptiveWeights`.
        reopening: variance of the forces after `AdaptiveWeights.reopening` seconds of walk [N²], (forces,).
        still: square of a correction of the forces that counts as none [N²].
        steps: of the differences that make F.
        variances: of the measured numbers.
        cautious: which numbers of z learn only beyond the dead zone.
        gate: see `AdaptiveWeights`.
        dead_zone: see `AdaptiveWeights`.
        first_share: largest share of a sample in the noise that is read.
        insignificant: c² of `trust.significant`.
        largest_swing: see `AdaptiveWeights`.
        limit: torque limits [N m].
        mass: of all links [kg].
        substep: h [s].
        substeps: in a control period.
    """

    feedback: Any
    feedback_rows: Any
    first_gain: Any
    soft_samples: Any
    kept: Any
    cosine: Any
    points: Any
    base: Any
    slopes: Any
    guess: Any
    spread: Any
    shared: Any
    low: Any
    high: Any
    noise: Any
    doubt: Any
    scale_doubt: Any
    calm_walk: Any
    reopening: Any
    still: Any
    steps: Any
    variances: Any
    cautious: Any
    gate: Any
    dead_zone: Any
    first_share: Any
    insignificant: Any
    largest_swing: Any
    limit: Any
    mass: Any
    substep: Any
    substeps: Any


_TABLES = (
    "feedback_rows", "base", "slopes", "guess", "spread", "shared", "low", "high", "noise", "doubt", "reopening",
    "steps", "variances", "cautious", "limit",
)  # fmt: skip


def tables_of(settings: Settings) -> tuple[np.ndarray, ...]:
    """Return the arrays (any shape) that the law looks up by index, in a fixed order and double precision."""
    return tuple(np.array(getattr(settings, name), dtype=np.float64, order="C") for name in _TABLES)


def with_tables(settings: Settings, tables: Any) -> Settings:
    """Return the settings with other arrays in place of those of `tables_of`."""
    return settings._replace(**dict(zip(_TABLES, tables, strict=True)))
