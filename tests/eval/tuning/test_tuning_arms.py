"""The whole of a tuning: Table 1 gives the shipped numbers back, and other arms get policies that lose no case.

Minutes each: ``python -m pytest -m slow tests/eval/tuning``.
"""

import contextlib
import json

import pytest

from fuzzyarm import ArmParameters, Engine, EvaluationConfig, evaluate
from fuzzyarm.envs.physics.equations import chosen_arm
from fuzzyarm.eval.tuning.run import begin, tune
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.computed_torque import _BANDWIDTH
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights
from fuzzyarm.policies import policies_of
from fuzzyarm.policies.registry import POLICIES

pytestmark = pytest.mark.slow

SOFT = ArmParameters(length=(0.5, 0.4), stiffness=(8e3, 5e3))
LONG = ArmParameters(length=(0.6, 0.45), stiffness=(3e4, 6e3))


def tuned(arm, folder):
    folder.mkdir()
    begin(arm, folder)
    quiet = contextlib.nullcontext(lambda *arguments: None)
    return tune(arm, folder, engine=Engine(jobs=2), bar=lambda name, total: quiet, finished=lambda finding: None)


def content(path):
    """Return what a controller file holds, without what it was made with."""
    document = json.loads(path.read_text(encoding="utf-8"))
    return {name: value for name, value in document.items() if name not in ("origin", "digest")}


def test_table_1_gives_the_shipped_numbers_back(tmp_path):
    folder = tmp_path / "paper"
    laws = tuned(ArmParameters(), folder).laws
    assert content(folder / "fuzzy-4.json") == content(POLICIES["fuzzy-4"].path)
    assert tuple(laws.numbers().values()) == (_BANDWIDTH, ObserverWeights(), AdaptiveWeights())


@pytest.mark.parametrize("arm", [SOFT, LONG, chosen_arm("planar-3r", None)], ids=["soft", "long", "planar-3r"])
def test_an_arm_of_ones_own_gets_policies_that_lose_no_case(tmp_path, arm):
    folder = tmp_path / "my-arm"
    found = tuned(arm, folder)
    assert {"fuzzy-4", "computed-torque", "elastic-observer"} <= set(found.laws.policies)
    for row in found.margins["rows"]:
        if row["policy"] != "adaptive-observer":  # its margins are those of its frozen loop
            assert all(radius < 1.0 for radius in row["spectral_radius"].values()), row
    assert evaluate(EvaluationConfig(policies=policies_of(str(folder)), robot=arm)).complete
