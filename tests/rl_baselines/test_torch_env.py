"""The arm in torch tensors against the NumPy one: physics, episodes, random streams, precision, compilation."""

import dataclasses
import os
import shutil

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from numpy.testing import assert_allclose, assert_array_equal
from slow_twins import slow_but
from support.plain import hold_numpy
from support.two_joints import PHYSICS, state_of

from fuzzyarm import ArmParameters, load_policy
from fuzzyarm.envs.batch import randomness
from fuzzyarm.envs.physics.dynamics import Arm, Payload, arm_constants
from fuzzyarm.envs.physics.integrator import held_of
from fuzzyarm.envs.physics.records import PerJoint, filled, flat
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise, MachiningForce, TorqueBias
from fuzzyarm.envs.scenario.paths import Line
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.task import Termination
from fuzzyarm.numbers.functions import whole
from fuzzyarm.rl_baselines._torch_numbers import Angle, TorchWord
from fuzzyarm.rl_baselines.torch_env import TorchFuzzyArm

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
SHORT = JointReference(Line((0.4, 0.5), (0.402, 0.5)), duration=0.02)  # 20 steps
DISTURBED = Disturbance(
    **{"tip_force": MachiningForce(), "payload": Payload(2.0, at="link"), "torque_bias": TorqueBias((3.0, -1.0))},
    encoder_noise=EncoderNoise(1e-5, 1e-3),
)
has_compiler = shutil.which(os.environ.get("CXX", "g++")) is not None
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")  # when torch loads its compiler
needs_compiler = pytest.mark.skipif(not has_compiler, reason="torch.compile needs a C++ compiler on the CPU")


@pytest.fixture(params=DEVICES)
def device(request):
    return request.param


def vector_env(num_envs, **arguments):
    return gym.make_vec("FuzzyArm-v0", num_envs=num_envs, vectorization_mode="vector_entry_point", **arguments)


def numbers(tensor):
    return torch.as_tensor(tensor).detach().cpu().double().numpy()


def closed_loop(envs, steps):
    """Yield what each step of an environment returns whose loop computed torque closes."""
    policy, state, observation = load_policy("computed-torque"), None, envs.reset(seed=0)[0]
    for _ in range(steps):
        action, state = policy.predict(numbers(observation), state)
        observation, *rest = envs.step(action)
        yield observation, *rest


def wild_actions(steps, lanes, seed=0):
    """Torques that throw some lanes out of the domain within a hundred steps."""
    generator = np.random.default_rng(seed)
    return generator.uniform(-1.3, 1.3, (1, lanes, 2)) * (500.0, 250.0) + generator.normal(0.0, 60.0, (steps, lanes, 2))


def last_info(info, key):
    """Each lane's value before any reset, of the NumPy environment; so below."""
    value = np.array(info[key])
    if "final_info" in info:
        ended = info["final_info"][f"_{key}"]
        value[ended] = info["final_info"][key][ended]
    return value


def reasons(info, lanes):
    found = info.get("final_info", {}).get("reason", np.full(lanes, None))
    return np.array([next(reason for reason in Termination if reason.text == (text or "")) for text in found])


def final_observations(observation, info):
    ended = np.flatnonzero(info.get("_final_obs", []))
    return np.array([info["final_obs"][lane] if lane in ended else seen for lane, seen in enumerate(observation)])


def test_the_integrator_on_tensors_equals_numpy(device):
    # Friction may turn an ulp at rest into none: motors at rest, motors about to stop and fast ones alike.
    generator = np.random.default_rng(1)
    lanes = 4000
    state = generator.normal(size=(8, lanes)) * np.array([1.5, 1.5, 1.5, 1.5, 3.0, 3.0, 3.0, 3.0])[:, None]
    state[:2] = state[2:4] + generator.normal(size=(2, lanes)) * 5e-3
    state[4:6] *= 10.0 ** generator.integers(-6, 1, (2, lanes))
    state[4:6, ::7] = 0.0
    torque = generator.normal(size=(2, lanes)) * np.array([[200.0], [80.0]])
    force = generator.normal(size=(4, lanes)) * 100.0
    arm = np.array(flat(arm_constants(ArmParameters(), Payload(3.0))))[:, None] * generator.uniform(
        0.9, 1.1, (21, lanes)
    )
    expected = hold_numpy(PHYSICS, state, torque, force, arm, 2e-4, 5)

    def tensors(rows):
        return [torch.tensor(row, device=device) for row in rows]

    parts = PerJoint(*tensors(torque)), tensors(force[:2]), tensors(force[2:])
    found = held_of(PHYSICS)(state_of(tensors(state)), *parts, filled(Arm, tensors(arm)), 2e-4, 5)
    assert_allclose(numbers(torch.stack(flat(found))), expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())
    assert (expected[4:6] == 0.0).any()  # some motors stick


