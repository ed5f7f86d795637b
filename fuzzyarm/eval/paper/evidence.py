"""The rollouts and proofs from which both the numbers and the figures are made; they are run once.

The controllers are those of section 6.2, and two more that explain why our numbers differ from the paper's.
"Printed form" is Theorem 1 or 2 with integral action, the paper's α and Q, one multiplier for all dropped premises of A
and the bound (24), with the smallest L that the inequalities allow, 0. "Consistent form" is the form of this project,
see `proof.theorems`.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.arithmetic import last_that_works
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.rollout import Rollout, record_rollout
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.policies import load_policy
from fuzzyarm.proof.certificate import certify

__all__ = [
    "FEW", "FORMS", "HIGH_GAIN", "MANY", "PAPERS_OWN", "PAPER_K", "PAPER_L", "RULES", "STEPS", "SWAPPED", "TITLES",
    "WITNESSES", "Evidence", "gather", "key_of", "prove_witnesses",
]  # fmt: skip


MANY, FEW = RULES = (32, 4)
"""Numbers of rules of the controllers that the paper compares."""
FORMS = ("printed", "consistent")
"""Forms of Theorem 2: as the paper prints it, and with a consistent feedforward."""
_CONTROLLERS = Path(__file__).with_name("controllers")
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
_PAPER_H = -np.array([[[0.720e4, 0.939e4], [0.939e4, 4.62e4]], [[312.0, 159.0], [152.0, 30.2]]])
PAPER_L = np.array(
    [
        [[14.7, -1.13, 0.47, -0.04, 0.004, -3e-4], [-6.37, 15.2, -0.21, 0.49, -0.002, 3.9e-4]],
        [[12.3, 0.634, 0.395, 0.0205, 0.0032, 0.0002], [3.82, 11.8, 0.123, 0.380, 0.0010, 0.0031]],
    ]
)


def key_of(form: str, rules: int) -> str:
    """Return the key of the controller of a form in `FORMS` with a number of rules in `RULES`."""
    return f"{form}-{rules}"


def _compared_policies() -> dict[str, FuzzyPolicy]:
    """Return the policies by their key in `TITLES`; the first four are proven while they are loaded."""
    policies: dict[str, Any] = {key: load_policy(_CONTROLLERS / name) for key, name in _FILES.items()}
    policies |= {key: load_policy(name) for key, name in _POLICIES.items()}
    printed, consistent = (policies[key_of(form, FEW)].controller for form in FORMS)
    # Theorem 2 also proves this law, with P, Q and X of the printed form's file but a larger γ, see `evidence`.
    swapped = dataclasses.replace(printed, feedforward=consistent.feedforward_gains)
    # This law is not proven. The paper prints the gains for i = 1 only, so they are used for i = 2 as well. Its E_p1 is
    # the vertex of the smallest z1, as is ours.
    papers = dataclasses.replace(
        printed,
        gains=np.stack([np.concatenate([PAPER_K, _PAPER_H], axis=-1)] * 2),
        feedforward=np.stack([PAPER_L] * 2),
    )
    policies |= {SWAPPED: FuzzyPolicy(swapped), PAPERS_OWN: FuzzyPolicy(papers)}
    for policy in policies.values():
        policy.integral_at = None  # the paper's law does not hold the integral at the torque limits
    return policies


WITNESSES = tuple(
    f"paper-{rules}{integral}{common}"
    for rules, integral, common in itertools.product((4, 2, 1), ("", "-integral"), ("", "-common"))
)
"""Controller files that show Theorem 2 to be feasible with 4, 2 and 1 rules.

They come with and without integral action, and with one multiplier for all dropped premises of A or one for each.
"""
HIGH_GAIN = "paper-4-common-high-gain"
"""The controller file that was designed without the bound (24)."""
_OTHER_FEEDFORWARDS = {"the consistent form's L": SWAPPED, "the paper's L_1k": PAPERS_OWN}
"""Labels of `Evidence.gamma_with`, and the controllers whose L is used."""
STEPS = 1 + len(PAPER_CASES) * len(TITLES) + len((*WITNESSES, HIGH_GAIN)) + len(_OTHER_FEEDFORWARDS)
"""How often `gather` reports progress: once for loading, then for each rollout, each witness and each γ."""


@dataclasses.dataclass(frozen=True)
class Evidence:
    """What the claims are measured from.

    `gamma_with` is the smallest γ, to 1 %, at which the printed form with 4 rules is proven with another L, by whose L
    it is; P, Q, X, τ and M stay those of its file. With its own L it is proven at γ = 1000.
    """

    reference: JointReference  # the paper's motion
    controllers: Mapping[str, Controller]  # by key of `TITLES`
    rollouts: Mapping[tuple[str, str], Rollout]  # by key of the controller and case
    witnesses: Mapping[str, Controller]  # controllers of the paper's form by the name of their file
    proven: frozenset[str]  # witnesses whose inequalities have all been proven, in exact arithmetic, in this run
    gamma_with: Mapping[str, float]


def gather(progress: Callable[[], None] | None = None) -> Evidence:
    """Run every controller in the paper's cases and prove the witnesses; `progress` is called `STEPS` times."""
    step = progress or (lambda: None)
    policies, reference, rollouts = _compared_policies(), JointReference(), {}
    step()
    for case in PAPER_CASES:
        env = FuzzyArmEnv(case=case, reference=reference)
        for key, policy in policies.items():
            rollouts[key, case] = record_rollout(env, policy, policy_name=key, case=case, seed=0)
            step()
    witnesses, proven = prove_witnesses(step)
    controllers = {key: policy.controller for key, policy in policies.items()}
    gamma_with = {}
    for label, key in _OTHER_FEEDFORWARDS.items():
        law = dataclasses.replace(controllers[key_of("printed", FEW)], feedforward=controllers[key].feedforward)
        gamma_with[label] = _smallest_gamma(law)
        step()
    return Evidence(reference, controllers, rollouts, witnesses, proven, gamma_with)


def prove_witnesses(step: Callable[[], None]) -> tuple[dict[str, Controller], frozenset[str]]:
    """Return the witnesses by name, and the names of those that are proven; `step` is called after each."""
    witnesses, proven = {}, set()
    for name in (*WITNESSES, HIGH_GAIN):
        witnesses[name] = Controller.load(_CONTROLLERS / f"{name}.json")
        if certify(witnesses[name]).proven:
            proven.add(name)
        step()
    return witnesses, frozenset(proven)


def _smallest_gamma(controller: Controller) -> float:
    """Return the smallest γ in [1e2, 1e5] at which a controller is proven, to 1 %; infinite if not even 1e5 is."""

    def proven(gamma: float) -> bool:
        return certify(dataclasses.replace(controller, gamma=gamma)).proven

    if not proven(1e5):
        return math.inf
    found = last_that_works(proven, good=1e5, bad=1e2, resolution=0.01)
    assert found is not None  # without a limit there always is one
    return found
