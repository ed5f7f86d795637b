"""Equations as SVG, drawn while the pages are built: no script, no font and no network in the browser."""

from __future__ import annotations

import re
from html import escape
from typing import Any

import ziamath
from docutils import nodes
from sphinx.application import Sphinx

SIZE = 18  # px; a little above the text, whose letters are wider


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer ``svg``."""
    app.add_html_math_renderer("svg", inline_renderers=(_inline, None), block_renderers=(_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _inline(translator: Any, node: nodes.math) -> None:
    equation = ziamath.Latex(node.astext(), size=SIZE, inline=True, color="currentColor")
    style = f"vertical-align: {equation.getyofst():.2f}px"
    _append(translator, equation, node.astext(), f'class="equation" style="{style}"')
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    equation = ziamath.Latex(node.astext(), size=SIZE, inline=False, color="currentColor")
    translator.body.append('<div class="math">')
    _append(translator, equation, node.astext(), "")
    translator.body.append("</div>\n")
    raise nodes.SkipNode


def _append(translator: Any, equation: ziamath.Latex, latex: str, attributes: str) -> None:
    """Append a picture with its LaTeX as the text that a screen reader speaks, and letters with names of their own."""
    svg = re.sub(r'(\bid="|href="#)', rf"\g<1>e{len(translator.body)}-", equation.svg())
    translator.body.append(svg.replace("<svg ", f'<svg role="img" aria-label="{escape(latex)}" {attributes} ', 1))
