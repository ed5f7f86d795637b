"""The certificate against the rollout: the rigid continuous-time arm keeps what a controller file claims."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm.envs.scenario.reference import JointReference, ReferenceSample
from fuzzyarm.fuzzy_policy.ts_model import premises
from fuzzyarm.policies import load_policy
from fuzzyarm.proof import rigid_loop as frozen
from fuzzyarm.proof.rigid_loop import (
    _HELD,
    Motion,
    RigidLoop,
    Run,
    _discrete,
    _joined,
    _lyapunov_rate,
    _slowest_error,
    _Uniform,
    gain_at,
    library,
    worst_posture,
    worst_torque,
)

NAMES = ("fuzzy-1", "fuzzy-4")
CIRCLE = JointReference()
STEP = 1e-3
AMPLITUDE = 100.0  # N m
NOTHING = _joined(np.zeros((2, 1, 2)))


@pytest.fixture(autouse=True)
def short_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search for 20 generations, not 150: the worst points come out as tight as the tests ask for."""
    monkeypatch.setattr(frozen, "GENERATIONS", 20)


@functools.cache
def shipped(name: str) -> RigidLoop:
    """The loop of a shipped controller; other tests prove the file."""
    return RigidLoop(load_policy(name, allow_unproven=True).controller)  # type: ignore[attr-defined]


def lasting(fast: float, slow: float) -> pytest.MarkDecorator:
    """Run one controller for a shorter time [s] in the fast suite, and each for the longer in the slow one."""
    longer = [pytest.param(name, slow, marks=pytest.mark.slow) for name in NAMES]
    return pytest.mark.parametrize(("name", "duration"), [("fuzzy-4", fast), *longer])