def test_an_angle_keeps_what_float32_loses():
    # Each increment alone is lost: 1e-8 is a sixth of the distance to the next float32 at 1.
    increments = torch.full((20_000,), 1e-8)
    angle, plain = Angle(torch.ones(1), torch.zeros(1)), torch.ones(1)
    for increment in increments:
        angle, plain = angle + increment, plain + increment
    total = float(increments.double().sum())
    assert plain.item() == 1.0
    assert angle.value.double().item() + angle.rest.double().item() - 1.0 == pytest.approx(total, rel=1e-6)
    assert (angle - Angle(torch.ones(1), torch.zeros(1))).item() == pytest.approx(total, rel=1e-6)
    assert angle.value.item() == np.float32(1.0 + total)
    assert (increments[0] + angle).value.item() == (angle + increments[0]).value.item()
    with pytest.raises(TypeError):
        increments[0] * angle


def test_streams_are_those_of_numpy_bit_for_bit(device):
    keys = np.array([0, 1, 2**63 - 1, 2**63, 2**64 - 1, *(randomness.key_of(seed) for seed in range(50))], np.uint64)
    key = torch.tensor(keys.view(np.int64), device=device)
    for counter in (0, 1, 32, 2**40):
        expected = randomness.draw(keys, counter)
        fraction = randomness.uniform(keys, counter)
        normal = randomness.normal_pair(keys, counter)
        exact, short = TorchWord(key, torch.float64), TorchWord(key, torch.float32)
        for given in (counter, whole(torch.full_like(key, counter))):
            assert_array_equal(randomness.draw(exact, given).bits.cpu().numpy().view(np.uint64), expected)
            assert_array_equal(randomness.uniform(exact, given).cpu().numpy(), fraction)
            cut = randomness.uniform(short, given)
            assert cut.dtype == torch.float32
            assert_array_equal(numbers(cut), np.floor(fraction * 2**24) / 2**24)
            pair = randomness.normal_pair(exact, given)
            assert_allclose(np.array([numbers(part) for part in pair]), normal, rtol=1e-14, atol=1e-14)


def test_a_stiff_arm_has_the_sub_steps_of_the_numpy_environment():
    given = {"parameters": ArmParameters(stiffness=(1e8, 1e8)), "randomisation": "plants"}
    assert TorchFuzzyArm(1, compiled=False, **given).substeps == vector_env(1, **given).substeps == 31


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=needs_compiler)])
def test_trajectories_of_the_paper_are_the_numpy_ones(case, compiled, device):
    # Measured: 2e-15 m, rounding of a float64 angle. Computed torque closes both loops, each on its own observations.
    ours = TorchFuzzyArm(2, case=case, dtype=torch.float64, device=device, compiled=compiled)
    loops = closed_loop(ours, 1500), closed_loop(vector_env(2, case=case), 1500)
    for step, ((seen, reward, terminated, truncated, info), theirs) in enumerate(zip(*loops, strict=True)):
        assert_allclose(numbers(seen), theirs[0], rtol=0.0, atol=1e-11)
        assert_allclose(numbers(info["tip_error"]), last_info(theirs[4], "tip_error"), rtol=0.0, atol=1e-12)
        assert_allclose(numbers(reward), theirs[1], rtol=0.0, atol=1e-10)
        assert not terminated.any()
        assert truncated.cpu().tolist() == [step == 1499] * 2
    assert_array_equal(numbers(info["final_obs"])[:, 6:8], 0.0)  # the reference has come to rest
    assert info["tip_error"].max() > 1e-6  # something was measured


