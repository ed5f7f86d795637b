"""API pages from the docstrings: a page a module, written to ``docs/api`` before Sphinx reads its sources.

The index lists the modules; they stand in no table of contents, which every page of the documentation would repeat.
Docstrings here are Markdown with Google's sections, and so are the pages: text, tables and equations go over as they
are, the sections become lists. The code is read by griffe, not run.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import griffe
from sphinx.application import Sphinx

PACKAGE = "fuzzyarm"


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages when a build begins."""
    app.connect("builder-inited", lambda app: write_pages(Path(app.srcdir) / "api"))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write_pages(folder: Path) -> None:
    """Write a page for each public module and an index; pages that are as they were keep their time."""
    modules = sorted((module for module in _modules(griffe.load(PACKAGE)) if module.exports), key=lambda one: one.path)
    pages = {folder / f"{module.path}.md": module_page(module) for module in modules}
    pages[folder / "index.md"] = index_page(modules)
    for stale in set(folder.glob("*.md")) - set(pages):
        stale.unlink()
    for path, text in pages.items():
        path.parent.mkdir(exist_ok=True)
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def _modules(module: griffe.Module) -> Iterator[griffe.Module]:
    yield module
    for inner in module.modules.values():
        if not inner.is_alias:
            yield from _modules(inner)


def index_page(modules: list[griffe.Module]) -> str:
    """Return the index: every public module with the first sentence of its docstring, room by room."""
    lines = ["# API", "", "Every public name, module by module. What is not listed here may change without notice.", ""]
    rooms: dict[str, list[griffe.Module]] = {}
    for module in modules:
        rooms.setdefault(".".join(module.path.split(".")[: 3 if module.path.count(".") > 2 else 2]), []).append(module)
    for room, members in rooms.items():
        lines += [f"## `{room}`", "", "| module | |", "| --- | --- |"]
        lines += [f"| [`{module.path}`]({module.path}.md) | {_cell(_first_sentence(module))} |" for module in members]
        lines.append("")
    return "\n".join(lines)


def _first_sentence(module: griffe.Module) -> str:
    text = module.docstring.value if module.docstring else ""
    return text.split("\n\n")[0].replace("\n", " ")


def module_page(module: griffe.Module) -> str:
    """Return the page of a module: its docstring, then its public names in their order."""
    parts = ["---\norphan: true\n---", "[API](index.md)", f"# `{module.path}`", _docstring(module, 1)]
    for name in module.exports or []:
        member = module.members.get(str(name))
        if member is None:  # griffe does not see names that one statement assigns together
            label = f"api-{module.path}.{name}".lower()
            parts.append(f"({label})=\n## `{name}`\n\nA generated function; the module's text says what it is for.")
        else:
            parts.append(_member(member, 2))
    return "\n\n".join(part for part in parts if part) + "\n"


def _member(member: Any, level: int) -> str:
    if member.is_alias:  # documented where it is defined
        target = member.final_target
        text = target.docstring.value.split("\n\n")[0] if target.docstring else ""
        page = f"[`{target.path}`]({target.module.path}.md#{_label(target)})"
        return f"({_label(member)})=\n{'#' * level} `{member.name}`\n\n{text} See {page}."
    target = member
    heading = f"({_label(member)})=\n{'#' * level} `{member.name}`"
    parts = [heading, _signature(target), _docstring(target, level)]
    if target.is_class:
        methods = [
            inner
            for name, inner in target.members.items()
            if not name.startswith("_") and (inner.is_function or (inner.is_attribute and "property" in inner.labels))
        ]
        parts += [_member(inner, level + 1) for inner in methods if inner.docstring or inner.is_function]
    return "\n\n".join(part for part in parts if part)


def _label(member: Any) -> str:
    # Labels do not tell capitals from small letters, names do.
    kind = "-class" if member.is_class else "-data" if member.is_attribute else ""
    return f"api-{member.path}{kind}".lower()


def _signature(target: Any) -> str:
    if target.is_function or target.is_class:
        parameters = [p for p in target.parameters if p.name not in ("self", "cls")]
        text = ", ".join(_parameter(p) for p in parameters)
        back = f" -> {target.returns}" if target.is_function and target.returns is not None else ""
        line = f"{target.name}({text}){back}"
        if len(line) > 88:
            inner = "".join(f"    {_parameter(p)},\n" for p in parameters)
            line = f"{target.name}(\n{inner}){back}"
        return f"```python\n{line}\n```"
    if target.is_attribute:
        value = "" if target.value is None or len(str(target.value)) > 200 else f" = {target.value}"
        kind = "" if target.annotation is None else f": {target.annotation}"
        return f"```python\n{target.name}{kind}{value}\n```" if kind or value else ""
    return ""


def _parameter(parameter: Any) -> str:
    stars = {griffe.ParameterKind.var_positional: "*", griffe.ParameterKind.var_keyword: "**"}
    text = stars.get(parameter.kind, "") + parameter.name
    if parameter.annotation is not None:
        text += f": {parameter.annotation}"
    if parameter.default is not None and not stars.get(parameter.kind):
        default = str(parameter.default)
        text += f" = {default if len(default) <= 60 else '...'}"
    return text


def _docstring(target: Any, level: int) -> str:
    if not target.docstring:
        return ""
    parts = []
    for section in target.docstring.parse("google", warnings=False):
        if section.kind is griffe.DocstringSectionKind.text:
            parts.append(
                re.sub(r"^(#+) ", lambda match: "#" * (level + len(match[1]) - 1) + " ", section.value, flags=re.M)
            )
        elif section.kind is griffe.DocstringSectionKind.examples:
            blocks = [
                text if kind is griffe.DocstringSectionKind.text else f"```pycon\n{text}\n```"
                for kind, text in section.value
            ]
            parts += ["**Examples**", *blocks]
        elif section.kind is griffe.DocstringSectionKind.admonition:
            parts.append(f"**{section.title}** {section.value.description}")
        else:
            parts += [f"**{section.kind.value.capitalize()}**", "\n".join(map(_entry, section.value))]
    return "\n\n".join(parts)


def _entry(entry: Any) -> str:
    """Return a line of a list: a name, a type, or both, and what it is."""
    name, annotation = getattr(entry, "name", ""), entry.annotation
    head = f"`{name}`" if name else f"`{annotation}`" if annotation else ""
    description = entry.description.replace("\n", "\n  ")
    return f"- {head}{': ' if head else ''}{description}"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def clean(folder: Path) -> None:
    """Remove what `write_pages` wrote."""
    shutil.rmtree(folder, ignore_errors=True)
