"""The directive ``results``: a table made from the stored results, at build time.

```{results} margins
```
"""

from __future__ import annotations

import functools
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


class Results(SphinxDirective):
    """A section of ``benchmarks/readme.py`` by name, parsed as Markdown."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the parsed table and the line that says how it was made."""
        from readme import RESULTS

        for path in (*RESULTS.glob("*.json"), *RESULTS.parent.glob("studies/*.md")):
            self.env.note_dependency(str(path))
        return self.parse_text_to_nodes(_sections()[self.arguments[0]])


@functools.cache
def _sections() -> dict[str, str]:
    """Return all sections, made once in a build."""
    from readme import sections

    return sections()


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("results", Results)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
