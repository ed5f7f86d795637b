"""Everything that is run and proven once, for the numbers and the figures alike."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from importlib import resources

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.rollout import Rollout, rollout
from fuzzyarm.eval.paper.controllers import PAPERS_OWN, SWAPPED, TITLES, compared_policies
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.proof.certificate import certify

WITNESSED_RULES = (4, 2, 1)
WITNESSES = tuple(
    f"paper-{rules}{integral}{common}"
    for rules, integral, common in itertools.product(WITNESSED_RULES, ("", "-integral"), ("", "-common"))
)
"""Files of Theorem 2: with and without integral, one multiplier for all dropped premises of A or one for each."""
HIGH_GAIN = "paper-4-common-high-gain"


@dataclasses.dataclass(frozen=True)
class Evidence:
    """What the claims are measured from.

    Attributes:
        reference: the paper's motion.
        controllers: by key of `controllers.TITLES`.
        rollouts: of each controller, by its key and the case.
        witnesses: files of the paper's form by name.
        proven: names of the witnesses of which every inequality is proven, anew and exactly.
        gamma_with: by whose L it gets, the smallest γ, to 1 %, at which the printed form with 4 rules is proven, all
            else (P, Q, X, τ, M) as in its file; with its own L its file is proven at γ = 1000.
    """

    reference: JointReference
    controllers: Mapping[str, Controller]
    rollouts: Mapping[tuple[str, str], Rollout]
    witnesses: Mapping[str, Controller]
    proven: frozenset[str]
    gamma_with: Mapping[str, float]


def gather(progress: Callable[[], None] | None = None) -> Evidence:
    """Run every controller in every case and prove the witnesses; `progress` is called `STEPS` times."""
    step = progress or (lambda: None)
    policies, reference, rollouts = compared_policies(), JointReference(), {}
    step()
    for case in CASES:
        env = FuzzyArmEnv(case=case, reference=reference)
        for key, policy in policies.items():
            rollouts[key, case] = rollout(env, policy, policy_name=key, case=case, seed=0)
            step()
    witnesses, proven = prove_witnesses(step)
    controllers = {key: policy.controller for key, policy in policies.items()}
    others = {"the consistent form's L": SWAPPED, "the paper's L_1k": PAPERS_OWN}
    gamma_with = {}
    for name, key in others.items():
        law = dataclasses.replace(controllers["printed-4"], feedforward=controllers[key].feedforward)
        gamma_with[name] = smallest_gamma(law)
        step()
    return Evidence(reference, controllers, rollouts, witnesses, proven, gamma_with)


def prove_witnesses(step: Callable[[], None]) -> tuple[dict[str, Controller], frozenset[str]]:
    """Return the witnesses by name, and the names of those of which every inequality is proven; a step for each."""
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
    """Return the smallest γ in [1e3, 1e5] at which a file is proven, to 1 %, by bisection; infinite if none."""
    low, high = 1e3, 1e5

    def proven(gamma: float) -> bool:
        return certify(dataclasses.replace(controller, gamma=gamma)).proven

    if not proven(high):
        return math.inf
    while high > 1.01 * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if proven(middle) else (middle, high)
    return high


STEPS = 1 + len(CASES) * len(TITLES) + len(WITNESSES) + 1 + 2
"""Steps of `gather`, for a progress bar."""
