"""Balls, derivatives on them, signals and the linear equation, against values computed in another way."""

import dataclasses
import itertools

import numpy as np
import pytest
from flint import arb
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.equations import tip_point, two_joints
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.proof.tip._defects import PeriodMotion, Signal, TipForces, link_torque
from fuzzyarm.proof.tip._remainders import LinkRemainder, _Linearised
from fuzzyarm.proof.tip.enclosures import low_high
from fuzzyarm.proof.tip.plant import BallPlant, PlantSet
from fuzzyarm.proof.tip.transition import _PARTS, Linear, layout
from fuzzyarm.proof.tip.tube import _reach, tip_bound
from fuzzyarm.proof.tip.zonotope import Zonotope

ARMS, AT = two_joints(), layout(2, 2)
LINKS = np.r_[AT.rows.link, AT.rows.d_link, AT.rows.link_acceleration]
CONSTANTS = ("c1", "c2", "c3", "c4", "c5")
ARM = arm_constants(ArmParameters())
PUSH = TipForces((Signal([arb(20.0)]), Signal([arb(-5.0)])), (0.0, 0.0), np.eye(2), np.zeros(2))
RNG = np.random.default_rng(0)


pytestmark = pytest.mark.usefixtures("precision")


def plant_of(plants):
    return BallPlant.of(ArmParameters(), Disturbance(), plants)


def floats(x):
    return [float(one.mid()) for one in x]


def motion_of(scale=1e-3):
    """Return a centre of a period near a bent posture, moving."""
    angles = RNG.normal(size=(4, 8)) * scale ** np.arange(8)
    angles[:, 0] += 0.7
    return PeriodMotion(angles, 1e-3, ARMS)


def at(signal, s):
    """Return the value of a signal, or of some of its coefficients, in floats."""
    return sum(float(a.mid()) * s**i for i, a in enumerate(getattr(signal, "coefficients", signal)))


def holds(signal, s, value):
    """Return whether the balls of a signal, remainder included, hold a value at one s."""
    low, high = low_high(sum((a * arb(s) ** i if i else a for i, a in enumerate(signal.coefficients)), arb(0)))
    return low <= value <= high


def test_signals_enclose_their_values():
    motion = motion_of(0.1)
    for signal in (*motion.angle, *motion.velocity, motion.bending(0)):
        values = at(signal, np.linspace(-1.0, 1.0, 101))
        for low, high in (low_high(signal.range()), signal.ends()):
            assert low <= values.min() and values.max() <= high
        assert signal.bent() >= np.abs(values - at(signal.coefficients[:2], np.linspace(-1.0, 1.0, 101))).max()
    slope = (at(motion.angle[0], 0.3 + 1e-6) - at(motion.angle[0], 0.3 - 1e-6)) / 2e-6 * 2.0 / 1e-3
    assert at(motion.velocity[0], 0.3) == pytest.approx(slope, rel=1e-6)


def test_link_series_enclose_the_torque_and_their_remainder_is_needed():
    motion = motion_of(0.3)  # coarse, so that the remainder is seen
    force = Signal([arb(20.0), arb(3.0)]), Signal([arb(-5.0), arb(1.0)])
    torques = motion.link_torques(force, ARM)
    for s in np.linspace(-1.0, 1.0, 41):
        parts = [[arb(at(signal, s)) for signal in kind] for kind in motion.links]
        exact = floats(link_torque(ARMS, parts, [arb(at(part, s)) for part in force], ARM))
        for signal, value in zip(torques, exact, strict=True):
            assert holds(signal, s, value)
    without = [at(signal.coefficients[:-1], 1.0) for signal in torques]
    assert max(abs(a - b) for a, b in zip(without, exact, strict=True)) > 1e-3  # the last coefficient holds this


def pushed(x, arm=ARM):
    """Return R (2,) under a force of (20, -5) N at angles, velocities and accelerations (6,)."""
    return np.array(floats(link_torque(ARMS, [map(arb, p) for p in x.reshape(3, 2)], (20.0, -5.0), arm)))


def test_link_remainder_bounds_sampled_values():
    """R(y + δ) - R(y) - (M δq̈ + G δq + D δq̇) within the bound, and not far below it."""
    motion, tube = motion_of(1e-2), np.zeros(18)
    tube[AT.rows.link], tube[AT.rows.d_link], tube[AT.rows.link_acceleration] = 2e-3, 0.1, 5.0
    linearised = _Linearised(motion, PUSH, plant_of(PlantSet()), ARM)
    bound, worst, (mass, stiff, damp) = linearised.left_out(tube), np.zeros(2), linearised.at
    for _ in range(400):
        s, sides = RNG.uniform(-1.0, 1.0), RNG.choice([-1.0, 1.0], 6) * RNG.uniform(0.8, 1.0, 6)
        base = np.array([at(signal, s) for kind in motion.links for signal in kind])
        delta = sides * tube[LINKS]
        change = pushed(base + delta) - pushed(base)
        worst = np.maximum(worst, np.abs(change - stiff @ delta[:2] - damp @ delta[2:4] - mass @ delta[4:]))
    assert (worst <= bound).all()
    assert (worst > 0.05 * bound).all()


