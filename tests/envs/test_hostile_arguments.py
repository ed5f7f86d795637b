"""Whatever is given for an argument: TypeError, ValueError or ResetNeeded in one line, and nothing else."""

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import ConstantForce, TorqueBias
from fuzzyarm.envs.scenario.paths import Spline
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition

NO_NUMBERS = {
    "complex": (np.array([1 + 2j, 0]), "complex128"),
    "texts": (np.array(["1", "2"]), "<U1"),
    "dates": (np.array(["2020", "2021"], dtype="M8[ns]"), "datetime64"),
    "truth values": (np.array([True, False]), "bool"),
}


@pytest.mark.parametrize("name", NO_NUMBERS)
def test_what_is_no_number_is_no_action_and_no_observation(name):
    given, message = NO_NUMBERS[name]
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
    single.reset(seed=0)
    with pytest.raises((TypeError, ValueError)):
        single.step(list(given))


BREAKS = [
    (lambda: FuzzyArmEnv(parameters={}), r"parameters = \{\} must be a .*ArmParameters"),
    (lambda: FuzzyArmVectorEnv(2, parameters={}), r"parameters = \{\} must be a"),
    (lambda: load_policy("fuzzy-1", robot=1), "robot is int; it must be a name"),
    (lambda: ArmParameters.from_dict(""), "values = '' must be a"),
    (lambda: Payload(10**400), "payload mass = 1000"),
    (lambda: ConstantForce((0, 1e308)), r"ConstantForce\.force\[1\] = 1e\+308 N is out of range"),
    (lambda: SweepConfig(grid=[1]), r"grid = \[1\] must be a tuple of rows \(quantity, low, high, number\)"),
    (lambda: SweepConfig(policies="fuzzy-4"), "policies = 'fuzzy-4' must be a tuple of names"),
    (lambda: EvaluationConfig(cases="nominal"), "cases = 'nominal' must be a tuple of names"),
    (lambda: FuzzyArmEnv(substep=5e-324), r"substep = 5e-324 s is out of range; allowed: \[1e-07, 0.001\]"),
    (lambda: FuzzyArmEnv(control_period=1e-300), r"control_period = 1e-300 s .*allowed: \[1e-06, 0.1\]"),
    (lambda: EvaluationConfig(control_period=1e-300), "control_period = 1e-300 s is out of range"),
    (lambda: ActionDefinition(period=1e300), r"period = 1e\+300 s is out of range"),
    (lambda: load_policy("fuzzy-1", control_period=1e-300), "control_period = 1e-300 s is out of"),
    (lambda: TorqueBias(np.array(1.0)), r"TorqueBias\.torque = array\(1\.\) must be 2 real"),
    (
        lambda: Spline(np.ma.masked_array([0.3, 2.0], mask=[True, False])),
        r"waypoints\[0\] = masked must be 2 real numbers",
    ),
    (lambda: SweepConfig(ranges=((1.1, 0.9, "mass"),)), "ranges: quantity = 1.1 is unknown"),
    (lambda: SweepConfig(ranges=(("mass", [], 1.1),)), r"ranges: low of mass = \[\] must be a real"),
    (
        lambda: FuzzyArmEnv(control_period=1e-6, reference=JointReference(duration=1e6)),
        "1000000000000 control periods of 1e-06 s; allowed: 1000000",
    ),
]


@pytest.mark.parametrize(("call", "message"), BREAKS)
def test_what_once_broke_is_named(call, message):
    with pytest.raises((TypeError, ValueError), match=message):
        call()


UNEVEN = [1.0, [2.0]]
HUGE = np.broadcast_to(np.float64(1.0), (10**10,))


@pytest.mark.parametrize("given", [UNEVEN, range(10**12), HUGE], ids=["uneven", "endless", "huge"])
def test_what_no_array_holds_is_no_action_and_no_observation(given):
    single, batch, policy = FuzzyArmEnv(), FuzzyArmVectorEnv(2), load_policy("fuzzy-1")
    single.reset(seed=0), batch.reset(seed=0)
    uses = {
        "action": single.step,
        "actions": batch.step,
        "observation": policy.predict,
        "initial_state": lambda one: single.reset(options={"initial_state": one}),
    }
    if given is not HUGE:
        uses["state"] = lambda one: policy.predict(np.zeros(10), one)
    for name, use in uses.items():
        with pytest.raises(ValueError, match=f"^{name} ") as caught:
            use(given)
        assert "\n" not in str(caught.value)


def test_an_observation_from_which_no_torque_follows_is_refused():
    policy = load_policy("elastic-observer")
    observation = np.array([[0.3, 0.5, 0.0, 0.0, 0.3, 0.5, 0.0, 0.0, 0.0, 0.0]] * 2)
    observation[1, 7] = 1e300
    with pytest.raises(ValueError, match=r"no finite torque follows from an observation with a number of size 1e\+300"):
        policy.predict(observation)
    observation[1, 7] = np.nan
    with pytest.raises(ValueError, match=r"observation\[1, 7\] = nan, dq_reference of joint 2, is not finite"):
        policy.predict(observation)
