"""Whatever is given as an action, an observation or a state: TypeError or ValueError in one line, and nothing else."""

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv

HOSTILE = {
    "complex": (np.array([1 + 2j, 0]), "complex128"),
    "texts": (np.array(["1", "2"]), "<U1"),
    "dates": (np.array(["2020", "2021"], dtype="M8[ns]"), "datetime64"),
    "truth values": (np.array([True, False]), "bool"),
    "uneven": ([1.0, [2.0]], ""),
    "endless": (range(10**12), ""),
    "huge": (np.broadcast_to(np.float64(1.0), (10**10,)), ""),
}


@pytest.mark.parametrize(("given", "message"), HOSTILE.values(), ids=HOSTILE)
def test_what_is_no_array_of_numbers_is_refused_by_name(given, message):
    single, batch, policy = FuzzyArmEnv(), FuzzyArmVectorEnv(1), load_policy("fuzzy-1")
    single.reset(seed=0), batch.reset(seed=0)

    def fitting(*shape):
        return np.resize(given, shape) if message else given

    if message:
        with pytest.raises((TypeError, ValueError), match=f"^state.*{message}"):
            policy.predict(np.zeros(10), fitting(policy.memory_size))
    for name, use, value in (
        ("action", single.step, fitting(2)),
        ("action", batch.step, fitting(1, 2)),
        ("observation", policy.predict, fitting(10)),
        ("initial_state", lambda state: single.reset(options={"initial_state": state}), fitting(8)),
        ("initial_state", lambda state: batch.reset(options={"initial_state": state}), fitting(8)),
    ):
        with pytest.raises((TypeError, ValueError), match=f"^{name}.*{message}") as caught:
            use(value)
        assert "\n" not in str(caught.value)


def test_a_reference_of_endless_periods_is_refused():
    with pytest.raises(ValueError, match="1000000000000 control periods of 1e-06 s; allowed: 1000000"):
        FuzzyArmEnv(control_period=1e-6, reference=JointReference(duration=1e6))
