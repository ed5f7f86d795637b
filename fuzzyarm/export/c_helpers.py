"""C functions of the exported programs that do what Python does by itself or by its library, to the bit."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable

__all__ = ["HELPERS", "ROLLED", "helper_text"]

ROLLED = {
    "add_product": """/* Adds G x to y; G is given by columns, so that no sum runs over the rows. */
static void add_product(const {real} *x, int x_size, const {real} *transposed, int columns, {real} *y, int y_size)
{{
    int k;
    int j;
    for (k = 0; k < x_size; k++) {{
        for (j = 0; j < y_size; j++) {{
            y[j] = y[j] + (transposed[(k * columns) + j] * x[k]);
        }}
    }}
}}
""",
}
"""By name, the functions of arrays that keep their loops; see `learned_policy.functions`."""

HELPERS = {
    "rint": """/* The nearest whole number, the even one of two; exact. */
static {real} rint_({real} x)
{{
    const {real} large = {large};
    {real} result = x;
    if ((x > -large) && (x < large)) {{
        result = (x > {zero}) ? ((x + large) - large) : ((x - large) + large);
        if (result == {zero}) {{
            result = x * {zero};
        }}
    }}
    return result;
}}
""",
    "floor": """/* The largest whole number that is not above x; exact. */
static {real} floor_({real} x)
{{
    const {real} nearest = rint_(x);
    return (nearest > x) ? (nearest - {one}) : nearest;
}}
""",
    "abs": """static {real} abs_({real} x)
{{
    return (x <= {zero}) ? ({zero} - x) : x;
}}
""",
    "sign": """static {real} sign_({real} x)
{{
    return (x > {zero}) ? {one} : ((x < {zero}) ? -{one} : ((x == {zero}) ? {zero} : x));
}}
""",
    "sqrt": """/* The square root, rounded correctly: y = x/scale^2 in [1, 4), Newton, exact residual y - r^2. */
static {real} sqrt_({real} x)
{{
    static const {real} power[{steps}] = {{
{powers}
    }};
    static const {real} root[{steps}] = {{
{roots}
    }};
    const {real} unit = {epsilon}_EPSILON;
    {real} result = x;
    if ((x > {zero}) && (x <= {epsilon}_MAX)) {{
        const _Bool tiny = x < {epsilon}_MIN;
        {real} scale = tiny ? {drop} : {one};
        {real} y = tiny ? (x * {lift}) : x;
        {real} r;
        {real} high;
        {real} low;
        {real} residual;
        int k;
        for (k = 0; k < {steps}; k++) {{
            if (y >= power[k]) {{
                y = y * ({one} / power[k]);
                scale = scale * root[k];
            }}
            if ((y * power[k]) < {four}) {{
                y = y * power[k];
                scale = scale * ({one} / root[k]);
            }}
        }}
        r = {half} + ({half} * y);
        for (k = 0; k < 5; k++) {{
            r = {half} * (r + (y / r));
        }}
        high = {split} * r;
        high = high - (high - r);
        low = r - high;
        residual = ((y - (high * high)) - ({two} * (high * low))) - (low * low);
        if (residual > (r * unit)) {{
            r = r + unit;
        }} else if (residual <= -(r * unit)) {{
            r = r - unit;
        }} else {{
            /* r is the nearest number. */
        }}
        result = r * scale;
    }} else if (x < {zero}) {{
        result = (x - x) / (x - x);
    }} else {{
        /* 0, infinity and what is no number stay so. */
    }}
    return result;
}}
""",
    "whole": """/* x without its fraction; what is no small number becomes -32767. */
static int whole_({real} x)
{{
    return ((x > {low}) && (x < {high})) ? (int)x : -32767;
}}
""",
}
"""By operation, the C function that does it without a library; `floor` needs `rint`."""


def helper_text(operation: str, real: str, literal: Callable[[float], str]) -> str:
    """Return the C function of an operation.

    Args:
        operation: a key of `HELPERS`.
        real: "double" or "float".
        literal: writes a number of this type.
    """
    digits, steps = {"double": (53, 9), "float": (24, 6)}[real]
    exponents = [2**step for step in range(steps, 0, -1)]
    lift = 2 * (digits // 2 + 1)
    numbers = {
        **{"zero": 0.0, "half": 0.5, "one": 1.0, "two": 2.0, "four": 4.0, "low": -32768.0, "high": 32768.0},
        **{"large": 2.0 ** (digits - 1), "split": 2.0 ** (digits - digits // 2) + 1.0},
        **{"lift": 2.0**lift, "drop": 2.0 ** (-lift // 2)},
    }
    lists = {
        "powers": _lines(literal(2.0**exponent) for exponent in exponents),
        "roots": _lines(literal(2.0 ** (exponent // 2)) for exponent in exponents),
    }
    words = {"real": real, "steps": str(steps), "epsilon": {"double": "DBL", "float": "FLT"}[real]}
    return HELPERS[operation].format(**words, **lists, **{name: literal(number) for name, number in numbers.items()})


def _lines(texts: Iterable[str]) -> str:
    indent = " " * 8
    return textwrap.fill(", ".join(texts), 100, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)
