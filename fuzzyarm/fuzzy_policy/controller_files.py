"""Controller files of every form: which one a file is of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.scheduled import SCHEMA, ScheduledController
from fuzzyarm.fuzzy_policy.signed_files import controller_in

__all__ = ["load_controller"]


def load_controller(path: str | Path) -> Controller | ScheduledController:
    """Read a controller file of any form; ControllerFileError if it is damaged, OSError if it is unreadable."""

    def build(content: Any) -> Controller | ScheduledController:
        form = ScheduledController if isinstance(content, dict) and content.get("schema") == SCHEMA else Controller
        return form.from_document(content)

    return controller_in(path, build)
