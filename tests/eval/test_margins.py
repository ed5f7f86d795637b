"""Margins: the assembly on loops solved by hand, the linear prediction against the nonlinear arm."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fuzzyarm.envs.dynamics import arm_constants, gravity_torque
from fuzzyarm.envs.integrator import hold
from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.eval import margins
from fuzzyarm.eval.margins import LocalLoop, gain_margin, linearise, linearise_path, spectral_radius
from fuzzyarm.eval.rollout import Policy
from fuzzyarm.fuzzy_policy.computed_torque import ComputedTorquePolicy
from fuzzyarm.policies import load_policy

ARM = ArmParameters()
SMOOTH = dataclasses.replace(ARM, static_friction=(0.0, 0.0), coulomb_friction=(0.0, 0.0))
PERIOD = 1e-3
POSTURE = np.array([0.3, 1.2])
PLANT = slice(0, 8)
POLICIES = {"fuzzy-4": load_policy("fuzzy-4"), "computed-torque": ComputedTorquePolicy(ARM, PERIOD, 50.0)}


class Springs:
    """u = (60, 20) N m - 2e4 e - 400 ė, with a memory and a precision given by the test."""

    def __init__(self, memory: Callable[..., Any] | None = None, dtype: type = np.float64) -> None:
        self.memory, self.dtype = memory, dtype

    def predict(self, observation: np.ndarray, state: Any = None, *_: Any, **__: Any) -> tuple[np.ndarray, Any]:
        """Evaluate the law, which does not read the memory."""
        e = observation[..., :4] - observation[..., 4:8]
        torque = np.array([60.0, 20.0]) - 2e4 * e[..., :2] - 400.0 * e[..., 2:]
        return torque.astype(self.dtype), self.memory(observation, state) if self.memory else None


def count_calls(observation: np.ndarray, state: Any) -> Any:
    """A memory that grows by one a call."""
    return np.zeros((len(observation), 1)) if state is None else state + 1.0


def simulate(
    policy: Policy, posture: np.ndarray, loop: LocalLoop, deviation: np.ndarray, steps: int, gain: float, delay: int
) -> np.ndarray:
    """Plant states (steps + 1, 8) less equilibrium, of the friction-free arm started `deviation` away from it."""
    state = (loop.equilibrium[PLANT] + deviation)[:, np.newaxis]
    memory, pending = loop.equilibrium[8:], [loop.torque] * delay
    arm, no_force = np.array(arm_constants(SMOOTH))[:, np.newaxis], np.zeros((4, 1))
    reference = np.concatenate([posture, np.zeros(4)])
    states = state.copy()
    for _ in range(steps):
        action, memory = policy.predict(np.concatenate([state[[0, 1, 4, 5], 0], reference]), state=memory)
        pending.append(loop.torque + gain * (action - loop.torque))
        hold(state, pending.pop(0)[:, np.newaxis], no_force, arm, 1e-4, 10)
        states = np.hstack([states, state])
    return np.transpose(states - loop.equilibrium[PLANT, np.newaxis])


def radius(matrix: np.ndarray) -> float:
    """Largest |λ|."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def toy(plant: list[list[float]], law: list[list[float]]) -> LocalLoop:
    """A loop from plain lists; its equilibrium is the origin."""
    return LocalLoop(np.array(plant, float), np.array(law, float), np.zeros(0), np.zeros(0))


# x⁺ = x + u, u = -x/2, and the same with an integral: u = -x/2 - s/10, s⁺ = s + x.
INTEGRATOR = toy([[1, 1]], [[-0.5]])
WITH_INTEGRAL = toy([[1, 1]], [[-0.5, -0.1], [1, 1]])


@pytest.mark.parametrize("gain", [0.3, 1.0, 2.5])
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_characteristic_polynomials(gain: float, delay: int) -> None:
    """z^d (z - 1) + κ/2 without, z^d (z - 1)² + κ (z/2 - 1/2 + 1/10) with memory."""
    power = [1.0] + [0.0] * delay
    without = np.polyadd(np.polymul(power, [1, -1]), [0.5 * gain])
    with_integral = np.polyadd(np.polymul(power, [1, -2, 1]), [0.5 * gain, -0.4 * gain])
    np.testing.assert_allclose(np.poly(INTEGRATOR.matrix(gain, delay)), without, atol=1e-12)
    np.testing.assert_allclose(np.poly(WITH_INTEGRAL.matrix(gain, delay)), with_integral, atol=1e-12)