def states(seed: int, lanes: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles and velocities all over the box."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-np.pi, np.pi, (lanes, 2)), rng.uniform(-15.0, 15.0, (lanes, 2))


def errors(loop: RigidLoop, seed: int, lanes: int, largest: float) -> np.ndarray:
    """Errors spread like the ellipsoid of V, |q - q_d| up to `largest` [rad]."""
    e = np.random.default_rng(seed).normal(size=(lanes, loop.states)) @ np.linalg.cholesky(loop.controller.P).T
    return e * (largest / np.abs(e[:, :2]).max(axis=1))[:, np.newaxis]


def decays(run: Run, alpha: float) -> bool:
    """V(t) <= V(0) exp(-2αt) in the box, at every instant; down to 1e-27 of V(0) nothing is lost to rounding."""
    bound = run.V[0] * np.exp(-2.0 * alpha * run.t)[:, np.newaxis]
    return bool(np.all((bound >= run.V) | ~run.in_box))


def disturbed(loop: RigidLoop, motion: Motion, duration: float, *, total: bool = True) -> Run:
    """From zero error under the whole library and the worst torques about this motion."""
    torques = list(library(duration, STEP).values())
    torques += [worst_torque(loop, motion, duration, stored=stored, step=STEP) for stored in (False, True)]
    stacked = AMPLITUDE * np.stack(torques, axis=1)
    start = np.zeros((len(torques), loop.states))
    return loop.simulate(motion, start, _joined(stacked, STEP), duration, total=total, step=STEP)


@pytest.mark.parametrize("name", [*NAMES, "fuzzy-2", "fuzzy-32"])
def test_the_law_is_that_of_the_policy(name: str) -> None:
    """At random states, targets and integrals, where the policy's torque is not at its limit."""
    policy, loop, rng = load_policy(name, allow_unproven=True), shipped(name), np.random.default_rng(4)
    (q, dq), error = states(5, 300), 1e-3 * rng.normal(size=(300, 6)) * [1, 1, 50, 50, 0.1, 0.1]
    r = np.hstack([q - error[:, :2], dq - error[:, 2:4], rng.normal(size=(300, 2))])
    action, _ = policy.predict(np.hstack([q, dq, r]), state=error[:, 4:])
    gain, feedforward = loop.law(premises(q, dq, loop.controller.model.parameters))
    u = (gain @ error[..., np.newaxis] + feedforward @ r[..., np.newaxis])[..., 0]
    free = np.abs(action) < np.array(loop.controller.model.parameters.torque_limit)
    assert free.mean() > 0.5
    np.testing.assert_allclose(u[free], action[free], rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("total", [True, False])
@pytest.mark.parametrize("name", [*NAMES, "fuzzy-32"])
def test_error_dynamics_are_the_frozen_loop_exactly(name: str, total: bool) -> None:
    """ē' = F(z) ē + G(z) w at errors of any size: the nonlinear arm is the quasi-linear system, ρ included."""
    loop, (q, dq), rng = shipped(name), states(6, 100), np.random.default_rng(7)
    error = rng.normal(size=(100, 6)) * [0.3, 0.3, 3.0, 3.0, 0.01, 0.01]
    target = ReferenceSample(q, dq, rng.uniform(-50.0, 50.0, (100, 2)))
    torque = rng.normal(size=(100, 2)) * 100.0
    rate, w = loop.error_rate(error, target, torque, total=total)
    F, G = loop.frozen(q + error[:, :2], dq + error[:, 2:4])
    np.testing.assert_allclose(rate, (F @ error[..., None] + G @ w[..., None])[..., 0], rtol=1e-10, atol=1e-8)
    assert np.array_equal(w, torque) == total or name == "fuzzy-32"


def test_runge_kutta_converges_with_order_four() -> None:
    loop, start = shipped("fuzzy-4"), errors(shipped("fuzzy-4"), 9, 8, 0.2)

    def sine(t: np.ndarray) -> np.ndarray:
        return 50.0 * np.sin(40.0 * t)[:, np.newaxis, np.newaxis] * np.ones(2)

    def end(step: float) -> np.ndarray:
        run = loop.simulate(CIRCLE, start, sine, 0.036, step=step)
        return np.stack([run.V[-1], run.output[-1], run.input[-1], run.dissipation[-1]])

    steps, exact = np.array([4e-3, 3e-3, 2e-3, 1e-3]), end(2e-4)
    deviations = [np.abs(end(step) / exact - 1.0).max() for step in steps]
    assert 3.8 < np.polyfit(np.log(steps), np.log(deviations), 1)[0] < 4.6
    assert np.abs(end(5e-4) / exact - 1.0).max() < 2e-6


def test_the_worst_torque_is_the_first_singular_vector() -> None:
    """Against the dense map of 0.1 s of the circle, for both outputs."""
    loop, steps = shipped("fuzzy-4"), round(0.1 / _HELD)
    move, push = _discrete(loop, CIRCLE, _HELD * (np.arange(steps) + 0.5))
    rows = np.zeros((steps, 6, steps, 2))
    for k in range(steps):
        rows[k] = np.tensordot(move[k], rows[k - 1], axes=1) if k else 0.0
        rows[k, :, k] = push[k]
    root = np.linalg.inv(np.linalg.cholesky(loop.controller.P))
    outputs = {False: np.eye(6)[:2], True: np.vstack([np.eye(6)[:2], np.sqrt(2.0 * loop.controller.alpha) * root])}
    for stored, C in outputs.items():
        dense = np.einsum("ab,kbjc->kajc", C, rows).reshape(-1, 2 * steps)
        torque = worst_torque(loop, CIRCLE, 0.1, stored=stored, step=_HELD / 2)[1::2].ravel()
        gain = np.linalg.norm(dense @ torque) / np.linalg.norm(torque)
        assert gain == pytest.approx(np.linalg.norm(dense, ord=2), rel=1e-3)


@lasting(0.24, slow=1.5)
def test_without_disturbance_the_error_decays_as_certified(name: str, duration: float) -> None:
    """Random errors on the circle, over its 1.5 s V falls by 26 decades; then at and across random postures."""
    loop = shipped(name)
    alpha = loop.controller.alpha
    run = loop.simulate(CIRCLE, errors(loop, 11, 30, 0.1), NOTHING, duration, step=STEP)
    assert run.in_box[-1].mean() > 0.5 and decays(run, alpha)
    q, dq = states(12, 60)
    run = loop.simulate(_Uniform(0.6 * q, 0.3 * dq), errors(loop, 13, 60, 0.2), NOTHING, 0.25 * duration, step=STEP)
    assert run.in_box[50].mean() > 0.4 and decays(run, alpha)
    weak = RigidLoop(dataclasses.replace(loop.controller, gains=0.3 * loop.controller.gains))  # the check can fail
    assert not decays(weak.simulate(CIRCLE, errors(weak, 14, 10, 0.05), NOTHING, 0.15, step=STEP), alpha)


@pytest.mark.parametrize("name", slow_but(["fuzzy-4"], NAMES))
def test_the_slowest_start_shows_the_rate_and_no_less(name: str) -> None:
    """Where V decays slowest, found by search, the rollout meets that rate: α holds, 1.03 α is refuted."""
    loop = shipped(name)
    P, alpha = loop.controller.P, loop.controller.alpha
    found = loop.worst_point(lambda F, G, omega: -_lyapunov_rate(F, P))
    dq = 0.98 * found.dq[np.newaxis]
    # From a worst posture at the border of the box, the arm must not leave the box
    room = np.pi - 0.02 * np.abs(dq) - 0.01
    q = np.clip(found.q[np.newaxis], -room, room)
    start = 1e-3 * _slowest_error(loop.frozen(q, dq)[0], P)
    run = loop.simulate(_Uniform(q - start[:, :2], dq - start[:, 2:4]), start, NOTHING, 0.02, step=2e-4)
    assert run.in_box.all() and decays(run, alpha) and not decays(run, 1.03 * alpha)
    assert alpha < run.rate.min() < 1.03 * alpha
    assert run.rate[0, 0] == pytest.approx(-found.value, rel=0.01)


@pytest.mark.parametrize("total", [True, False])
@lasting(0.2, slow=0.75)
def test_no_disturbance_exceeds_the_gain(name: str, duration: float, total: bool) -> None:
    """Along the circle, w from the library and the worst, or the same as d with ρ on top of it."""
    loop = shipped(name)
    run = disturbed(loop, CIRCLE, duration, total=total)
    assert run.in_box.all()
    assert run.gain.max() <= loop.controller.gamma
    assert run.dissipation.max() <= 0.0
    assert np.all(run.dissipation[-1] < 0.0)


@lasting(0.3, slow=0.8)
def test_the_worst_torque_at_the_worst_posture(name: str, duration: float) -> None:
    """It comes within 4 % of the largest frozen gain at rest, above the whole library and below γ."""
    loop = shipped(name)
    motion, gamma = worst_posture(loop), loop.controller.gamma
    run = disturbed(loop, motion, duration)
    best = run.gain.max(axis=0)
    assert run.in_box.all() and run.dissipation.max() <= 0.0
    assert best.max() <= gamma
    F, G = loop.frozen(motion.q, motion.dq)
    frozen_gain = max(gain_at(F, G, np.array([1j * omega]))[0] for omega in np.arange(30.0, 120.0))
    assert best.argmax() == len(best) - 2
    assert 0.96 * frozen_gain < best.max() < frozen_gain
    weak = RigidLoop(dataclasses.replace(loop.controller, gains=0.3 * loop.controller.gains))  # the check can fail
    run = disturbed(weak, worst_posture(weak), duration)
    assert run.gain[:, run.in_box[-1]].max() > gamma and run.dissipation.max() > 0.0
