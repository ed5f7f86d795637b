"""Controllers shipped with the package; see `fuzzyarm.fuzzy_policy.controller` for the format."""
