"""The certificate against the rollout: the rigid continuous-time arm keeps what a controller file claims."""

import dataclasses
import functools

import numpy as np
import pytest
from slow_twins import slow_but
from support import rigid_loop
from support.rigid_loop import RigidLoop, disturbed, gain_at, random_decay, random_errors, slowest_decay

from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.ts_model import premises
from fuzzyarm.policies import load_policy

NAMES = ("fuzzy-1", "fuzzy-4")
CIRCLE, STEP = JointReference(), 1e-3
each_controller = pytest.mark.parametrize("name", slow_but(["fuzzy-4"], NAMES))


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Shorter searches and longer steps [s]: the results come out as tight as the tests ask for."""
    for name, value in {"GENERATIONS": 20, "STEP": STEP, "SLOWEST_STEP": 2e-4}.items():
        monkeypatch.setattr(rigid_loop, name, value)


@functools.cache
def shipped(name):
    """The loop of a shipped controller; other tests prove the file."""
    return RigidLoop(load_policy(name, allow_unproven=True).controller)


def weak(loop):
    """The loop with gains too small for its claims, which a check has to refuse."""
    return RigidLoop(dataclasses.replace(loop.controller, gains=0.3 * loop.controller.gains))


def decays(run, alpha):
    """V(t) <= V(0) exp(-2αt) in the box, at every instant; down to 1e-27 of V(0) nothing is lost to rounding."""
    bound = run.V[0] * np.exp(-2.0 * alpha * run.t)[:, np.newaxis]
    return bool(np.all((bound >= run.V) | ~run.in_box))


@pytest.mark.parametrize("name", [*NAMES, "fuzzy-2", "fuzzy-32"])
def test_it_is_the_nonlinear_arm_under_the_policy(name):
    """At errors of any size, with ρ in w, where the policy's torque is not at its limit."""
    policy, loop, rng = load_policy(name, allow_unproven=True), shipped(name), np.random.default_rng(4)
    model, arm = loop.controller.model, loop.arm
    q, dq = rng.uniform(-np.pi, np.pi, (300, 2)), rng.uniform(-15.0, 15.0, (300, 2))
    error, ddq_d, d = 1e-3 * rng.normal(size=(300, 6)) * [1, 1, 50, 50, 0.1, 0.1], *rng.normal(size=(2, 300, 2))
    x_r = np.hstack([q, dq]) - error[:, :4]
    u, _ = policy.predict(np.hstack([q, dq, x_r, ddq_d]), state=error[:, 4:])
    free = (np.abs(u) < arm.torque_limit).all(axis=1)
    assert free.mean() > 0.3
    F, G = loop.frozen(q, dq)
    for k in np.flatnonzero(free):
        z = premises(q[k], dq[k], arm)
        A, E = (
            np.tensordot(*pair, axes=1)
            for pair in zip(model.weights(z), (model.A_vertices, model.E_vertices), strict=True)
        )
        w = d[k] + ((model.A(z) - A) @ x_r[k] - (model.E(z) - E) @ [*x_r[k, 2:], *ddq_d[k]])[2:]
        rate = F[k] @ error[k] + G[k] @ w
        np.testing.assert_array_equal(rate[[0, 1, 4, 5]], error[k, [2, 3, 0, 1]])
        ddq = ddq_d[k] + rate[2:4]
        resisting = np.array(arm.motor_inertia) * ddq + np.array(arm.viscous_friction) * dq[k]
        torque = rigid_inverse_dynamics(q[k], dq[k], ddq, arm_constants(arm)) + resisting
        np.testing.assert_allclose(torque, u[k] + d[k], rtol=1e-10, atol=1e-8)


def test_runge_kutta_converges_with_order_four():
    loop = shipped("fuzzy-4")
    start = random_errors(loop, np.random.default_rng(9), 8)

    def end(step):
        ramp = 2000.0 * step * np.arange(round(0.036 / step) + 1)[:, np.newaxis, np.newaxis] * np.ones(2)
        run = loop.simulate(CIRCLE, start, 0.036, step, ramp)
        return np.stack([run.V[-1], run.gain[-1], run.input[-1], run.dissipation[-1]])

    steps, exact = np.array([4e-3, 3e-3, 2e-3, 1e-3]), end(2e-4)
    deviations = [np.abs(end(step) / exact - 1.0).max() for step in steps]
    assert 3.8 < np.polyfit(np.log(steps), np.log(deviations), 1)[0] < 4.6
    assert np.abs(end(5e-4) / exact - 1.0).max() < 2e-6


@each_controller
def test_without_disturbance_the_error_decays_as_certified(name):
    """Along the circle, and at and across random postures."""
    loop = shipped(name)
    alpha, start = loop.controller.alpha, 0.3 * random_errors(loop, np.random.default_rng(11), 30)
    run, other = loop.simulate(CIRCLE, start, 0.24, STEP), random_decay(loop, 60, 0.06)
    assert run.in_box[-1].mean() > 0.5 and decays(run, alpha)
    assert other.in_box[-1].mean() > 0.4 and decays(other, alpha)
    assert not decays(weak(loop).simulate(CIRCLE, start, 0.15, STEP), alpha)


@each_controller
def test_the_slowest_start_shows_the_rate_and_no_less(name):
    """Where V decays slowest, found by search, the rollout meets that rate: α holds, 1.03 α is refuted."""
    loop = shipped(name)
    alpha, (rate, run) = loop.controller.alpha, slowest_decay(loop)
    assert decays(run, alpha) and not decays(run, 1.03 * alpha)
    assert alpha < run.rate.min() < 1.03 * alpha
    assert run.rate[0, 0] == pytest.approx(rate, rel=0.01)


@each_controller
def test_no_disturbance_along_the_circle_or_at_the_worst_posture_exceeds_the_gain(name):
    """From zero error; the worst torque comes within 4 % of the largest frozen gain at rest, above all others."""
    loop = shipped(name)
    motion, gamma = rigid_loop.worst_posture(loop), loop.controller.gamma
    _, run = disturbed(loop, CIRCLE, 0.2)
    assert run.in_box.all() and run.gain.max() <= gamma
    assert run.dissipation.max() <= 0.0 and np.all(run.dissipation[-1] < 0.0)
    names, run = disturbed(loop, motion, 0.3)
    best = run.gain.max(axis=0)
    assert run.in_box.all() and run.dissipation.max() <= 0.0 and best.max() <= gamma
    F, G = loop.frozen(motion.q, motion.dq)
    frozen_gain = max(gain_at(F, G, np.array([1j * omega]))[0] for omega in np.arange(30.0, 120.0))
    assert names[best.argmax()] == "worst gain"
    assert 0.96 * frozen_gain < best.max() < frozen_gain
    _, run = disturbed(weak(loop), rigid_loop.worst_posture(weak(loop)), 0.3)
    assert run.gain[:, run.in_box[-1]].max() > gamma and run.dissipation.max() > 0.0
