"""The laws on balls are those of the policies, and their slopes are derivatives."""

import numpy as np
import pytest
from flint import arb, ctx

from fuzzyarm import load_policy
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.certified.tip.enclosures import BITS, Jet, NoBound
from fuzzyarm.eval.certified.tip.laws import asked, ball_law
from fuzzyarm.eval.certified.tip.sampled_law import sampled_law

REFERENCES = Schedule.build(JointReference(), Disturbance(), 1e-3, 2).references


@pytest.fixture(autouse=True)
def precision():
    with ctx.workprec(BITS):
        yield


def torque(law, x, sample, radius=0.0):
    parts = [[arb(one, radius) for one in pair] for pair in np.reshape(x, (3, 2))]
    return law.torque(*parts, sample)


@pytest.mark.parametrize("name", ["fuzzy-4", "fuzzy-4-tip", "fuzzy-16-tip", "fuzzy-1", "computed-torque-tip"])
def test_torques_are_those_of_the_policy(name):
    policy, rng = load_policy(name), np.random.default_rng(1)
    law, samples = ball_law(policy), asked(policy, REFERENCES[:40])
    state, integral = None, np.zeros(2)
    for row, sample in zip(REFERENCES[:40], samples, strict=True):
        measured = sample.reference[:4] + rng.normal(size=4) * 1e-3
        action, state = policy.predict(np.concatenate([measured, row]), state)
        found = torque(law, [*measured, *integral], sample)
        allowance = 2.0**-42 * found.terms
        assert allowance < 1e-6
        assert np.abs([float(u.mid()) for u in found.value] - action).max() <= max(allowance, 1e-11)
        integral += 1e-3 * (measured[:2] - sample.reference[:2])


@pytest.mark.parametrize("name", ["fuzzy-4-tip", "computed-torque"])
def test_slopes_hold_every_difference_in_the_box(name):
    """|u(x) - u(y) - G (x - y)| <= |slopes - G| |x - y| on a box, G any matrix; here zero."""
    policy, rng = load_policy(name), np.random.default_rng(2)
    law, sample = ball_law(policy), asked(policy, REFERENCES[:300])[299]
    middle = np.concatenate([sample.reference[:4] + 1e-3, [1e-5, -1e-5]])
    radius = 1e-3
    found = torque(law, middle, sample, radius)
    steepest = np.array([[float(x.abs_upper()) for x in row] for row in found.slopes])
    base = np.array([float(u.mid()) for u in torque(law, middle, sample).value])
    gaps = []
    for _ in range(60):
        step = radius * rng.uniform(-1.0, 1.0, 6)
        moved = np.array([float(u.mid()) for u in torque(law, middle + step, sample).value])
        assert (np.abs(moved - base) <= steepest @ np.abs(step) * (1 + 1e-12)).all()
        linear = np.array([[float(x.mid()) for x in row] for row in found.slopes]) @ step
        spread = np.array([[float(x.rad()) for x in row] for row in found.slopes]) @ np.abs(step)
        assert (np.abs(moved - base - linear) <= spread * (1 + 1e-9) + 1e-13).all()
        gaps.append(np.abs(moved - base - linear).max())
    assert max(gaps) > 1e-6  # the spread of the slopes is needed


def test_where_a_membership_function_is_clipped_the_law_is_the_policys_and_at_the_corner_there_is_no_bound():
    policy = load_policy("fuzzy-16")
    law, sample = ball_law(policy), asked(policy, REFERENCES[:1])[0]
    outside = [0.5, 0.5, 0.0, 40.0, 0.0, 0.0]  # q̇2 is far beyond its bound, so that z4 is
    found = torque(law, outside, sample, 1e-6)
    action = np.empty((1, 2))
    policy.act(np.array([[*outside[:4], *REFERENCES[0]]]), np.zeros((1, 2)), action)
    assert np.abs([float(u.mid()) for u in found.value] - action[0]).max() < 1e-6
    with pytest.raises(NoBound, match="membership"):
        torque(law, outside, sample, 39.9)  # from within the bounds to beyond them


@pytest.mark.parametrize(("name", "reason"), [("adaptive-observer", "covariance"), ("learned-observer", "multiply")])
def test_other_policies_have_none_and_say_why(name, reason):
    with pytest.raises(NoBound, match=rf"no bound for .*{reason}.*; choose elastic-observer"):
        sampled_law(load_policy(name), REFERENCES[:1])


@pytest.mark.parametrize(
    ("middle", "radius"), [(0.04, 0.0), (-0.03, 1e-3), (0.01, 0.05), (0.0, 0.9), (0.5, 2.0), (1.0, 0.1)]
)
def test_slopes_of_sinc_hold_its_derivative_near_zero_too(middle, radius):
    slope = Jet.variable(arb(middle, radius), 0).sinc().slope(0)
    for share in (-1.0, -0.37, 0.61, 1.0):
        x = middle + share * radius
        with ctx.workprec(400):
            exact = (arb(x).cos() - arb(x).sinc()) / arb(x)
        assert slope.overlaps(exact)
    assert float(slope.rad()) < 1e-5 + 2.0 * radius