def test_two_inputs_keep_their_places_in_the_delay() -> None:
    """The characteristic polynomial of two unlike integrators side by side is the product of theirs."""
    both = toy([[1, 0, 1, 0], [0, 1, 0, 2]], [[-0.5, 0], [0, -0.1]])
    alone = [toy([[1, b]], [[k]]).matrix(1.3, 2) for b, k in ((1, -0.5), (2, -0.1))]
    np.testing.assert_allclose(np.poly(both.matrix(1.3, 2)), np.polymul(*map(np.poly, alone)), atol=1e-12)


@pytest.mark.parametrize(("delay", "upper"), [(0, 4.0), (1, 2.0), (2, math.sqrt(5.0) - 1.0)])
def test_margin_of_a_delayed_integrator(monkeypatch: pytest.MonkeyPatch, delay: int, upper: float) -> None:
    """|z| = 1 at κ = 4, 2 and √5 - 1 (by hand); the lower edge is 0, open loop."""
    monkeypatch.setattr(margins, "linearise_path", lambda *_: [INTEGRATOR])
    assert gain_margin(Springs(), ARM, control_period=PERIOD, delay=delay) == pytest.approx((0.0, upper), rel=2e-4)


def test_margins_of_a_conditionally_stable_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """x⁺ = 1.2 x + u, u = -κ x/2 is stable for 0.4 < κ < 4.4; without an input nothing ever changes."""
    monkeypatch.setattr(margins, "linearise_path", lambda *_: [toy([[1.2, 1]], [[-0.5]])])
    assert gain_margin(Springs(), ARM, control_period=PERIOD) == pytest.approx((0.4, 4.4), rel=2e-4)
    monkeypatch.setattr(margins, "linearise_path", lambda *_: [toy([[0.9, 0]], [[-0.5]])])
    assert gain_margin(Springs(), ARM, control_period=PERIOD) == (0.0, math.inf)


@pytest.mark.parametrize(("gain", "delay"), [(-1.0, 0), (math.nan, 0), (math.inf, 0), (1.0, -1), (1.0, 0.5)])
def test_matrix_refuses_gain_and_delay_out_of_range(gain: float, delay: float) -> None:
    """The message names both."""
    with pytest.raises(ValueError, match=r"loop_gain = .*, delay = "):
        INTEGRATOR.matrix(gain, delay)  # type: ignore[arg-type]


@pytest.mark.parametrize(("gain", "delay"), [(1.0, 0), (1.5, 0), (1.0, 1), (0.7, 2)])
@pytest.mark.parametrize("name", POLICIES)
def test_the_matrix_power_predicts_the_nonlinear_arm(name: str, gain: float, delay: int) -> None:
    """A deviation of about 0.01 mrad over 200 periods, in units in which angles and velocities weigh alike."""
    loop, policy = linearise(POLICIES[name], ARM, POSTURE, PERIOD), POLICIES[name]
    deviation = np.array([10.0, -5.0, 8.0, -7.0, 30.0, 200.0, -100.0, 50.0]) * 1e-6
    matrix = loop.matrix(gain, delay)
    start = np.concatenate([deviation, np.zeros(len(matrix) - 8)])
    predicted = np.array([np.linalg.matrix_power(matrix, k)[PLANT] @ start for k in range(201)])
    simulated = simulate(policy, POSTURE, loop, deviation, 200, gain, delay)
    weights = np.repeat([1.0, 0.02], 4)
    size = np.linalg.norm(predicted * weights, axis=1)
    assert size[200] < 0.2 * size.max()
    assert np.all(np.linalg.norm((simulated - predicted) * weights, axis=1) <= 0.02 * size + 1e-11)