@pytest.mark.parametrize("plants", [PlantSet(mass=(0.9, 1.1)), PlantSet(payload=(0.0, 0.5))], ids=["mass", "payload"])
def test_products_of_masses_are_bounded_for_links_that_turn_against_each_other(plants):
    """n = R(y + δ; p) - R(y; p) - (M δq̈ + G δq + D δq̇) for corners p, δ in a thin zonotope; the bound is needed."""
    motion, plant = motion_of(1e-2), plant_of(plants)
    remainder = LinkRemainder(motion, PUSH, plant)
    certain = LinkRemainder(motion, PUSH, dataclasses.replace(plant, parameters=()))
    columns = np.zeros((18, 2))  # accelerations against each other, and a little of all
    columns[AT.rows.link_acceleration] = [[5.0, 0.1], [-12.0, 0.1]]
    columns[AT.rows.link], columns[AT.rows.d_link] = 1e-5, 1e-4
    own = remainder.products @ columns[AT.observed]
    free = np.abs(np.vstack([columns, own])).sum(axis=1)
    bound = remainder.bound(free[:18], np.zeros(8), free, np.zeros((len(free), 8)))
    arms = [parameter.arm for parameter in plant.parameters]
    signs = itertools.product((-1.0, 1.0), repeat=len(arms))
    of_masses = bound - certain.bound(free[:18], np.zeros(8), free[:18], np.zeros((18, 8)))
    coarse = remainder.bound(free[:18], np.zeros(8), 1e9 * free, np.zeros((len(free), 8)))
    worst, (mass, stiff, damp) = np.zeros(2), remainder.at
    for sign, g in itertools.product(signs, np.array([[1.0, 1.0], [1.0, -1.0], [-0.7, 1.0]])):
        more = {c: sum(x * float(getattr(a, c)) for x, a in zip(sign, arms, strict=True)) for c in CONSTANTS}
        arm = plant.middle._replace(**{c: getattr(plant.middle, c) + value for c, value in more.items()})
        delta = columns[LINKS] @ g
        base = np.array([at(signal, 0.3) for kind in motion.links for signal in kind])
        change = pushed(base + delta, arm) - pushed(base, arm)
        worst = np.maximum(worst, np.abs(change - stiff @ delta[:2] - damp @ delta[2:4] - mass @ delta[4:]))
        middle = pushed(base + delta, plant.middle) - pushed(base, plant.middle)
        assert (np.abs(change - middle) <= of_masses).all()
    assert (worst <= bound).all() and (worst > 0.3 * bound).any()
    assert (bound < coarse).any()


def over_a_period():
    """Return a linear equation and its solution."""
    mass = np.array([[5.8, 1.5], [1.5, 0.75]])
    stiff, damp = RNG.normal(size=(2, 2, 2))
    links, none = (mass, 30.0 * stiff, damp), [False] * 2
    equation = Linear.of(ARM, links, np.eye(2), np.array([3.0, 1.0]), none, none, np.zeros((0, 6)))
    return equation, equation.over(1e-3)


def held_over(equation, duration):
    """Return the exact integral of exp(A t) b."""
    big = np.block([[equation.A, equation.b], [np.zeros((8, 18))]])
    return expm(big * duration)[:10, 10:]


def test_transition_is_the_matrix_exponential():
    equation, found = over_a_period()
    exact = expm(equation.A * 1e-3)
    assert (np.abs(found.phi - exact) <= 1e-13 * found.growth).all()
    assert (found.growth >= np.abs(exact)).all()
    assert (np.abs(found.held - held_over(equation, 1e-3)) <= 1e-12 * found.push_state).all()


@pytest.mark.parametrize("switch", [0.0, 0.2, 0.5, 0.77, 1.0])
@pytest.mark.parametrize("channel", range(6))
def test_moments_hold_every_disturbance_and_push_every_instant(switch, channel):
    """A disturbance that switches within the period: its effect lies in the box of the two moments' directions."""
    equation, found = over_a_period()

    def rate(t, x):
        return equation.A @ x + equation.b[:, channel] * (1.0 if t < switch * 1e-3 else -1.0)

    times = np.linspace(0.0, 1e-3, 21)
    path = solve_ivp(rate, (0.0, 1e-3), np.zeros(10), rtol=1e-10, atol=1e-16, max_step=1e-5, t_eval=times).y
    directions = found.moments[..., channel].reshape(-1, 10)
    reach = np.abs(directions).sum(axis=0) + found.beyond[:, channel]
    assert (np.abs(path[:, -1]) <= reach * (1 + 1e-6) + 1e-18).all()
    rows = np.arange(14)  # without accelerations, which jump with the disturbance
    assert (np.abs(equation.S @ path)[rows].max(axis=1) <= found.push[rows, channel] + 1e-18).all()
    # Projected on any direction, the zonotope of the moments holds it.
    weights = RNG.normal(size=(50, 10)) / np.maximum(reach, 1e-18)
    inside = np.abs(weights @ directions.T).sum(axis=1) + np.abs(weights) @ found.beyond[:, channel]
    assert (np.abs(weights @ path[:, -1]) <= inside * (1 + 1e-6)).all()