@pytest.mark.parametrize(
    ("expected_reasons", "arguments", "steps", "seed"),
    [
        ({0}, {"reference": SHORT, "substep": 1e-3}, 45, 0),  # two episodes to their ends
        ({0, 2}, {"randomisation": "robust", "substep": 1e-3}, 60, 37),  # the first leaves the domain in step 54
        pytest.param({0, 2}, {"randomisation": "robust"}, 250, 0, marks=pytest.mark.slow),
        pytest.param({0, 1, 2}, {"parameters": ArmParameters(joint_limit=(0.9, 2.1))}, 250, 0, marks=pytest.mark.slow),
    ],
)
def test_wild_episodes_are_the_numpy_ones_through_every_reset(expected_reasons, arguments, steps, seed, device):
    lanes = 6
    arguments = {"disturbance": DISTURBED, "substep": 5e-4, **arguments}
    ours = TorchFuzzyArm(lanes, dtype=torch.float64, device=device, compiled=False, **arguments)
    theirs = vector_env(lanes, **arguments)
    observation, (their_observation, _) = ours.reset(seed=3)[0], theirs.reset(seed=3)
    seen = set()
    for action in wild_actions(steps, lanes, seed):
        assert_allclose(numbers(observation), their_observation, rtol=0.0, atol=1e-10)
        observation, reward, terminated, truncated, info = ours.step(torch.tensor(action, device=device))
        their_observation, their_reward, their_terminated, their_truncated, their_info = theirs.step(action)
        assert_array_equal(terminated.cpu(), their_terminated)
        assert_array_equal(truncated.cpu(), their_truncated)
        assert_array_equal(info["reason"].cpu(), reasons(their_info, lanes))
        assert_array_equal(info["torque_clipped"].cpu(), last_info(their_info, "torque_clipped"))
        assert_allclose(numbers(reward), their_reward, rtol=0.0, atol=1e-10)
        for key in ("tip", "tip_error", "reward_tracking", "reward_effort"):
            assert_allclose(numbers(info[key]), last_info(their_info, key), rtol=0.0, atol=1e-10, err_msg=key)
        last = final_observations(their_observation, their_info)
        assert_allclose(numbers(info["final_obs"]), last, rtol=0.0, atol=1e-10)
        seen |= set(info["reason"].tolist())
    assert seen == expected_reasons


def test_an_infinite_action_ends_only_its_lane(device):
    action = torch.full((4, 2), 40.0, device=device)
    envs, twin = (TorchFuzzyArm(4, device=device, compiled=False) for _ in range(2))
    for one in (envs, twin):
        one.reset(seed=0)
        one.step(action)
    bad, before = action.clone(), envs.state
    bad[1, 0], bad[2, 1] = float("nan"), float("inf")
    observation, reward, terminated, truncated, info = envs.step(bad)
    expected, their_reward, *_ = twin.step(action)
    assert terminated.tolist() == [False, True, True, False] and not truncated.any()
    assert info["reason"].tolist() == [0, Termination.NOT_FINITE, Termination.NOT_FINITE, 0]
    assert reward[1:3].tolist() == [0.0, 0.0]
    assert torch.equal(observation[::3], expected[::3]) and torch.equal(reward[::3], their_reward[::3])
    assert torch.equal(info["final_obs"][1:3, :2], before[1:3, :2])  # their states stayed
    assert all(part.isfinite().all() for part in (observation, *info.values()))
    assert torch.equal(observation[1:3], envs.reset(seed=0)[0][1:3])  # nothing is drawn: every start is the same


@pytest.mark.parametrize(("dtype", "close"), [(torch.float64, 0.0), (torch.float32, 3e-7)])
def test_drawn_plants_are_the_numpy_ones(dtype, close, device):
    envs = TorchFuzzyArm(200, randomisation="robust", dtype=dtype, device=device, compiled=False)
    theirs, seen = vector_env(200, randomisation="robust"), envs.reset(seed=7)[0]
    expected, info = theirs.reset(seed=7)
    drawn = envs.randomisation_info()
    assert set(drawn) == {key for key in info["randomisation"] if not key.startswith("_")}
    for name, values in drawn.items():
        assert values.dtype == dtype
        assert_allclose(values.cpu(), info["randomisation"][name], rtol=close, atol=close, err_msg=name)
    for one, other in ((seen, expected), (envs.reset()[0], theirs.reset()[0])):  # then the streams go on
        assert_allclose(numbers(one), other, atol=1e-10 if dtype == torch.float64 else 1e-5)


