"""Controller files of every form: which one a file is of."""

from __future__ import annotations

from pathlib import Path

from fuzzyarm.common.documents import DocumentError, read_json
from fuzzyarm.fuzzy_policy.controller import MAX_BYTES, Controller, ControllerFileError
from fuzzyarm.fuzzy_policy.scheduled import SCHEMA, ScheduledController

__all__ = ["load_controller"]


def load_controller(path: str | Path) -> Controller | ScheduledController:
    """Read a controller file of any form.

    Raises:
        ControllerFileError: not a controller file, of another version, damaged, or inconsistent.
        OSError: the file cannot be read.
    """
    try:
        content = read_json(Path(path), largest=MAX_BYTES)
    except DocumentError as error:
        raise ControllerFileError(str(error)) from None
    schema = content.get("schema") if isinstance(content, dict) else None
    return ScheduledController.load(path) if schema == SCHEMA else Controller.load(path)
