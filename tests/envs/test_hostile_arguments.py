"""Whatever is given for an argument: TypeError, ValueError or ResetNeeded in one line, and nothing else."""

import inspect
import random

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from support.values import anything, strange_values

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise, MachiningForce, TorqueBias
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line, Spline
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, FeatureDefinition

ALLOWED = (TypeError, ValueError, ResetNeeded)
LONGEST = 600  # characters of a message
PAIRS = 20  # random calls of each

KINDS = {
    FuzzyArmEnv: {},
    FuzzyArmVectorEnv: {"num_envs": 2},
    ArmParameters: {},
    Payload: {},
    MachiningForce: {},
    ConstantForce: {"force": (1.0, 2.0)},
    TorqueBias: {"torque": (1.0, 2.0)},
    EncoderNoise: {},
    Disturbance: {},
    JointReference: {},
    Circle: {},
    Line: {"start": (0.3, 0.4), "end": (0.4, 0.5)},
    Lemniscate: {"center": (0.3, 0.5), "half_width": 0.1},
    Spline: {"waypoints": ((0.3, 0.4), (0.4, 0.5))},
    DomainRandomisation: {},
    SweepConfig: {},
    EvaluationConfig: {},
    FeatureDefinition: {},
    ActionDefinition: {},
    load_policy: {"name": "fuzzy-1"},
}


def refused_in_one_line(call, *arguments, **named):
    """Check what a call raises, if anything; the name of a file may be too long, an OSError."""
    caught = None
    try:
        call(*arguments, **named)
    except (*ALLOWED, OSError) as error:
        caught = error
    text = str(caught)
    if isinstance(caught, OSError):
        assert call is load_policy and caught.strerror == "File name too long"
    else:
        assert "\n" not in text and len(text) <= LONGEST, text[:LONGEST]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_whatever_is_given_the_errors_are_of_three_kinds(kind):
    names = list(inspect.signature(kind).parameters)
    for name in names:
        for value in strange_values():
            refused_in_one_line(kind, **{**KINDS[kind], name: value})
    generator = random.Random(kind.__name__)
    for _ in range(PAIRS):
        chosen = {name: anything(generator) for name in generator.sample(names, min(len(names), 2))}
        refused_in_one_line(kind, **{**KINDS[kind], **chosen})


@pytest.mark.parametrize("make", [FuzzyArmEnv, lambda: FuzzyArmVectorEnv(2)], ids=["single", "batch"])
def test_whatever_a_method_is_given(make):
    env, good = make(), np.zeros(make().action_space.shape)
    for value in strange_values():
        env.reset(seed=0)
        refused_in_one_line(env.step, value)
        refused_in_one_line(env.reset, seed=value)
        refused_in_one_line(env.reset, options=value)
        for name in ("initial_state", "reference", "case", "disturbance"):
            refused_in_one_line(env.reset, options={name: value})
    env.reset(seed=0)
    env.step(good)


@pytest.mark.parametrize("name", ["fuzzy-1", "ppo-residual", "elastic-observer"])
def test_whatever_a_policy_is_given(name):
    policy = load_policy(name)
    two = np.zeros((2, 10)), np.zeros((2, policy.memory_size))
    for value in strange_values():
        refused_in_one_line(policy.predict, value)
        refused_in_one_line(policy.predict, np.zeros(10), value)
        refused_in_one_line(policy.predict, *two, value)
    torque, _ = policy.predict(np.zeros(10))
    assert np.isfinite(torque).all()


NO_NUMBERS = {
    "complex": (np.array([1 + 2j, 0]), "complex128"),
    "texts": (np.array(["1", "2"]), "<U1"),
    "dates": (np.array(["2020", "2021"], dtype="M8[ns]"), "datetime64"),
    "durations": (np.array([1, 2], dtype="m8[ns]"), "timedelta64"),
    "truth values": (np.array([True, False]), "bool"),
    "bytes": (np.array([b"1", b"2"]), r"\|S1"),
}


