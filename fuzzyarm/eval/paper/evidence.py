"""The rollouts and proofs from which both the numbers and the figures are made; they are run once."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from importlib import resources

from fuzzyarm.common.bisection import last_that_works
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.rollout import Rollout, record_rollout
from fuzzyarm.eval.paper.controllers import FEW, PAPERS_OWN, SWAPPED, TITLES, compared_policies, key_of
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.proof.certificate import certify

__all__ = ["HIGH_GAIN", "STEPS", "WITNESSES", "Evidence", "gather", "prove_witnesses", "smallest_gamma"]

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

    Attributes:
        reference: the paper's motion.
        controllers: by key of `controllers.TITLES`.
        rollouts: of each controller, by its key and the case.
        witnesses: controllers of the paper's form by the name of their file.
        proven: names of the witnesses whose inequalities have all been proven, in exact arithmetic, in this run.
        gamma_with: smallest γ, to 1 %, at which the printed form with 4 rules is proven if its L is replaced by another
            one, by whose L it is; P, Q, X, τ and M stay those of its file. With its own L it is proven at γ = 1000.
    """

    reference: JointReference
    controllers: Mapping[str, Controller]
    rollouts: Mapping[tuple[str, str], Rollout]
    witnesses: Mapping[str, Controller]
    proven: frozenset[str]
    gamma_with: Mapping[str, float]


def gather(progress: Callable[[], None] | None = None) -> Evidence:
    """Run every controller in the paper's cases and prove the witnesses; `progress` is called `STEPS` times."""
    step = progress or (lambda: None)
    policies, reference, rollouts = compared_policies(), JointReference(), {}
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
        gamma_with[label] = smallest_gamma(law)
        step()
    return Evidence(reference, controllers, rollouts, witnesses, proven, gamma_with)


def prove_witnesses(step: Callable[[], None]) -> tuple[dict[str, Controller], frozenset[str]]:
    """Return the witnesses by name, and the names of those that are proven; `step` is called after each."""
    folder = resources.files("fuzzyarm.fuzzy_policy.controllers")
    witnesses, proven = {}, set()
    for name in (*WITNESSES, HIGH_GAIN):
        with resources.as_file(folder / f"{name}.json") as path:
            witnesses[name] = Controller.load(path)
        if certify(witnesses[name]).proven:
            proven.add(name)
        step()
    return witnesses, frozenset(proven)


def smallest_gamma(controller: Controller) -> float:
    """Return the smallest γ in [1e2, 1e5] at which a controller is proven, to 1 %; infinite if not even 1e5 is."""
    low, high = 1e2, 1e5

    def proven(gamma: float) -> bool:
        return certify(dataclasses.replace(controller, gamma=gamma)).proven

    if not proven(high):
        return math.inf
    found = last_that_works(proven, good=high, bad=low, resolution=0.01)
    assert found is not None  # without a limit there always is one
    return found