def test_equilibrium_of_a_loop_with_integral() -> None:
    """Motors on the reference, links bent by their gravity torque, at rest, and the motors carry that torque."""
    loop = linearise(POLICIES["fuzzy-4"], ARM, POSTURE, PERIOD)
    motor, link = loop.equilibrium[:2], loop.equilibrium[2:4]
    gravity = gravity_torque(np.sin(link[0]), np.sin(link.sum()), arm_constants(ARM))
    np.testing.assert_allclose(motor, POSTURE, atol=1e-9)
    np.testing.assert_allclose(motor - link, np.divide(gravity, ARM.stiffness), atol=1e-10)
    np.testing.assert_allclose(loop.torque, gravity, atol=1e-6)
    np.testing.assert_allclose(loop.equilibrium[4:8], 0.0, atol=1e-9)


def test_a_computed_torque_that_is_far_too_fast_diverges() -> None:
    """400 rad/s: radius above 1, and the arm agrees."""
    policy = ComputedTorquePolicy(ARM, PERIOD, 400.0)
    assert spectral_radius(policy, ARM, control_period=PERIOD) > 1.0
    assert np.isnan(gain_margin(policy, ARM, control_period=PERIOD)).all()
    loop = linearise(policy, ARM, POSTURE, PERIOD)
    path = simulate(policy, POSTURE, loop, np.full(8, 1e-9), 100, 1.0, 0)
    assert np.abs(path[-20:]).max() > 1e5 * np.abs(path[0]).max()


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("name", POLICIES)
def test_the_arm_settles_below_the_upper_margin_and_diverges_above(name: str, delay: int) -> None:
    """At the posture that is the first to go, 3 % to either side."""
    policy = POLICIES[name]
    _, upper = gain_margin(policy, ARM, control_period=PERIOD, delay=delay)
    loop = max(linearise_path(policy, ARM, PERIOD), key=lambda loop: radius(loop.matrix(1.01 * upper, delay)))
    posture = loop.equilibrium[:2]  # with integral action the motors stand on the reference
    deviation = np.repeat([1e-7, 0.0], 4)
    below, above = (simulate(policy, posture, loop, deviation, 1500, k * upper, delay) for k in (0.97, 1.03))
    assert np.abs(below[-50:]).max() < 1e-2 * np.abs(below).max()
    assert np.abs(above[-50:]).max() > 1e3 * np.abs(above[:50]).max()


def test_one_extra_sample_of_delay_costs_margin() -> None:
    """Delay never helped these loops; the radius at the upper edge is 1."""
    policy = POLICIES["fuzzy-4"]
    uppers = [gain_margin(policy, ARM, control_period=PERIOD, delay=delay)[1] for delay in (0, 1, 2)]
    assert uppers == sorted(uppers, reverse=True)
    for delay, upper in enumerate(uppers):
        at_the_edge = spectral_radius(policy, ARM, control_period=PERIOD, loop_gain=upper, delay=delay)
        assert at_the_edge == pytest.approx(1.0, abs=2e-4)


def test_memory_that_the_torque_does_not_read_is_left_out() -> None:
    """A call counter adds no eigenvalue 1: the loop is that of the policy without memory, motors bent off."""
    plain, counting = (linearise(Springs(memory), ARM, POSTURE, PERIOD) for memory in (None, count_calls))
    np.testing.assert_array_equal(counting.matrix(), plain.matrix())
    assert plain.matrix().shape == (8, 8) and radius(plain.matrix()) < 1.0
    assert 1e-5 < np.abs(plain.equilibrium[:2] - POSTURE).max() < 1e-2


def test_policies_that_cannot_be_linearised_are_refused() -> None:
    """A state that is no array, single precision, and a torque at its limit."""
    with pytest.raises(TypeError, match="state tuple"):
        linearise(Springs(lambda *_: (0, 0)), ARM, POSTURE, PERIOD)
    with pytest.raises(TypeError, match="float32"):
        linearise(Springs(dtype=np.float32), ARM, POSTURE, PERIOD)
    weak = dataclasses.replace(ARM, torque_limit=(20.0, 10.0))
    with pytest.raises(ValueError, match="limit"):
        linearise(Springs(), weak, POSTURE, PERIOD)
    with pytest.raises(ValueError, match="no equilibrium"):
        linearise(ComputedTorquePolicy(weak, PERIOD, 50.0), ARM, POSTURE, PERIOD)
