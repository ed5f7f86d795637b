"""Small charts as SVG, a row for each policy: colours come from the page's style, so that dark and light both work."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from html import escape

WIDTH, LEFT, RIGHT, TOP, ROW, BOTTOM = 390, 150, 76, 6, 25, 40  # [px]
LONGEST_NAME = 19  # characters; a longer name is cut, its tooltip has all of it


@dataclasses.dataclass(frozen=True)
class Axis:
    """A horizontal axis from `low` to `high`, labelled with quantity and unit."""

    label: str
    low: float
    high: float
    log: bool = False

    def x(self, value: float) -> float:
        """Return where a value stands [px]; values beyond the axis stand at its ends."""
        low, high = (math.log10(self.low), math.log10(self.high)) if self.log else (self.low, self.high)
        place = math.log10(max(value, 1e-300)) if self.log else value
        return LEFT + (WIDTH - LEFT - RIGHT) * min(max((place - low) / (high - low), 0.0), 1.0)

    def ticks(self) -> list[float]:
        """Return decades, or at most six round numbers."""
        if self.log:
            exponents = range(round(math.log10(self.low)), round(math.log10(self.high)) + 1)
            return [10.0**k for k in exponents if len(exponents) < 6 or k % 2 == 0]
        raw = (self.high - self.low) / 5.0
        unit = 10.0 ** math.floor(math.log10(raw))
        step = next(factor * unit for factor in (1.0, 2.0, 5.0, 10.0) if factor * unit >= raw)
        return [step * k for k in range(math.ceil(self.low / step), math.floor(self.high / step + 1e-9) + 1)]


@dataclasses.dataclass(frozen=True)
class Errors:
    """Root mean square and maximum of an error, and whether the former is the best."""

    rms: float
    maximum: float
    best: bool
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Bound:
    """What is certified and the worst observed, if anything; `at_least`: the certified value bounds from below."""

    certified: float
    observed: float | None
    at_least: bool


def chart(axis: Axis, rows: Sequence[tuple[str, Errors | Bound | str]], description: str) -> str:
    """Return the SVG of rows (policy, what is drawn of it); words stand where there is nothing to draw."""
    bottom = TOP + ROW * len(rows)
    parts = [
        f'<svg class="chart" role="img" viewBox="0 0 {WIDTH} {bottom + BOTTOM}" width="{WIDTH}" '
        f'height="{bottom + BOTTOM}"><title>{escape(description)}</title>'
    ]
    for tick in axis.ticks():
        x = axis.x(tick)
        parts.append(f'<path class="grid" d="M{x:.1f} {TOP}V{bottom}"/>')
        parts.append(f'<text class="tick" x="{x:.1f}" y="{bottom + 15}">{_number(tick)}</text>')
    middle = 0.5 * (LEFT + WIDTH - RIGHT)
    parts.append(f'<text class="axis" x="{middle}" y="{bottom + 33}">{escape(axis.label)}</text>')
    for index, (name, content) in enumerate(rows):
        parts.append(_row(axis, name, index, content))
    return "".join(parts) + "</svg>"


def _row(axis: Axis, name: str, index: int, content: Errors | Bound | str) -> str:
    y = TOP + ROW * (index + 0.5)
    short = name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + "…"
    label = (
        f'<g class="p{index % 8}"><title>{escape(name)}</title><rect class="key" x="0" y="{y - 5}" width="9" '
        f'height="10" rx="2"/><text class="name" x="16" y="{y + 4}">{escape(short)}</text>'
    )
    if isinstance(content, str):
        return label + f'<text class="none" x="{LEFT + 4}" y="{y + 4}">{escape(content)}</text></g>'
    drawn = _errors(axis, y, content) if isinstance(content, Errors) else _bound(axis, y, content)
    return label + drawn + "</g>"


def _errors(axis: Axis, y: float, errors: Errors) -> str:
    """Return a disc at the rms, a stroke at the maximum, and the rms in digits."""
    rms, maximum = axis.x(errors.rms), axis.x(errors.maximum)
    star = '<tspan class="star">★ </tspan>' if errors.best else ""
    return (
        f'<path class="span" d="M{rms:.1f} {y}H{maximum:.1f}"/><path class="end" d="M{maximum:.1f} {y - 6}v12"/>'
        f'<circle class="dot" cx="{rms:.1f}" cy="{y}" r="5"/>'
        f'<text class="value" x="{WIDTH - 2}" y="{y + 4}">{star}{digits(errors.rms)}{errors.note}</text>'
    )


def _bound(axis: Axis, y: float, bound: Bound) -> str:
    """Return what the certificate rules out, hatched, its limit, and a disc at the worst observed."""
    limit = axis.x(bound.certified)
    start, end = (axis.x(axis.low), limit) if bound.at_least else (limit, axis.x(axis.high))
    sign = "≥" if bound.at_least else "≤"
    drawn = (
        f'<rect class="ruled-out" x="{start:.1f}" y="{y - 7}" width="{end - start:.1f}" height="14"/>'
        f'<path class="limit" d="M{limit:.1f} {y - 10}v20"/>'
    )
    if bound.observed is None:
        return drawn + f'<text class="value" x="{WIDTH - 2}" y="{y + 4}">{sign} {bound.certified:.3g}</text>'
    return (
        drawn + f'<circle class="dot" cx="{axis.x(bound.observed):.1f}" cy="{y}" r="5"/>'
        f'<text class="value" x="{WIDTH - 2}" y="{y + 4}">{digits(bound.observed)} {sign} {bound.certified:.3g}</text>'
    )


def digits(value: float) -> str:
    """Return three digits, trailing zeros included, or all digits before the point."""
    return f"{value:.0f}" if value >= 1000.0 else f"{value:#.3g}".rstrip(".")


def _number(value: float) -> str:
    """Return a tick's label, small and large powers of ten with superscripts."""
    exponent = math.log10(value) if value > 0.0 else 0.0
    if exponent == round(exponent) and not -2 <= exponent <= 3:
        return "10" + str(round(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{value:g}"


def figure(title: str, content: str) -> str:
    """Return a chart with its title above."""
    return f"<figure><figcaption>{escape(title)}</figcaption>{content}</figure>"