def test_second_moments_are_needed():
    """Set to zero, the second moment leaves disturbances out."""
    equation, found = over_a_period()
    part = 1e-3 / _PARTS  # the last part of the period, in whose middle the sign switches
    exact = [expm(equation.A * t) @ equation.b[:, 0] for t in np.linspace(0.0, part, 201)]
    effect = sum(part / 200 * (1.0 if i < 100 else -1.0) * e for i, e in enumerate(exact[:-1]))
    first, second = found.moments[-1, :, :, 0]
    theta = AT.channels.motor.start
    assert abs(effect[theta]) > found.beyond[theta, 0] + 1e-3 * abs(first[theta])
    assert abs(effect[theta]) <= abs(second[theta]) + found.beyond[theta, 0]


def test_what_the_moments_leave_of_a_constant_disturbance():
    """∫ e^{A t} b dt over a part, less its first moment, is of third order: within the bound, and not far below it."""
    equation, found = over_a_period()
    left = np.abs(held_over(equation, 1e-3 / _PARTS) - found.moments[-1, 0])
    assert (left <= found.beyond).all()
    shares = _PARTS * left[4:8, :6] / found.beyond[4:8, :6]  # velocities, by motors, links and joints
    assert shares.max() > 0.3


def test_friction_series_enclose_the_stribeck_curve_and_their_remainder_is_needed():
    motion = PeriodMotion(np.array([[0.7, 4e-5, 1.5e-5, *[0.0] * 5]] * 4), 1e-3, ARMS)  # 0.02 to 0.14 rad/s
    signal = motion.slip(0, 1, ARM)
    for s in np.linspace(-1.0, 1.0, 21):
        exact = stribeck_magnitude(at(motion.velocity[0], s), ARM.dry_friction1)
        assert holds(signal, s, exact)
    assert abs(at(signal.coefficients[:-1], 1.0) - exact) > 1e-7


def test_a_zonotope_that_is_merged_holds_what_it_held_and_keeps_its_shape():
    """Columns along one direction stay thin across it, which a box along the axes would not."""
    z, along = Zonotope(4, 1), np.array([1.0, -2.0, 100.0, 30.0])
    z.columns[:] = RNG.normal(size=(4, 1))
    z.add(np.outer(along, RNG.normal(size=8000)) + 1e-3 * RNG.normal(size=(4, 8000)), 0)
    across = np.array([[2.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.3, -1.0]])
    rows = np.vstack([RNG.normal(size=(20, 4)), across])
    reach, first = z.size(rows), z.columns[:, 0].copy()
    z.tidy(5)
    assert z.columns.shape[1] < 4000 and (z.columns[:, 0] == first).all()
    assert (z.size(rows) >= reach * (1 - 1e-12)).all()
    assert (z.size(across) <= 3.0 * reach[-2:]).all() and (z.size(rows) <= 1.01 * reach)[:-2].all()


def test_the_totals_of_a_zonotope_hold_its_box_too():
    z = Zonotope(2, 1)
    z.columns[:], z.box = [[1.0], [-2.0]], np.array([0.5, 0.25])
    exact = np.array([1.5, 2.25])
    assert (exact <= z.totals()).all() and (z.totals() <= exact * (1.0 + 1e-9)).all()


def test_the_tip_is_within_its_bound_to_second_order():
    """The arm turns by δ = ± 0.1 rad away from a point 0.1 m beyond its tip; δ²/2 is 3 % of the error then."""
    state, turn = np.zeros(8), 0.1
    state[2] = 0.3
    deviations = Zonotope(8, 0)
    deviations.add(turn * np.eye(8)[:, [2]], 0)
    beyond = (1.1 * np.array([np.cos(0.3), np.sin(0.3)])).tolist()
    bound, _ = tip_bound(state, deviations, plant_of(PlantSet()), beyond)
    tip = tip_point(PerJoint(np.array([0.3 - turn, 0.3 + turn]), np.zeros(2)), ARM)
    errors = np.hypot(tip.x - beyond[0], tip.y - beyond[1])
    assert 0.98 * bound < errors.max() <= bound


def test_the_directions_that_are_left_out_never_hold_the_farthest_point():
    """The largest reach of 48 directions, for round and thin sets; of thin ones a third of the directions is enough."""
    rng, turns = np.random.default_rng(8), np.pi * np.arange(48) / 48
    units = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    for thin in (1.0, 0.3, 1e-3):
        counts = []
        for angle in rng.uniform(0.0, np.pi, 20):
            z, cosine, sine = Zonotope(2, 0), np.cos(angle), np.sin(angle)
            z.add([[cosine, -sine], [sine, cosine]] @ ([[1.0], [thin]] * rng.normal(size=(2, 30))), 0)
            aside, every = np.abs(units @ rng.normal(size=2)), z.size(units)
            found, reached = _reach(z, units, aside)
            counts.append(reached.sum())
            assert found[reached].max() == every.max() and (found + aside)[reached].max() == (every + aside).max()
        assert thin == 1.0 or np.median(counts) < 32
