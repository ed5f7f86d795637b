"""The T-S model: rigorous bounds, convex memberships, exactness."""

import itertools
import operator
from fractions import Fraction

import mpmath
import numpy as np
import pytest

from fuzzyarm import ArmParameters, TSModel
from fuzzyarm.envs.physics.dynamics import arm_constants, coriolis_torque, gravity_torque, mass_matrix
from fuzzyarm.fuzzy_policy.ts_model import _SINC_MINIMUM, NAMED_RULES, PREMISES, premises

ARM = ArmParameters()
OTHER_ARM = ArmParameters(length=(0.3, 0.7), mass=(3.7, 11.3), mass_center=(0.11, 0.31), velocity_limit=(7.0, 9.0))
SUBSETS = [subset for count in range(6) for subset in itertools.combinations(PREMISES, count)]


def random_states(count, parameters=ARM, seed=0):
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1, 1, (count, 2)) * parameters.joint_limit
    return q, rng.uniform(-1, 1, (count, 2)) * parameters.velocity_limit


def test_sinc_minimum_is_a_lower_bound_and_tight():
    with mpmath.workdps(40):
        x = mpmath.findroot(lambda x: mpmath.tan(x) - x, 4.4934)
        exact = mpmath.sin(x) / x
        stored = mpmath.mpf(_SINC_MINIMUM.numerator) / _SINC_MINIMUM.denominator
        assert 0 < exact - stored < mpmath.mpf("1e-15")


@pytest.mark.parametrize("parameters", [ARM, OTHER_ARM])
def test_bounds_contain_the_exact_range(parameters):
    """The bounds are compared in exact arithmetic with the extreme values the premises attain."""
    fields = parameters.mass, parameters.mass_center, parameters.velocity_limit
    (m1, m2), (r1, r2), (speed1, speed2) = (map(Fraction, pair) for pair in fields)
    l1, g = Fraction(parameters.length[0]), Fraction(parameters.gravity)
    c2, c4, c5 = m2 * l1 * r2, m1 * g * r1 + m2 * g * l1, m2 * g * r2
    low, high = ([Fraction(x) for x in side] for side in TSModel(parameters).bounds.T)
    smallest = [-1, -(c4 + c5), -c5, -c2 * speed2, -c2 * speed1]
    largest = [1, -c5 * _SINC_MINIMUM, -c5 * _SINC_MINIMUM, c2 * speed2, c2 * speed1]
    assert all(map(operator.lt, low, smallest)) and all(map(operator.gt, high, largest))


def test_bounds_agree_with_the_paper_where_it_prints_them():
    expected = [(-1, 1), (-103.01, 4.79), (-22.07, 4.79), (-16.87, 16.87), (-16.87, 16.87)]
    np.testing.assert_allclose(TSModel(ARM).bounds, expected, atol=0.01)
    assert TSModel(ARM).bounds[1, 1] > 4.7948  # the printed 4.79 is rounded inwards


@pytest.mark.parametrize("kept", SUBSETS, ids=lambda kept: "+".join(kept) or "none")
def test_memberships_are_convex(kept):
    """In the box and outside of it."""
    model = TSModel(ARM, kept)
    inside = [premises(q, dq, ARM) for q, dq in zip(*random_states(50), strict=True)]
    for z in (*inside, np.array([2.0, 50.0, -90.0, 1e3, -1e3])):
        h, v = model.weights(z)
        assert len(h) * len(v) == model.rules
        for weights in (h, v):
            assert weights.min() >= 0.0 and weights.max() <= 1.0
            assert abs(weights.sum() - 1.0) < 1e-14


@pytest.mark.parametrize("parameters", [ARM, OTHER_ARM])
def test_the_descriptor_form_is_the_rigid_arm(parameters):
    """E(z) ẋ = A(z) x + B u with M, C and g of the plant: u is the rigid inverse dynamics."""
    model, arm, rng = TSModel(parameters), arm_constants(parameters), np.random.default_rng(1)
    for q, dq in zip(*random_states(200, parameters), strict=True):
        ddq = rng.normal(size=2) * 50
        z = premises(q, dq, parameters)
        u = (model.E(z) @ np.concatenate([dq, ddq]) - model.A(z) @ np.concatenate([q, dq]))[2:]
        m11, m12, m22 = mass_matrix(np.cos(q[1]), arm)
        expected = (np.array([[m11, m12], [m12, m22]]) + np.diag(parameters.motor_inertia)) @ ddq
        expected += np.array(parameters.viscous_friction) * dq + coriolis_torque(np.sin(q[1]), *dq, arm)
        expected += gravity_torque(np.sin(q[0]), np.sin(q.sum()), arm)
        np.testing.assert_allclose(u, expected, rtol=0, atol=1e-11 * np.abs(expected).max() + 1e-11)


@pytest.mark.parametrize("kept", SUBSETS, ids=lambda kept: "+".join(kept) or "none")
@pytest.mark.parametrize("arm", [ARM, OTHER_ARM], ids=["Table 1", "other"])
def test_what_is_dropped_lies_inside_the_uncertainty(kept, arm):
    """E(z) and A(z) are the convex sum plus Σ Hᵀ f W with one |f| <= 1 for each dropped premise."""
    model = TSModel(arm, kept)
    middle, radius = model.bounds.mean(axis=1), 0.5 * np.diff(model.bounds, axis=1)[:, 0]
    for q, dq in zip(*random_states(40, arm, seed=2), strict=True):
        z = premises(q, dq, arm)
        h, v = model.weights(z)
        A, E = np.tensordot(h, model.A_vertices, axes=1), np.tensordot(v, model.E_vertices, axes=1)
        share = (z - middle) / radius
        assert np.all(np.abs(share) <= 1.0)
        for block in model.uncertainties:
            changed = E if block.on == "E" else A
            changed += share[PREMISES.index(block.premises[0])] * block.H.T @ block.W
        np.testing.assert_allclose([A, E], [model.A(z), model.E(z)], rtol=0, atol=1e-11)


def test_vertices_stand_in_the_order_of_the_paper():
    """Section 6.1.2: E_1 = E(z1min), A_2 = A(z2max, z3min), A_3 = A(z2min, z3max)."""
    model = TSModel(ARM, NAMED_RULES[8])
    low, high = model.bounds.T
    second, third = (np.array([low[0], *gravity, 0.0, 0.0]) for gravity in ((high[1], low[2]), (low[1], high[2])))
    np.testing.assert_array_equal(model.E_vertices[0], model.E(second))
    np.testing.assert_array_equal(model.A_vertices[1:3], [model.A(second), model.A(third)])


@pytest.mark.parametrize("kept", [("z6",), ("z1", "z1"), ("z1", "cos")])
def test_bad_premises_raise_with_the_choices(kept):
    with pytest.raises(ValueError, match="z1, z2, z3, z4, z5"):
        TSModel(ARM, kept)
