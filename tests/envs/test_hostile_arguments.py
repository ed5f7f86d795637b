"""Whatever is given as an action, an observation or a state: TypeError or ValueError in one line, and nothing else."""

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv

NO_NUMBERS = {
    "complex": (np.array([1 + 2j, 0]), "complex128"),
    "texts": (np.array(["1", "2"]), "<U1"),
    "dates": (np.array(["2020", "2021"], dtype="M8[ns]"), "datetime64"),
    "truth values": (np.array([True, False]), "bool"),
}


@pytest.mark.parametrize(("given", "message"), NO_NUMBERS.values(), ids=NO_NUMBERS)
def test_what_is_no_number_is_no_action_and_no_observation(given, message):
    single, batch, policy = FuzzyArmEnv(), FuzzyArmVectorEnv(1), load_policy("fuzzy-1")
    single.reset(seed=0), batch.reset(seed=0)
    for call in (
        lambda: single.step(given),
        lambda: batch.step(given[np.newaxis]),
        lambda: policy.predict(np.resize(given, 10)),
        lambda: policy.predict(np.zeros(10), np.resize(given, policy.memory_size)),
        lambda: single.reset(options={"initial_state": np.resize(given, 8)}),
        lambda: batch.reset(options={"initial_state": np.resize(given, 8)}),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            call()


HUGE = np.broadcast_to(np.float64(1.0), (10**10,))


@pytest.mark.parametrize("given", [[1.0, [2.0]], range(10**12), HUGE], ids=["uneven", "endless", "huge"])
def test_what_no_array_holds_is_no_action_and_no_observation(given):
    single, batch, policy = FuzzyArmEnv(), FuzzyArmVectorEnv(2), load_policy("fuzzy-1")
    single.reset(seed=0), batch.reset(seed=0)
    for name, use in {
        "action": single.step,
        "actions": batch.step,
        "observation": policy.predict,
        "initial_state": lambda one: single.reset(options={"initial_state": one}),
    }.items():
        with pytest.raises(ValueError, match=f"^{name} ") as caught:
            use(given)
        assert "\n" not in str(caught.value)


def test_a_reference_of_endless_periods_is_refused():
    with pytest.raises(ValueError, match="1000000000000 control periods of 1e-06 s; allowed: 1000000"):
        FuzzyArmEnv(control_period=1e-6, reference=JointReference(duration=1e6))


def test_an_observation_from_which_no_torque_follows_is_refused():
    policy = load_policy("elastic-observer")
    observation = np.array([[0.3, 0.5, 0.0, 0.0, 0.3, 0.5, 0.0, 0.0, 0.0, 0.0]] * 2)
    observation[1, 7] = 1e300
    with pytest.raises(ValueError, match=r"no finite torque follows from an observation with a number of size 1e\+300"):
        policy.predict(observation)
    observation[1, 7] = np.nan
    with pytest.raises(ValueError, match=r"observation\[1, 7\] = nan, dq_reference of joint 2, is not finite"):
        policy.predict(observation)
