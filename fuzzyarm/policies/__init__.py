"""Loading of policies by name or from a file, a folder or code."""

from fuzzyarm.policies.registry import ANY_ROBOT, COMPARED, LEARNED, NAMES, Kind, add_policy
from fuzzyarm.policies.spec import PolicySpec, found_again, load_policy, recorded, resolve, resolve_all
from fuzzyarm.policies.tuned import policies_of

__all__ = [
    "ANY_ROBOT", "COMPARED", "LEARNED", "NAMES", "Kind", "PolicySpec", "add_policy", "found_again", "load_policy",
    "policies_of", "recorded", "resolve", "resolve_all",
]  # fmt: skip
