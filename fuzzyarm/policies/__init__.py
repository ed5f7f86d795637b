"""From a name, a file, a folder or code to a policy."""

from fuzzyarm.policies.registry import COMPARED, LEARNED, NAMES, Kind, add_policy
from fuzzyarm.policies.spec import PolicySpec, load_policy, resolve, resolve_all

__all__ = [
    "COMPARED",
    "LEARNED",
    "NAMES",
    "Kind",
    "PolicySpec",
    "add_policy",
    "load_policy",
    "resolve",
    "resolve_all",
]
