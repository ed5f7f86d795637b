"""Gradients through the arm in tensors, against finite differences: slipping, sticking, at borders, over many steps."""

import numpy as np
import pytest
import torch
from test_torch_env import needs_compiler

from fuzzyarm import ArmParameters
from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.envs.physics.friction import stick_slip
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise, MachiningForce
from fuzzyarm.envs.scenario.paths import Line
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.rl_baselines.torch_env import TorchFuzzyArm

SHORT = JointReference(Line((0.4, 0.5), (0.402, 0.5)), duration=0.004)  # 4 steps
LOADED = Disturbance(tip_force=MachiningForce(), encoder_noise=EncoderNoise(1e-5, 1e-3))
SPREAD = DomainRandomisation(stiffness=(0.8, 1.2), payload=(0.0, 5.0), angle=(-0.01, 0.01))
FREE = (300.0, -150.0)  # N m, far more than static friction and gravity: both motors slip from the first step on
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")  # when torch loads its compiler


def arms(lanes, **arguments):
    settings = {"dtype": torch.float64, "compiled": False, "differentiable": True, "substep": 5e-4}
    return TorchFuzzyArm(lanes, **{**settings, **arguments})


def followed(envs, torques, weights):
    """Return a weighted sum (lanes,) of all that came of torques (steps, lanes, 2) from the start."""
    envs.reset(seed=3)
    total = torch.zeros(envs.num_envs, dtype=envs.dtype)
    for torque in torques:
        observation, reward, _, _, info = envs.step(torque)
        total = total + reward + 1e3 * info["tip_error"] + (observation * weights[:10]).sum(-1)
    return total + (envs.state * weights[10:]).sum(-1)


def by_differences(function, at, step):
    """Return the gradient of a function (steps, lanes, 2) -> (lanes,) by central differences, lane by lane at once."""
    gradient = torch.zeros_like(at)
    for k in range(at.shape[0]):
        for joint in range(2):
            change = torch.zeros_like(at)
            change[k, :, joint] = step
            gradient[k, :, joint] = (function(at + change) - function(at - change)) / (2.0 * step)
    return gradient


@pytest.mark.parametrize("arguments", [{}, {"disturbance": LOADED, "randomisation": SPREAD}], ids=["nominal", "loaded"])
def test_the_gradient_of_slipping_motors_is_that_of_finite_differences(arguments):
    envs, generator = arms(3, **arguments), torch.Generator().manual_seed(0)
    torques = torch.tensor(FREE, dtype=torch.float64) + 20.0 * torch.randn(2, 3, 2, generator=generator).double()
    weights = torch.randn(18, generator=generator).double()
    torques.requires_grad_()
    total = followed(envs, torques, weights)
    assert (envs.state[:, 4:6] != 0.0).all()  # both motors move
    (found,) = torch.autograd.grad(total.sum(), torques)
    with torch.no_grad():
        expected = by_differences(lambda at: followed(envs, at, weights), torques, 1e-2)
    assert (expected.abs() > 1e-6).all()
    torch.testing.assert_close(found, expected, rtol=2e-6, atol=1e-9)


def test_a_motor_that_sticks_has_no_gradient():
    # The torque that holds the arm at rest, and 1 N m: static friction holds both motors.
    envs = arms(2)
    envs.reset(seed=0)
    state, stiffness = envs.state.detach(), torch.tensor(ArmParameters().stiffness, dtype=torch.float64)
    torque = (stiffness * (state[:, :2] - state[:, 2:4]) + 1.0).requires_grad_()
    for _ in range(3):
        envs.step(torque)
    assert (envs.state[:, 4:6] == 0.0).all()
    (gradient,) = torch.autograd.grad(envs.state.sum(), torque)
    assert (gradient == 0.0).all()
    with torch.no_grad():
        envs.reset(seed=0)
        for _ in range(3):
            envs.step(torque + 0.5)
    assert torch.equal(envs.state[:, :2].detach(), state[:, :2])  # and indeed nothing depends on it


def sliding(velocity, acceleration, deceleration, duration=1e-3):
    """Return velocity and angle after `stick_slip`, and their gradients by velocity, acceleration and deceleration."""
    numbers = map(float, (velocity, acceleration, deceleration))
    inputs = [torch.tensor(number, dtype=torch.float64, requires_grad=True) for number in numbers]
    after = stick_slip(*inputs, duration)
    rows = [torch.autograd.grad(one, inputs, retain_graph=True) for one in after]
    return [one.item() for one in after], np.array([[one.item() for one in row] for row in rows])