@pytest.mark.parametrize("name", NO_NUMBERS)
def test_what_is_no_number_is_no_action_and_no_observation(name):
    given, message = NO_NUMBERS[name]
    single, batch = FuzzyArmEnv(), FuzzyArmVectorEnv(1)
    single.reset(seed=0)
    batch.reset(seed=0)
    for step, action in (
        (single.step, given),
        (batch.step, given[np.newaxis]),
        (single.step, list(given)),
        (batch.step, [list(given)]),
    ):
        with pytest.raises((TypeError, ValueError), match=message if action is given else None):
            step(action)
    policy = load_policy("fuzzy-1")
    with pytest.raises(TypeError, match=message):
        policy.predict(np.resize(given, 10))
    with pytest.raises(TypeError, match=message):
        policy.predict(np.zeros(10), np.resize(given, policy.memory_size))
    with pytest.raises(TypeError, match=message):
        single.reset(options={"initial_state": np.resize(given, 8)})
    with pytest.raises(TypeError, match=message):
        batch.reset(options={"initial_state": np.resize(given, 8)})


BREAKS = {
    "no parameters": (lambda: FuzzyArmEnv(parameters={}), r"parameters = \{\} must be a .*ArmParameters"),
    "a number for an arm": (lambda: FuzzyArmEnv(parameters=1), "parameters = 1 must be a"),
    "an arm of a batch": (lambda: FuzzyArmVectorEnv(2, parameters={}), r"parameters = \{\} must be a"),
    "a robot": (lambda: load_policy("fuzzy-1", robot=1), "robot is int; it must be a name"),
    "no robot": (lambda: load_policy("fuzzy-1", robot={}), "robot is dict; it must be a name"),
    "a text": (lambda: ArmParameters.from_dict(""), "values = '' must be a"),
    "a payload": (lambda: Payload(2**64), r"payload mass = 18446744073709551616 kg is out of range"),
    "huge": (lambda: Payload(10**400), "payload mass = 1000"),
    "a huge force": (lambda: ConstantForce((0, 1e308)), r"ConstantForce\.force\[1\] = 1e\+308 N is out of range"),
    "a grid": (lambda: SweepConfig(grid=[1]), r"grid = \[1\] must be a tuple of rows \(quantity, low, high, number\)"),
    "letters": (lambda: SweepConfig(policies="fuzzy-4"), "policies = 'fuzzy-4' must be a tuple of names"),
    "cases": (lambda: EvaluationConfig(cases="nominal"), "cases = 'nominal' must be a tuple of names"),
    "tiny sub-step": (
        lambda: FuzzyArmEnv(substep=1e-15),
        r"substep = 1e-15 s is out of range; allowed: \[1e-07, 0.001\]",
    ),
    "denormal sub-step": (lambda: FuzzyArmEnv(substep=5e-324), "substep = 5e-324 s is out of range"),
    "tiny period": (lambda: FuzzyArmEnv(control_period=1e-300), r"control_period = 1e-300 s .*allowed: \[1e-06, 0.1\]"),
    "no fraction": (lambda: EvaluationConfig(control_period=1e-300), "control_period = 1e-300 s is out of range"),
    "a long action": (lambda: ActionDefinition(period=1e300), r"period = 1e\+300 s is out of range"),
    "a policy's period": (lambda: load_policy("fuzzy-1", control_period=1e-300), "control_period = 1e-300 s is out of"),
    "an array of no axis": (lambda: TorqueBias(np.array(1.0)), r"TorqueBias\.torque = array\(1\.\) must be 2 real"),
    "a size": (lambda: ArmParameters(mass=np.array(1.0)), r"mass = array\(1\.\) must be 2 real numbers"),
    "a masked point": (
        lambda: Spline(np.ma.masked_array([0.3, 2.0], mask=[True, False])),
        r"waypoints\[0\] = masked must be 2 real numbers",
    ),
    "a range of nothing": (lambda: SweepConfig(ranges=((1.1, 0.9, "mass"),)), "ranges: quantity = 1.1 is unknown"),
    "a low end": (lambda: SweepConfig(ranges=(("mass", [], 1.1),)), r"ranges: low of mass = \[\] must be a real"),
    "a long episode": (
        lambda: FuzzyArmEnv(control_period=1e-6, reference=JointReference(duration=1e6)),
        "1000000000000 control periods of 1e-06 s; allowed: 1000000",
    ),
}


@pytest.mark.parametrize("name", BREAKS)
def test_what_once_broke_is_named(name):
    call, message = BREAKS[name]
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
