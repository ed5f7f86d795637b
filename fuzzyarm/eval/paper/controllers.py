"""The controllers of section 6.2, and two more that explain why our numbers differ from the paper's.

"Printed form" is Theorem 1 or 2 with integral action, the paper's α and Q, one multiplier for all dropped premises of A
and the bound (24), with the smallest L that the inequalities allow, 0. "Consistent form" is the form of this project,
see `fuzzy_policy.proof.consistent_reference`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from importlib import resources
from typing import Any, cast

import numpy as np

from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.policies import load_policy

__all__ = [
    "FEW", "FORMS", "MANY", "PAPERS_OWN", "PAPER_H", "PAPER_K", "PAPER_L", "RULES", "SWAPPED", "TITLES",
    "compared_policies", "key_of",
]  # fmt: skip

MANY, FEW = RULES = (32, 4)
"""Numbers of rules of the controllers that the paper compares."""
FORMS = ("printed", "consistent")
"""Forms of Theorem 2: as the paper prints it, and with a consistent feedforward."""
_FILES = {"printed-32": "paper-32-integral.json", "printed-4": "paper-4-integral-common.json"}
_POLICIES = {"consistent-32": "fuzzy-32", "consistent-4": "fuzzy-4"}
SWAPPED = "printed-4-swapped"
"""Key of the printed form's controller with the feedforward of the consistent form."""
PAPERS_OWN = "papers-gains"
"""Key of the controller with the gains that the paper prints."""
TITLES: Mapping[str, str] = {
    "printed-32": "printed form, 32 rules",
    "printed-4": "printed form, 4 rules",
    "consistent-32": "consistent form, 32 rules",
    "consistent-4": "consistent form, 4 rules",
    SWAPPED: "printed form's K and H, consistent form's L, 4 rules",
    PAPERS_OWN: "the paper's own K_1k, H_1k, L_1k, 4 rules",
}
"""Titles of the controllers by their key: `key_of` for the first four."""

# Gains printed in section 6.2 for i = 1 and k = 1, 2. H gets the sign of K, see "Reading of the paper" in the README.
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


def key_of(form: str, rules: int) -> str:
    """Return the key of the controller of a form in `FORMS` with a number of rules in `RULES`."""
    return f"{form}-{rules}"


def compared_policies() -> dict[str, FuzzyPolicy]:
    """Return the policies by their key in `TITLES`; the first four are proven while they are loaded."""
    found: dict[str, Any] = {}
    for key, name in _FILES.items():
        with resources.as_file(resources.files("fuzzyarm.fuzzy_policy.controllers") / name) as path:
            found[key] = load_policy(path)
    found |= {key: load_policy(name) for key, name in _POLICIES.items()}
    policies = cast(dict[str, FuzzyPolicy], found)
    printed, consistent = (policies[key_of(form, FEW)].controller for form in FORMS)
    # Theorem 2 also proves this law, with P, Q and X of the printed form's file but a larger γ, see `evidence`.
    swapped = dataclasses.replace(printed, feedforward=consistent.feedforward_gains)
    # This law is not proven. The paper prints the gains for i = 1 only, so they are used for i = 2 as well. Its E_p1 is
    # the vertex of the smallest z1, as is ours.
    papers = dataclasses.replace(
        printed,
        gains=np.stack([np.concatenate([PAPER_K, PAPER_H], axis=-1)] * 2),
        feedforward=np.stack([PAPER_L] * 2),
    )
    policies |= {SWAPPED: FuzzyPolicy(swapped), PAPERS_OWN: FuzzyPolicy(papers)}
    for policy in policies.values():
        policy.integral_at = None  # the paper's law does not hold the integral at the torque limits
    return policies
