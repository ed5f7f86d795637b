"""Every shipped controller file: proven, and a witness of what the README says of the paper; every learned policy."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from slow_twins import slow_but
from support.shipped import CONTROLLERS

from fuzzyarm import Controller, certify
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
from fuzzyarm.policies import LEARNED

ROOT = Path(__file__).parents[2]
FEWER_RULES = [name for name in CONTROLLERS if "-32" not in name and "-16" not in name]


def load(name):
    return Controller.load(CONTROLLERS[name])


def results_of(name):
    return json.loads((ROOT / "benchmarks/results" / f"{name}.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", slow_but(FEWER_RULES, sorted(CONTROLLERS)))
def test_every_file_is_proven(name):
    assert certify(load(name)).proven


@pytest.mark.parametrize("rules", NAMED_RULES)
def test_the_consistent_form_is_shipped_for_every_named_model(rules):
    controller = load(f"fuzzy-{rules}")
    assert (controller.form, controller.integral, controller.alpha) == ("consistent", True, 20.0)
    assert controller.model.kept == NAMED_RULES[rules]


def test_the_gains_found_on_the_sampled_arm_are_those_of_4_rules_times_six_factors():
    """One factor for the gains on angle, velocity and integral of each joint, at every vertex; see `tip_gains.json`."""
    sampled, plain = load("fuzzy-4-sampled"), load("fuzzy-4")
    assert (sampled.alpha, sampled.gamma, sampled.model.kept) == (20.0, 2e-4, plain.model.kept)
    found = results_of("tip_gains")["rows"][-1]
    factors = np.concatenate(found["factors"])
    np.testing.assert_array_equal(sampled.gains, plain.gains * factors)
    assert found["bears"] and factors.max() < 1.25


@pytest.mark.parametrize("rules", [4, 2, 1])
@pytest.mark.parametrize("kind", ["", "-integral", "-common", "-integral-common"])
def test_fewer_than_4_rules_are_feasible_in_the_paper_form_too(rules, kind):
    """Theorem 2 at the paper's alpha and Q, with |M_ik| <= 1e4 (24) and gains of order 1e4."""
    controller = load(f"paper-{rules}{kind}")
    assert (controller.form, controller.model.rules, controller.alpha) == ("paper", rules, 20.0)
    assert (controller.integral, controller.common_multiplier) == ("integral" in kind, "common" in kind)
    np.testing.assert_array_equal(controller.weight, [1e-5, 1e-5, 1.0, 1.0])
    n_e = controller.gains.shape[-1]
    M = controller.gains @ controller.P[:n_e, :n_e]
    assert np.linalg.norm(M, ord=2, axis=(-2, -1)).max() < 1e4 < np.abs(controller.gains[..., :4]).max() < 1e5
    free = load("paper-4-common-high-gain")  # without that bound gains of 1e9 are proven as well
    assert (free.form, free.model.rules) == ("paper", 4) and np.abs(free.gains[..., :2]).max() > 1e9


@pytest.mark.parametrize("name", LEARNED)
def test_a_learned_policy_is_the_median_seed_of_all_that_were_trained(name):
    compared = next(one for one in results_of("learned_comparison")["learned"] if one["name"] == name)
    assert [run["seed"] for run in compared["runs"]] == [0, 1, 2, 3, 4]
    score = {run["seed"]: np.inf if run["score_mm"] is None else run["score_mm"] for run in compared["runs"]}
    assert sorted(score, key=lambda seed: score[seed])[2] == compared["median_seed"]
    shipped = ROOT / "fuzzyarm/fuzzy_policy/laws/learned/policies" / name
    chosen = ROOT / "benchmarks/learned" / f"{name}-{compared['median_seed']}" / "policy"
    for file in ("policy.json", "weights.safetensors"):
        assert (shipped / file).read_bytes() == (chosen / file).read_bytes()


def test_learned_policies_load_and_act_without_torch():
    code = (
        "import sys; sys.modules['torch'] = sys.modules['stable_baselines3'] = None\n"  # an import of them fails
        "from fuzzyarm import load_policy\n"
        "import numpy as np\n"
        f"print([float(abs(load_policy(name).predict(np.ones(10))[0]).sum()) > 0.0 for name in {LEARNED!r}])"
    )
    plain = os.environ | {"NUMBA_DISABLE_JIT": "1"}  # machine code takes longer to load than one action in Python
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=plain)
    assert done.stdout.strip() == "[True, True, True]"
