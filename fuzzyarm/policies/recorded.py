"""Names of policies in files of results, which say nothing of the machine, and the policies found again from there.

A path is recorded as it was given if it is relative, and by its last part if it is absolute, in a folder of `fuzzyarm
tune` by its last two: ``computed-torque`` alone would be another policy. Together with the digests
of its files, see `PolicySpec.files`, that says which policy it was.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from fuzzyarm.policies.spec import resolve

__all__ = ["found_again", "recorded"]

_LEARNED = "policy.json"  # a file of every learned policy


def recorded(name: str) -> str:
    """Return the name of a policy as files of results hold it."""
    path = Path(name)
    if not path.is_absolute():
        return name
    return str(Path(path.parent.name) / path.name) if resolve(name).tuned else path.name


def found_again(
    names: Sequence[str], files: Mapping[str, Collection[str]], given: Sequence[str], folder: Path
) -> tuple[str, ...]:
    """Return recorded names of policies so that each can be loaded.

    A file or folder is looked for among the names that the user has given, then where the recorded name says, seen from
    the current folder, then beside the results.

    Args:
        names: as they were recorded.
        files: names of the files that each policy was made from, by label, see `PolicySpec.files`.
        given: names that the user has typed.
        folder: of the results.

    Raises:
        ValueError: a file or folder is in none of these places.
    """
    typed = {resolve(name).label: name for name in given}
    return tuple(typed.get(resolve(name).label) or _found(name, files, folder) for name in names)


def _found(name: str, files: Mapping[str, Collection[str]], folder: Path) -> str:
    """Return a name under which a recorded policy can be loaded."""
    spec = resolve(name)
    if spec.named or spec.path is None or spec.path.exists():
        return name
    beside = resolve(str(folder / name))
    if beside.path is not None and beside.path.exists():
        return beside.name
    if not {spec.path.name, _LEARNED} & set(files.get(spec.label, ())):
        return name  # loading it says that it is unknown
    raise ValueError(
        f"policy {name} is neither in the current folder nor beside the results in {folder}: put it there, or add "
        f"--policy PATH/{Path(name).name}"
    )