@pytest.mark.parametrize(
    ("velocity", "acceleration", "deceleration"),
    [(0.3, 40.0, 90.0), (-0.3, 40.0, 90.0), (0.02, 40.0, 90.0), (0.02, -150.0, 90.0), (-1e-5, 150.0, 90.0)],
    ids=["slips", "slips back", "stops", "turns", "turns at once"],
)
def test_stick_slip_between_its_borders(velocity, acceleration, deceleration):
    _, found = sliding(velocity, acceleration, deceleration)
    at, expected = np.array([velocity, acceleration, deceleration]), np.empty((2, 3))
    for k, step in enumerate((1e-8, 1e-4, 1e-4)):
        change = step * np.eye(3)[k]
        expected[:, k] = (np.array(stick_slip(*(at + change), 1e-3)) - stick_slip(*(at - change), 1e-3)) / (2.0 * step)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-10)


def test_stick_slip_at_its_borders():
    """At a kink the gradient is stated by the class: one side, the mean of both, or 0; it is never nan."""
    for velocity, acceleration, deceleration in ((0.0, 40.0, 90.0), (0.0, 0.0, 90.0), (0.0, 0.0, 0.0)):
        after, gradient = sliding(velocity, acceleration, deceleration)
        assert after == [0.0, 0.0] and (gradient == 0.0).all()
    # At the torque that frees it, a motor at rest has half of h = 1e-3 s, its derivative once it slips.
    assert sliding(0.0, 90.0, 90.0)[1][0, 1] == pytest.approx(0.5e-3)
    # One that leaves rest depends on the torque as it should; by its velocity, which is 0, the gradient is 0.
    assert sliding(0.0, 150.0, 90.0)[1][0].tolist() == pytest.approx([0.0, 1e-3, -1e-3])


def test_the_root_at_zero_has_gradient_zero():
    squares = torch.tensor([0.0, 4.0], requires_grad=True)
    (gradient,) = torch.autograd.grad(root(squares).sum(), squares)
    assert gradient.tolist() == [0.0, 0.25] and root(squares).tolist() == [0.0, 2.0]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_values_are_those_without_gradients(dtype):
    torques = torch.tensor(np.random.default_rng(0).normal(0.0, 150.0, (6, 5, 2)))
    settings = {"dtype": dtype, "reference": SHORT, "disturbance": LOADED, "randomisation": SPREAD}
    both = [arms(5, differentiable=how, **settings) for how in (True, False)]
    assert torch.equal(*(envs.reset(seed=1)[0] for envs in both))
    for torque in torques:
        torch.testing.assert_close(*(envs.step(torque) for envs in both), rtol=0.0, atol=0.0)
    assert torch.equal(*(envs.state for envs in both))


def test_gradients_end_with_the_episode_and_where_they_are_cut():
    envs, torque = arms(2, reference=SHORT), torch.zeros(2, 2, dtype=torch.float64, requires_grad=True)
    envs.reset(seed=0)
    for _ in range(3):
        envs.step(torque + 200.0)
    assert envs.state.requires_grad
    observation, reward, _, truncated, info = envs.step(torque + 200.0)
    assert truncated.all()
    (gradient,) = torch.autograd.grad(info["final_obs"].sum() + reward.sum(), torque, retain_graph=True)
    assert (gradient != 0.0).all()
    (gradient,) = torch.autograd.grad(observation.sum(), torque)  # of the new episode
    assert (gradient == 0.0).all()
    later = (torque * 1.0).detach().requires_grad_()
    envs.step(later + 200.0)
    before = envs.state
    envs.detach()
    assert not envs.state.requires_grad
    assert torch.equal(envs.state, before)
    envs.step(later + 200.0)
    envs.reset(seed=0)
    assert torch.autograd.grad(before.sum(), later)[0].abs().max() > 0.0  # reset and detach left the old graph whole


def test_a_bad_lane_spoils_no_other():
    envs = arms(3)
    torques = torch.full((3, 2), 200.0, dtype=torch.float64, requires_grad=True)
    factor = torch.tensor([[1.0], [float("nan")], [5.0]])  # the third is beyond the limits
    envs.reset(seed=0)
    _, reward, terminated, _, _ = envs.step(torques * factor)
    assert terminated.tolist() == [False, True, False]
    (gradient,) = torch.autograd.grad(reward.sum(), torques)
    assert (gradient[0] != 0.0).all() and (gradient[2] == 0.0).all()


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_compiled_gradients_are_the_eager_ones(dtype):
    torques = torch.tensor(np.random.default_rng(1).normal(0.0, 200.0, (8, 5, 2)), dtype=dtype, requires_grad=True)
    weights, found = torch.ones(18, dtype=dtype), []
    for how in (True, False):
        envs = arms(5, dtype=dtype, compiled=how, substep=1e-3, reference=SHORT, randomisation=SPREAD)
        with torch.no_grad():
            followed(envs, torques, weights)  # what is compiled first does not decide what it is compiled for
        found.append(torch.autograd.grad(followed(envs, torques, weights).sum(), torques)[0])
    assert (found[1] != 0.0).any()
    tolerance = {"rtol": 1e-3, "atol": 1e-3} if dtype == torch.float32 else {"rtol": 1e-8, "atol": 1e-10}
    torch.testing.assert_close(*found, **tolerance)
