"""Kernels on torch's memory against the NumPy batch, bit for bit: on a GPU if there is one, else on the processor."""

import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from slow_twins import slow_but
from support.gpu import PretendedDriver, by_machine_code, pretended_launcher
from test_torch_env import DISTURBED, final_observations, last_info, reasons, wild_actions

from fuzzyarm import load_policy, policies
from fuzzyarm.envs.batch.kernels import kernels_of
from fuzzyarm.envs.batch.randomness import key_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.paths import Line
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.gpu import gpu, logarithm
from fuzzyarm.numbers.symbols import Symbol
from fuzzyarm.rl_baselines import torch_env, torch_kernels
from fuzzyarm.rl_baselines.torch_env import TorchFuzzyArm

LANES = 18  # more than a block
SHORT = JointReference(Line((0.4, 0.5), (0.402, 0.5)), duration=0.005)  # 5 steps
SHORTER = JointReference(Line((0.4, 0.5), (0.402, 0.5)), duration=0.003)
DRAWN = DomainRandomisation(
    mass=(0.9, 1.1), stiffness=(0.8, 1.2), payload=(0.0, 5.0), force=(0.0, 1.0), angle=(-0.01, 0.01),
    references=(SHORT, SHORTER),
)  # fmt: skip
ALL = {"disturbance": DISTURBED, "randomisation": DRAWN}


@pytest.fixture(params=["cpu", "cuda"])
def driver(request, monkeypatch):
    """Return the driver that launches, None on a GPU; the batches of `tensors` are stepped by it."""
    if request.param == "cuda" and not torch.cuda.is_available():
        pytest.skip("no GPU that torch can use")
    kernels_of.cache_clear()
    pretended = None if request.param == "cuda" else PretendedDriver()
    if pretended is not None:
        monkeypatch.setattr(torch_env, "launcher", lambda device: pretended_launcher(pretended))
    yield pretended
    kernels_of.cache_clear()


def tensors(driver, lanes=LANES, **arguments):
    return TorchFuzzyArm(lanes, device="cuda" if driver is None else "cpu", dtype=torch.float64, **arguments)


def batch(monkeypatch, lanes=LANES, **arguments):
    """Return the NumPy batch, with the logarithm of GPUs for its noise."""
    kernels_of.cache_clear()
    envs = FuzzyArmVectorEnv(lanes, **arguments)
    with monkeypatch.context() as patched:
        patched.setattr(Symbol, "log", logarithm)
        assert envs.lanes.kernels.step and envs.lanes.kernels.begin
    kernels_of.cache_clear()
    return envs


def same(tensor, array):
    return np.array_equal(tensor.cpu().numpy(), array)


def on(envs, array):
    return torch.tensor(array, device=envs.device)


@pytest.mark.parametrize("arguments", [ALL, {"robot": "ur5", "randomisation": "plants"}], ids=["two joints", "ur5"])
def test_a_reset_and_steps_through_ends_have_the_bits_of_the_batch(arguments, driver, monkeypatch):
    lanes, steps = (3, 2) if "robot" in arguments else (LANES, 9)
    theirs, ours = batch(monkeypatch, lanes, **arguments), tensors(driver, lanes, **arguments)
    assert same(ours.reset(seed=3)[0], theirs.reset(seed=3)[0])
    ended = np.zeros(lanes, dtype=int)
    torques = wild_actions(steps, lanes) if "robot" not in arguments else np.full((steps, lanes, 6), 20.0)
    for torque in 1.5 * torques:
        observation, reward, terminated, truncated, info = ours.step(on(ours, torque))
        expected, their_reward, their_terminated, their_truncated, their_info = theirs.step(torque)
        assert same(observation, expected) and same(reward, their_reward)
        assert same(terminated, their_terminated) and same(truncated, their_truncated)
        assert terminated.dtype == truncated.dtype == info["torque_clipped"].dtype == torch.bool
        assert same(info["final_obs"], final_observations(expected, their_info))
        assert same(info["reason"], reasons(their_info, lanes)) and info["reason"].dtype == torch.int64
        for key in ("tip", "tip_error", "reward_tracking", "reward_effort", "torque_clipped"):
            assert same(info[key], last_info(their_info, key)), key
        ended += their_terminated | their_truncated
    assert "robot" in arguments or (ended.min() > 0 and ended.max() > 1)
    state = theirs.lanes.numbers(slice(0, ours.state.shape[1])).T
    assert same(ours.state, state)
    for name, drawn in theirs.lanes.randomisation_info().items():
        assert same(ours.randomisation_info()[name], drawn), name
    assert same(ours.reset()[0], theirs.reset()[0])  # the streams go on


