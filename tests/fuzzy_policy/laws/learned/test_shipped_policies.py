"""The shipped learned policies: which ones they are, and that they need no torch."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fuzzyarm.policies import LEARNED

ROOT = Path(__file__).parents[4]
SHIPPED, SEEDS = ROOT / "fuzzyarm/fuzzy_policy/laws/learned/policies", ROOT / "benchmarks/learned"
RESULTS = json.loads((ROOT / "benchmarks/results/learned_comparison.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", LEARNED)
def test_it_is_the_median_seed_of_all_that_were_trained(name):
    compared = next(one for one in RESULTS["learned"] if one["name"] == name)
    assert [run["seed"] for run in compared["runs"]] == [0, 1, 2, 3, 4]
    score = {run["seed"]: np.inf if run["score_mm"] is None else run["score_mm"] for run in compared["runs"]}
    assert sorted(score, key=lambda seed: score[seed])[2] == compared["median_seed"]
    chosen = SEEDS / f"{name}-{compared['median_seed']}" / "policy"
    for file in ("policy.json", "weights.safetensors"):
        assert (SHIPPED / name / file).read_bytes() == (chosen / file).read_bytes()


def test_they_load_and_act_without_torch():
    code = (
        "import sys; sys.modules['torch'] = sys.modules['stable_baselines3'] = None\n"  # an import of them fails
        "from fuzzyarm import load_policy\n"
        "import numpy as np\n"
        f"print([float(abs(load_policy(name).predict(np.ones(10))[0]).sum()) > 0.0 for name in {LEARNED!r}])"
    )
    plain = os.environ | {"NUMBA_DISABLE_JIT": "1"}  # machine code takes longer to load than one action in Python
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=plain)
    assert done.stdout.strip() == "[True, True, True]"