@pytest.mark.parametrize("dtype", slow_but([torch.float32], [torch.float32, torch.float64]))
def test_a_step_never_asks_for_a_value(dtype):
    # Tensors of the meta device have none: to branch on one, or to wait for one, raises.
    envs = TorchFuzzyArm(4, device="meta", dtype=dtype, compiled=False, randomisation="robust", disturbance=DISTURBED)
    assert envs.reset(seed=0)[0].shape == (4, 10)
    assert envs.step(torch.zeros((4, 2), device="meta"))[0].device.type == "meta"


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_float32_stays_close_to_float64(case, device):
    # Reading the tip in float32 rounds two angles of up to 4 rad, their sum, two products and a difference: at most
    # (0.5 m + 0.5 m) 2.4e-7 + 4 * 6e-8 m = 0.5 µm. The motion itself differs by less: its angles have the digits of
    # two float32, and torques of at most 500 N m are off by 20 roundings of 6e-8, 6e-4 N m, against a loop stiffness
    # of some 1e4 N m/rad. Measured: 0.11 µm after 400 steps and 0.14 µm after 1499; without the angles' rests 1.8 and
    # 3.8 µm.
    short, long = (
        closed_loop(TorchFuzzyArm(1, case=case, dtype=dtype, device=device, compiled=False), 400)
        for dtype in (torch.float32, torch.float64)
    )
    for (*_, info), (*_, exact) in zip(short, long, strict=True):
        assert abs(info["tip_error"].item() - exact["tip_error"].item()) < 5e-7
        assert np.linalg.norm(numbers(info["tip"]) - numbers(exact["tip"])) < 5e-7


def test_without_a_compiler_one_line_says_what_to_do(monkeypatch):
    def without_a_compiler(function, **settings):
        def graph(*arguments):
            raise RuntimeError("backend failed:\nNo working C++ compiler found in c++, g++\n")

        return graph

    monkeypatch.setattr(torch, "compile", without_a_compiler)
    envs = TorchFuzzyArm(2, device="cpu", compiled=True)
    envs.reset(seed=0)
    with pytest.raises(
        RuntimeError, match=r"^compiled=True needs a C\+\+ compiler, but none was found: .*compiled=False"
    ):
        envs.step(np.zeros((2, 2)))


@pytest.mark.slow
@needs_compiler
def test_compiled_is_eager(device):
    # fullgraph=True: torch raises at any graph break. 37 lanes: whole vectors and a remainder.
    # Little is drawn here, because every draw is one more second of compilation.
    disturbance = dataclasses.replace(DISTURBED, encoder_noise=None)
    randomisation = DomainRandomisation(angle=(-0.01, 0.01))
    arguments = {"reference": SHORT, "substep": 1e-3, "disturbance": disturbance, "randomisation": randomisation}
    ours, theirs = (TorchFuzzyArm(37, device=device, compiled=how, **arguments) for how in (True, False))
    assert torch.equal(ours.reset(seed=1)[0], theirs.reset(seed=1)[0])  # a reset is not compiled
    actions, close, ended = wild_actions(70, 37), {"rtol": 0.0, "atol": 1e-4}, np.zeros(2, dtype=int)
    actions[11, 3] = np.nan
    for action in torch.tensor(actions, device=device):
        found = ours.step(action)
        torch.testing.assert_close(found, theirs.step(action), **close)
        torch.testing.assert_close(ours.state, theirs.state, **close)
        ended += [flags.sum().item() for flags in found[2:4]]
    assert found[0].dtype == torch.float32 and (ended > 0).all()
    # Modes that torch would compile again for.
    action = torch.ones((37, 2), device=device, requires_grad=True)
    with torch.inference_mode():
        torch.testing.assert_close(ours.step(action)[0], theirs.step(action)[0], **close)
    assert not ours.step(action)[1].requires_grad


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs = 0 is out of range"),
        ({"dtype": torch.float16}, "torch.float16 is unknown; choose torch.float32 or torch.float64"),
        ({"case": "drilling"}, "unknown case 'drilling'"),
        ({"case": "payload", "disturbance": Disturbance()}, "not both"),
        ({"reference": JointReference(), "randomisation": "robust"}, "not both"),
        (
            {"parameters": ArmParameters(length=(0.6, 0.5)), "reference": JointReference()},
            "build the reference with the plant's `parameters`",
        ),
        ({"substep": 3e-4}, "is not a multiple of substep"),
        ({"randomisation": "some"}, "unknown randomisation 'some'"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        TorchFuzzyArm(**{"num_envs": 2, "compiled": False, **arguments})


def test_wrong_calls_are_named():
    envs = TorchFuzzyArm(2, compiled=False)
    with pytest.raises(ResetNeeded, match="reset"):
        envs.step(torch.zeros(2, 2))
    for seed in (-1, 1.5, True):
        with pytest.raises((TypeError, ValueError), match="seed = "):
            envs.reset(seed=seed)
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=r"action has shape \(2,\); needed: .* of shape \(2, 2\)"):
        envs.step(torch.zeros(2))
    with pytest.raises(ValueError, match=r"action = \[1\.0, \[2\.0\]\] is not an array"):
        envs.step([1.0, [2.0]])