def test_each_lane_has_its_own_arm_and_scenario(driver, monkeypatch):
    arms = [ArmParameters(mass=(m, 0.8 * m)) for m in (50.0, 60.0, 70.0)]
    theirs = batch(monkeypatch, 3, case=["nominal", "machining", "payload"], parameters=arms)
    first = tensors(driver, 1)
    ours = torch_kernels.KernelLanes(theirs.lanes, 3, first.device, first._kernels._launch)
    ours.key.copy_(on(first, np.array([key_of(lane) for lane in range(3)]).view(np.int64)))
    assert same(ours.reset(), theirs.reset(seed=0)[0])
    for torque in wild_actions(3, 3):
        outcome, (expected, reward, *_) = ours.step(on(first, torque)), theirs.step(torque)
        assert same(outcome.observation.t(), expected) and same(outcome.reward, reward)


@pytest.mark.parametrize("name", slow_but(["fuzzy-4"], ["fuzzy-4", "elastic-observer", "adaptive-observer"]))
def test_a_law_in_the_kernel_has_the_bits_of_predict_and_step(name, driver, monkeypatch):
    theirs, ours, policy = batch(monkeypatch, **ALL), tensors(driver, **ALL), load_policy(name)
    observation, state, start = theirs.reset(seed=1)[0], None, None
    ours.reset(seed=1)[0].zero_()  # what was returned is the caller's
    total, errors, counts = np.zeros(LANES), [], np.zeros((2, LANES))
    for _ in range(9):
        torque, state = policy.predict(observation, state, start)
        observation, reward, *ends, info = theirs.step(torque)
        start, total, counts = ends[0] | ends[1], total + reward, counts + ends
        errors.append(last_info(info, "tip_error"))
    _, memory, first = ours.run(policy, 4)
    kept = memory.clone()
    seen, after, found = ours.run(policy, 5, memory)
    assert same(seen, observation) and torch.equal(memory, kept)
    state[start] = 0.0  # as predict has it at the next step
    assert same(after, state)
    assert same(found["steps"], np.full(LANES, 5.0)) and counts.min(axis=1)[1] > 0
    assert same(first["terminated"] + found["terminated"], counts[0])
    assert same(first["truncated"] + found["truncated"], counts[1])
    assert same(torch.maximum(first["tip_error"], found["tip_error"]), np.max(errors, axis=0))
    np.testing.assert_allclose((first["reward"] + found["reward"]).cpu(), total, rtol=1e-14)
    squares = (first["tip_error_squares"] + found["tip_error_squares"]).cpu()
    np.testing.assert_allclose(squares, np.square(errors).sum(axis=0), rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("name", policies.registry.NAMES)
def test_laws_of_all_policies_have_the_bits_of_predict_and_step(name, monkeypatch):
    arguments = {"case": "machining", "randomisation": "plants", "reference": SHORT}
    monkeypatch.setattr(torch_env, "launcher", lambda device: by_machine_code)
    theirs, policy, lanes = FuzzyArmVectorEnv(37, **arguments), load_policy(name), 37
    ours = TorchFuzzyArm(lanes, dtype=torch.float64, **arguments)
    ours.reset(seed=3)
    observation, state, start = theirs.reset(seed=3)[0], None, None
    for _ in range(12):
        torque, state = policy.predict(observation, state, start)
        observation, _, terminated, truncated, _ = theirs.step(torque)
        start = terminated | truncated
    seen, after, found = ours.run(load_policy(name), 12)
    assert same(seen, observation) and same(after, state) and found["truncated"].tolist() == [2.0] * lanes


@pytest.mark.parametrize("other", [{"dtype": torch.float32}, {"compiled": False}, {"differentiable": True}])
def test_else_torch_runs_the_equations(other, driver):
    arguments = {"dtype": torch.float64, "compiled": True} | other
    envs = TorchFuzzyArm(2, device="cuda" if driver is None else "cpu", **arguments)
    envs.reset(seed=0)
    assert driver is None or not driver.launched
    with pytest.raises(ValueError, match=r"needed: 'cuda', torch\.float64, True, False"):
        envs.run(load_policy("fuzzy-4"), 1)


class Lawless(Policy):
    def act(self, observation, memory, torque):
        torque[:] = 0.0


def test_wrong_runs_are_named(driver):
    ours, policy = tensors(driver, 2), load_policy("fuzzy-4")
    with pytest.raises(ResetNeeded, match=r"before envs\.run"):
        ours.run(policy, 1)
    ours.reset()
    for given, message in {
        (Lawless(ArmParameters(), 1e-3), 1): "policy Lawless has no law",
        (policy, 0): "steps",
        (load_policy("fuzzy-4", control_period=2e-3), 1): "0.002 s; this batch has 2 and 0.001 s",
        (load_policy("computed-torque", robot="ur5"), 1): "6 joints",
        (policy, 1, torch.zeros(3, 2)): r"state has shape \(3, 2\); needed: \(2, 2\)",
    }.items():
        with pytest.raises(ValueError, match=message):
            ours.run(*given)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_driver_an_error_says_so():
    with pytest.raises(RuntimeError, match=r"NVIDIA driver|the CUDA driver's cu"):
        gpu(0)
