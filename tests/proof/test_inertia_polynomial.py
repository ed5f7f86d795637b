import numpy as np
import pytest
from flint import fmpq

from fuzzyarm.envs.physics.rigid_body import mass_matrix
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.proof.box_cover import TrigMatrix, _control_weights, cover, proven_in_balls
from fuzzyarm.proof.definiteness import exact
from fuzzyarm.proof.inertia_bounds import BASIS, angle_ranges, inertia_polynomial
from fuzzyarm.synthesis._inertia_metric import _twist_map

TURN = np.array([[-3.141593, 3.141593]])


def angles(count, n, seed=0):
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, n))


@pytest.mark.parametrize("name", ["planar-3r", "paper"])
def test_exact_coefficients_are_those_of_the_mass_matrix(name):
    robot = robot_named(name)
    n, q = len(robot), angles(50, len(robot))
    inertia = TrigMatrix(inertia_polynomial(robot, 0, n))
    assert np.abs(inertia.at(q[:, 1:]) - mass_matrix(robot, q)).max() < 1e-14
    for k, step in enumerate(1e-5 * np.eye(n - 1)):
        difference = (inertia.at(q[:, 1:] + step) - inertia.at(q[:, 1:] - step)) / 2e-5
        assert np.abs(inertia.derivative(k).at(q[:, 1:]) - difference).max() < 1e-8


@pytest.mark.parametrize(("name", "split"), [("ur5", 4), ("ur5", 3), ("panda", 4)])
def test_a_split_chain_has_the_inertia_of_the_whole(name, split):
    robot = robot_named(name)
    n, q = len(robot), angles(20, len(robot))
    J, D = _twist_map(robot, q, split), TrigMatrix(inertia_polynomial(robot, split, n)).at(q[:, split:])
    near = TrigMatrix(inertia_polynomial(robot, 0, split, exact(np.zeros(D.shape[1:]))))
    whole = near.at(q[:, 1:split]) + np.swapaxes(J, 1, 2) @ D @ J
    assert np.abs(whole - mass_matrix(robot, q)).max() < 1e-13
    # The constant in place of D goes through the same map.
    W = np.random.default_rng(1).normal(size=D.shape[1:])
    W = exact(W + W.T)
    tail = TrigMatrix(inertia_polynomial(robot, 0, split, W)).at(q[:, 1:split]) - near.at(q[:, 1:split])
    assert np.abs(tail - np.swapaxes(J, 1, 2) @ W.astype(float) @ J).max() < 1e-13


def test_control_values_reproduce_the_function():
    """f(q) = Σ f_i κ_i a^(4-i) b^i, and the weights are >= 0 with the sum 1."""
    m, h, t = 0.7, 0.6, np.linspace(-0.6, 0.6, 13)
    weights = np.array(_control_weights(np.cos(m), np.sin(m), np.cos(h), np.sin(h)))
    a, b, c = np.sin((h - t) / 2) / np.sin(h), np.sin((h + t) / 2) / np.sin(h), np.cos(h)
    kappa = np.array([1, 4 * c, 2 + 4 * c * c, 4 * c, 1])
    mean = np.array([kappa[i] * a ** (4 - i) * b**i for i in range(BASIS)])
    np.testing.assert_allclose(mean.sum(axis=0), 1.0, rtol=1e-14)
    assert mean.min() >= 0.0
    functions = np.array([np.ones_like(t), *(f(k * (m + t)) for k in (1, 2) for f in (np.cos, np.sin))])
    np.testing.assert_allclose(weights.T @ mean, functions, atol=1e-14)


def test_the_excess_of_the_hull_falls_with_the_square_of_the_width():
    weights = np.array([_control_weights(1.0, 0.0, np.cos(h), np.sin(h)) for h in (0.4, 0.2, 0.1)])
    excess = weights[:, :, 1].max(axis=1) - 1.0  # of cos t about its maximum
    orders = np.log2(excess[:-1] / excess[1:])
    assert np.all(np.abs(orders - 2.0) < 0.1)


def test_a_cover_proves_what_holds_and_nothing_else():
    """cos q + c > 0 for all q if and only if c > 1."""
    coefficients = np.zeros((BASIS, 1, 1))
    coefficients[1] = 1.0
    for constant, holds in ((1.0 + 1e-6, True), (1.0, False), (1.0 - 1e-9, False)):
        coefficients[0] = constant
        matrix = TrigMatrix(exact(coefficients))
        boxes, witness = cover(matrix, TURN, most=5000)
        assert (witness is None) is holds
        if holds:
            assert proven_in_balls(matrix, boxes)
            assert np.diff(boxes[:, 0]).sum() == pytest.approx(np.diff(TURN).sum(), rel=1e-12)
    coefficients[0] = 0.9
    _, witness = cover(TrigMatrix(exact(coefficients)), TURN)
    assert np.cos(witness[0]) + 0.9 <= 0.0


def test_a_cover_allows_for_the_rounding_of_its_floats():
    """The determinant is -1e-25, the floats of the same matrix pass Cholesky's factorisation."""
    coefficients, shares = np.full((BASIS, 2, 2), fmpq(0), dtype=object), [fmpq(k, 13) for k in range(1, 13)]
    x = next(x for x in shares if float(x) * float(x) < float(x * x))
    coefficients[0] = [[fmpq(1), x], [x, x * x - fmpq(1, 10**25)]]
    matrix = TrigMatrix(coefficients)
    assert (np.linalg.eigvalsh(matrix.at(np.zeros((1, 1)))[0]) >= 0.0).all()
    assert np.isfinite(np.linalg.cholesky(matrix.at(np.zeros((1, 1)))[0])).all()
    assert cover(matrix, np.array([[-0.1, 0.1]]), most=200)[1] is not None


def test_balls_refuse_a_box_where_the_matrix_is_not_definite():
    coefficients = np.zeros((BASIS, 2, 2))
    coefficients[0], coefficients[1] = np.eye(2), np.array([[0.0, 1.0], [1.0, 0.0]])
    matrix = TrigMatrix(exact(0.999 * coefficients + 0.001 * coefficients[:1]))
    assert proven_in_balls(matrix, np.array([[[1.0, 2.0]]]))
    assert not proven_in_balls(TrigMatrix(exact(coefficients)), np.array([[[-0.3, 0.3]]]))


def test_a_whole_turn_is_widened_beyond_pi():
    assert np.abs(angle_ranges(robot_named("ur5"))).min() > np.pi
    panda = robot_named("panda")
    np.testing.assert_array_equal(angle_ranges(panda), [joint.angle_range for joint in panda.joints])
