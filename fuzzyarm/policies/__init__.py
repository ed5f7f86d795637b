"""From a name, a file, a folder or code to a policy."""

from fuzzyarm.policies.registry import COMPARED, LEARNED, NAMES, load_policy

__all__ = ["COMPARED", "LEARNED", "NAMES", "load_policy"]
