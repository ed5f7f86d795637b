"""The controller files that the package holds, its own and those of the paper's reproduction."""

from pathlib import Path

import fuzzyarm

CONTROLLERS = {path.stem: path for path in Path(fuzzyarm.__file__).parent.rglob("controllers/*.json")}
"""Files by their names without the ending."""
