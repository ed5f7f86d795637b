"""API pages of the documented names, from their docstrings, written to ``docs/api`` before Sphinx reads its sources.

Documented are the classes of the environments and the names of ``fuzzyarm.__all__``; nothing else is promised.
Docstrings here are Markdown with Google's sections, and so are the pages: text, tables and equations go over as they
are, the sections become lists. The code is read by griffe, not run.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import griffe
from sphinx.application import Sphinx

PAGES = {
    "Environments": "envs.fuzzy_arm.FuzzyArmEnv envs.vector.FuzzyArmVectorEnv"
    " rl_baselines.learning_task.FuzzyArmLearnEnv rl_baselines.learning_task.FuzzyArmLearnVectorEnv"
    " rl_baselines.torch_env.TorchFuzzyArm"
    " rl_baselines.torch_learn.TorchFuzzyArmLearn",
    "Policies and episodes": "load_policy add_policy run_episode Rollout metrics_of sheet_of export_c",
    "Evaluations": "EvaluationConfig evaluate write_results write_figures write_report SweepConfig Sweep Engine"
    " MarginsConfig measure_margins BenchConfig run_bench",
    "Arms": "ArmParameters Robot robot_named read_log identify tune_arm",
    "Design and proof": "TSModel Specification design Design DesignFailed DesignProblem ScheduledSpecification"
    " design_scheduled Controller certify verify_file TipClaim find_bound save_bound",
}
"""The names on each page: of ``fuzzyarm``, or with their module below it."""


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages when a build begins."""
    app.connect("builder-inited", lambda app: write_pages(Path(app.srcdir) / "api"))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write_pages(folder: Path) -> None:
    """Write a page for each group of names and an index; pages that are as they were keep their time."""
    package = griffe.load("fuzzyarm")
    groups = {title: [_found(package, name) for name in names.split()] for title, names in PAGES.items()}
    pages = {
        folder / f"{_page(title)}.md": "\n\n".join([f"# {title}", *(_member(one, 2) for one in members)]) + "\n"
        for title, members in groups.items()
    }
    pages[folder / "index.md"] = _index(groups)
    for stale in set(folder.glob("*.md")) - set(pages):
        stale.unlink()
    for path, text in pages.items():
        path.parent.mkdir(exist_ok=True)
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def _found(package: Any, name: str) -> Any:
    member = package[name]
    return member.final_target if member.is_alias else member


def _page(title: str) -> str:
    return title.lower().replace(" ", "-")


def _index(groups: dict[str, list[Any]]) -> str:
    """Return the index: every documented name with the first sentence of its docstring."""
    lines = [
        "# Python API",
        "",
        "These names keep their meaning between versions. Names of `fuzzyarm` are imported from there; the classes of",
        "the environments are behind `gym.make` and `gym.make_vec`. Whatever is not listed may change without notice.",
        "",
        "```{toctree}\n:hidden:\n",
        *map(_page, groups),
        "```",
    ]
    for title, members in groups.items():
        lines += ["", f"## {title}", "", "| name | |", "| --- | --- |"]
        lines += [f"| [`{one.name}`]({_page(title)}.md#{_label(one)}) | {_first_sentence(one)} |" for one in members]
    return "\n".join(lines) + "\n"


def _first_sentence(member: Any) -> str:
    text = member.docstring.value if member.docstring else ""
    return text.split("\n\n")[0].replace("\n", " ").replace("|", "\\|")


def _member(target: Any, level: int) -> str:
    heading = f"({_label(target)})=\n{'#' * level} `{target.name}`"
    own = target.path.removeprefix("fuzzyarm.") in " ".join(PAGES.values()).split()  # it is not a name of `fuzzyarm`
    origin = f"`from {target.parent.path} import {target.name}`" if own else ""
    parts = [heading, origin, _signature(target), _docstring(target, level)]
    if target.is_class:
        inner = (member for name, member in target.members.items() if not name.startswith("_"))
        methods = (one for one in inner if one.is_function or (one.is_attribute and "property" in one.labels))
        parts += [_member(one, level + 1) for one in methods if one.docstring]
    return "\n\n".join(part for part in parts if part)


def _label(member: Any) -> str:
    return f"api-{member.path.removeprefix('fuzzyarm.')}{'-class' if member.is_class else ''}".lower()


def _signature(target: Any) -> str:
    if not (target.is_function or target.is_class):
        return ""
    parameters = [_parameter(one) for one in target.parameters if one.name not in ("self", "cls")]
    back = f" -> {target.returns}" if target.is_function and target.returns is not None else ""
    line = f"{target.name}({', '.join(parameters)}){back}"
    if len(line) > 88:
        line = f"{target.name}(\n{''.join(f'    {one},' + chr(10) for one in parameters)}){back}"
    return f"```python\n{line}\n```"


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
    parts = []
    for section in target.docstring.parse("google", warnings=False) if target.docstring else ():
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
