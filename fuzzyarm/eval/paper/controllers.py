"""The controllers of section 6.2, and two more that tell why ours differ.

"Printed form" is Theorem 1 or 2 with integral action, the paper's α and Q, one multiplier for all dropped premises of A
and the bound (24); "consistent form" is this project's `fuzzy_policy.consistent_reference`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from importlib import resources
from typing import Any, cast

import numpy as np

from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.policies import load_policy

RULES = (32, 4)
FORMS = ("printed", "consistent")
FILES = {"printed-32": "paper-32-integral.json", "printed-4": "paper-4-integral-common.json"}
CONSISTENT = {"consistent-32": "fuzzy-32", "consistent-4": "fuzzy-4"}
SWAPPED = "printed-4-swapped"
PAPERS_OWN = "papers-gains"
TITLES: Mapping[str, str] = {
    "printed-32": "printed form, 32 rules",
    "printed-4": "printed form, 4 rules",
    "consistent-32": "consistent form, 32 rules",
    "consistent-4": "consistent form, 4 rules",
    SWAPPED: "printed form's K and H, consistent form's L, 4 rules",
    PAPERS_OWN: "the paper's own K_1k, H_1k, L_1k, 4 rules",
}

# Section 6.2, k = 1 and 2. H with the sign of K (README, "Reading of the paper").
PAPER_K = np.array(
    [
        [[-6.31e4, 1.16e4, -978.0, -18.0], [0.91e4, -6.513e4, 44.0, -591.0]],
        [[-9.73e3, -1.74e3, -469.0, -89.6], [-1.89e3, -3.76e3, -96.8, -162.0]],
    ]
)
PAPER_H = -np.array([[[0.720e4, 0.939e4], [0.939e4, 4.62e4]], [[312.0, 159.0], [152.0, 30.2]]])
PAPER_L = np.array(
    [
        [[14.7, -1.13, 0.47, -0.04, 0.004, -3e-4], [-6.37, 15.2, -0.21, 0.49, -0.002, 3.9e-4]],
        [[12.3, 0.634, 0.395, 0.0205, 0.0032, 0.0002], [3.82, 11.8, 0.123, 0.380, 0.0010, 0.0031]],
    ]
)


def compared_policies() -> dict[str, FuzzyPolicy]:
    """Return the policies by their key in `TITLES`; the first four are proven while they load."""
    found: dict[str, Any] = {}
    for key, name in FILES.items():
        with resources.as_file(resources.files("fuzzyarm.fuzzy_policy.controllers") / name) as path:
            found[key] = load_policy(path)
    found |= {key: load_policy(name) for key, name in CONSISTENT.items()}
    policies = cast(dict[str, FuzzyPolicy], found)
    printed, consistent = (policies[f"{form}-4"].controller for form in FORMS)
    # Theorem 2 proves this one too, with the file's P, Q and X, but at another γ than the file's (`evidence`).
    swapped = dataclasses.replace(printed, feedforward=consistent.feedforward_gains)
    # Not proven. The paper prints i = 1 only; E_p1 is its vertex of the smallest z1, which is ours as well.
    papers = dataclasses.replace(
        printed,
        gains=np.stack([np.concatenate([PAPER_K, PAPER_H], axis=-1)] * 2),
        feedforward=np.stack([PAPER_L] * 2),
    )
    return policies | {SWAPPED: FuzzyPolicy(swapped), PAPERS_OWN: FuzzyPolicy(papers)}
