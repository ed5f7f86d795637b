"""The page of the command line, written from the options' dataclasses before Sphinx reads its sources."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from fuzzyarm.cli.application import GROUPS, command_line
from fuzzyarm.cli.options import arguments_of

HEAD = """# Command line

`fuzzyarm COMMAND --help` shows what stands on this page. Exit codes: 0 fine; 1 a result that fails, such as an episode
that ended early or an infeasible design; 2 bad usage, with one line that says what to change; 130 interrupted; 141 the
reader of a pipe has left. `fuzzyarm --install-completion` installs completion for bash, zsh or fish.
"""


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the page when a build begins."""
    app.connect("builder-inited", lambda app: write_page(Path(app.srcdir) / "command-line.md"))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write_page(path: Path) -> None:
    """Write the page, unless it is as it was."""
    groups = [
        f"- {heading}: {', '.join(f'[`{name}`](#fuzzyarm-{name})' for name in commands)}"
        for heading, commands in GROUPS.items()
    ]
    generated = command_line().generate_docs(output_format="markdown", recursive=True)
    commands = generated[generated.index("## fuzzyarm evaluate") : generated.index("## fuzzyarm --install-completion")]
    text = "\n".join([HEAD, *groups, "", re.sub(r"\n {4,}(?=\S)", " ", commands)])  # a text in one line
    for lines in GROUPS.values():
        for name, line in lines.items():
            text = _described(text, name, line)
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _described(text: str, name: str, line: str) -> str:
    """Return the page with what the command's own help says: its arguments, and more than its line in the list."""
    options = getattr(importlib.import_module(f"fuzzyarm.cli.{name}"), "Options", None)
    if options is None:
        return text
    arguments = arguments_of(options)
    text = text.replace(f"fuzzyarm {name} [OPTIONS]\n", f"fuzzyarm {name} [OPTIONS] {arguments}".rstrip() + "\n")
    return text.replace(f"\n{line}\n\n**", f"\n{inspect.getdoc(options)}\n\n**")
