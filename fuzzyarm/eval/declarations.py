"""What policies declare about themselves in results files, see `policies.declared`; and which user code may run."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from fuzzyarm.common.checks import listed
from fuzzyarm.common.console import Sheet
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.policies import Kind, recorded, resolve
from fuzzyarm.policies.declared import HEADINGS, Declared, declared, declared_by_name, stated
from fuzzyarm.policies.spec import PolicySpec

__all__ = [
    "ROW", "declarations_of", "declared_cells", "print_declared", "read_declarations", "unrelated",
    "written_declarations",
]  # fmt: skip

ROW = ("policy", *HEADINGS)
"""Headings of `declared_cells` with the policy in front."""


def declarations_of(
    specs: Mapping[str, PolicySpec], policies: Mapping[str, Any], arm: AnyArm, passes: int = 1
) -> dict[str, Declared | None]:
    """Return each loaded policy's declaration by label, None without one; `arm` and `passes` are as for `declared`."""
    return {label: declared(spec, policies[label], passes, arm) for label, spec in specs.items()}


def written_declarations(found: Mapping[str, Declared | None]) -> dict[str, dict[str, str] | None]:
    """Return declarations by label as results files contain them: mappings of texts, or None."""
    return {label: None if own is None else own._asdict() for label, own in found.items()}


def read_declarations(written: Mapping[str, Any] | None, names: Sequence[str]) -> dict[str, Declared | None]:
    """Return the declarations `written` in a file (None in older ones); ValueError if they are for other policies."""
    labels = {resolve(name).label: name for name in names}
    if written is None:
        return {label: declared_by_name(name) for label, name in labels.items()}
    if set(written) != set(labels):
        raise ValueError(f"`declared` describes {listed(written)}, but the policies that were run are {listed(labels)}")
    return {label: None if written[label] is None else stated(written[label]) for label in labels}


def unrelated(place: str, policies: Sequence[str], named: Sequence[str]) -> list[str]:
    """Return the names in `named` that match none of the `policies` of a results file.

    User code matches only the same code, a policy file any file with the same label. ValueError, whose message
    begins with `place`, unless `named` has all user code among `policies`: the file alone does not permit it to run.
    """
    specs = list(map(resolve, policies))
    code, labels = [spec.name for spec in specs if spec.kind is Kind.CODE], [spec.label for spec in specs]
    permitted = set(map(recorded, named))
    if flags := " ".join(f"--policy {name}" for name in code if recorded(name) not in permitted):
        raise ValueError(
            f"{place} that is not part of fuzzyarm and runs only if you permit it; if you trust this code, add {flags}"
        )
    others = [spec for spec in map(resolve, named) if recorded(spec.name) not in set(map(recorded, code))]
    return [one.name for one in others if one.kind is Kind.CODE or one.named or one.label not in labels]


def declared_cells(own: Declared | None) -> tuple[str, ...]:
    """Return the table cells of a declaration, in the order of `HEADINGS`; "not declared" in each for None."""
    return ("not declared",) * len(HEADINGS) if own is None else own


def print_declared(rows: Sequence[Sequence[str]], headings: Sequence[str], console: Console) -> None:
    """Print rows as blocks with one line per cell, because six columns of sentences do not fit a terminal."""
    console.print()
    fields = list(headings[1:])
    cells = [(f"  {heading}", cell) for _, *own in rows for heading, cell in zip(fields, own, strict=True)]
    groups = [policy for policy, *_ in rows for _ in fields]
    Sheet([headings[0], "declares"], cells, left=(0, 1), groups=groups, fold=True).print(console)
