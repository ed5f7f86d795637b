"""The bounds of the friction, against the friction law on sampled motions of the tube."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.friction import STRIBECK, friction_torque, stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.proof.tip import _defects as defects
from fuzzyarm.proof.tip import friction_bounds as friction_module
from fuzzyarm.proof.tip._defects import PeriodMotion
from fuzzyarm.proof.tip.centre import Centre, Mode
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.friction_bounds import Friction, Plan, PlanFails, Speed, check_curve
from fuzzyarm.proof.tip.plant import BallPlant, PlantSet

ARM = arm_constants(ArmParameters())
FRICTION = ARM.dry_friction1
ANYTHING = Speed(-np.inf, np.inf)


pytestmark = pytest.mark.usefixtures("precision")


def segments(velocity, torque, link_velocity):
    """Return the segments of a centre with bent joints, motor 1 at a velocity [rad/s], and the torques held."""
    state = np.array([0.7 + 1e-4, 0.8, 0.7, 0.8, velocity, 0.0, link_velocity, 0.0])
    held = np.array([ARM.stiffness1 * 1e-4 + torque, 0.0])
    return list(Centre(ARM, 1e-3, two_joints()).segments(state, held, np.zeros(4), (None, None))), held


def friction(plan, velocity=0.0, torque=5.0, known=ANYTHING, share=(1.0, 1.0)):
    (found, *_), held = segments(velocity, torque, velocity)
    plants = BallPlant.of(ArmParameters(), Disturbance(), PlantSet())
    plants = dataclasses.replace(plants, share=(share, share))
    motion = PeriodMotion(found.angles, found.duration, two_joints())
    own = Friction(0, plan, found.modes[0], motion, float(held[0]), plants, known)
    return own, motion, found.duration, motion.net_torque(0, float(held[0]), ARM)


def value(signal, s):
    return sum(float(a.mid()) * s**i for i, a in enumerate(signal.coefficients))


@pytest.mark.parametrize(
    ("velocity", "torque", "radius"), [(0.05, 5.0, 0.04), (0.01, 5.0, 0.03), (-0.02, 3.0, 0.03), (0.0, 5.5, 0.01)]
)
@pytest.mark.parametrize("share", [(1.0, 1.0), (0.8, 1.2)])
def test_mixed_bounds_every_torque_of_the_law(velocity, torque, radius, share):
    """w = Γ_f + P for sampled velocities of the tube, net torques near the centre's and factors of the friction."""
    own, motion, _, (nets, needed) = friction(Plan.MIXED, velocity, torque, share=share)
    net_radius, rng, largest = 1.0, np.random.default_rng(0), 0.0
    bound = own.bound(radius, net_radius, 0.0, 0.0)
    for _ in range(500):
        s = rng.uniform(-1.0, 1.0)
        middle, net, P = (value(signal, s) for signal in (motion.velocity[0], nets, needed))
        factor = rng.choice([share[0], 1.0, share[1]])
        v = middle + radius * rng.uniform(-1.0, 1.0)
        slips = -factor * stribeck_magnitude(v, FRICTION) * np.sign(v)
        assert abs(slips + P) <= bound
        largest = max(largest, abs(slips + P))
        total = net + net_radius * rng.uniform(-1.0, 1.0)
        if abs(middle) <= radius and abs(total) <= factor * FRICTION.static_friction:
            law = FRICTION._replace(static_friction=factor * FRICTION.static_friction)
            assert abs(friction_torque(0.0, total, law) + P) <= bound
    assert largest > 0.5 * bound


@pytest.mark.parametrize("share", [(1.0, 1.0), (0.9, 1.1)])
def test_slip_bounds_what_the_slope_leaves(share):
    own, motion, *_ = friction(Plan.SLIP, 0.08, 5.0, share=share)
    radius, rng, largest = 0.03, np.random.default_rng(1), 0.0
    bound = own.bound(radius, 1.0, 0.0, 0.0)
    for _ in range(400):
        s, delta = rng.uniform(-1.0, 1.0), radius * rng.uniform(-1.0, 1.0)
        v, factor = value(motion.velocity[0], s), rng.choice(share)
        # The signal of the uncertain factor, -(factor - 1) F(v_y), is not part of the remainder.
        exact = -factor * stribeck_magnitude(v + delta, FRICTION) + stribeck_magnitude(v, FRICTION)
        rest = exact + (factor - 1.0) * stribeck_magnitude(v, FRICTION) - own.slope * delta
        assert abs(rest) <= bound
        largest = max(largest, abs(rest))
    assert largest > 0.2 * bound


def test_plans_that_the_tube_contradicts_fail():
    with pytest.raises(PlanFails):
        friction(Plan.SLIP, 0.01)[0].bound(0.02, 0.0, 0.0, 0.0)
    for torque, known, spread in ((5.0, ANYTHING, 0.0), (5.9, Speed(0.0, 0.0), 0.2)):
        with pytest.raises(PlanFails):
            friction(Plan.HELD, 0.0, torque, known)[0].bound(0.0, spread, 0.0, 0.0)
    assert friction(Plan.HELD, 0.0, 5.0, Speed(0.0, 0.0))[0].bound(0.0, 0.5, 0.0, 0.0) == 0.0


@pytest.mark.parametrize(("velocity", "torque"), [(0.0, 5.99), (0.0, 6.01), (0.002, 5.0), (0.003, -4.0)])
def test_motions_part_no_faster_than_lemma_2_says(velocity, torque):
    """Scalar motors with other net torques: sticking, slipping, breaking away; |δv| within the bound, at times near."""
    own, motion, duration, (nets, _) = friction(Plan.MONOTONE, velocity, torque)
    start, spread, rng, largest = 1e-4, 0.5, np.random.default_rng(2), 0.0
    bound = own.parted(start, duration, own.driving(spread, 0.0, 0.0))
    for _ in range(12):
        v = value(motion.velocity[0], -1.0) + start * rng.uniform(-1.0, 1.0)
        offset = spread * rng.choice([-1.0, 1.0])
        for s in np.linspace(-1.0, 1.0, 200, endpoint=False):
            v = stepped(v, value(nets, s) + offset, duration / 200)
            parted = abs(v - value(motion.velocity[0], s + 0.01))
            assert parted <= bound * (1 + 1e-3)
        largest = max(largest, parted)
    assert largest > 0.1 * bound or abs(torque) > 5.9


def stepped(v, net, h):
    """Return v after a short step of I v̇ ∈ N - F(v) Sgn v, implicit, so that it sticks exactly."""
    free = v + h * net / ARM.motor_inertia1
    hold = h * stribeck_magnitude(v, FRICTION) / ARM.motor_inertia1
    return np.sign(free) * max(abs(free) - hold, 0.0)


def test_speeds_are_bounded_beside_the_tube():
    """A motor that is pushed back cannot turn forward, however wide the tube is."""
    own, _, duration, _ = friction(Plan.MIXED, 0.0, -5.0, Speed(-0.01, 0.0))
    assert own.after(1.0, 0.5, (-1.0, 1.0)).high == 0.0
    assert own.after(1.0, 20.0, (-1.0, 1.0)).high > 0.0  # the net torque may break it away forwards
    # Known to be slower than 0.01 rad/s, it is at rest or turns back within I v/(N + F).
    slowing = friction(Plan.MIXED, 0.0, -5.0, Speed(-0.01, 0.01))[0].after(1.0, 0.0, (-1.0, 1.0)).high
    end = solve_ivp(lambda t, v: [(-5.0 - 6.0) / ARM.motor_inertia1], (0.0, duration), [0.01]).y[0, -1]
    assert max(end, 0.0) <= slowing < 0.01


def test_centres_divide_a_period_where_a_motor_breaks_away():
    parts, _ = segments(-0.001, 1.0, 0.0)
    assert [part.modes[0] for part in parts][:2] == [Mode.BACKWARD, Mode.REST]
    assert parts[0].end[4] == 0.0 and sum(part.duration for part in parts) == 1e-3


def scaled(name, factor):
    """Return the Stribeck curve for another constant."""
    return lambda v, dry: stribeck_magnitude(v, dry._replace(**{name: factor * getattr(dry, name)}))


@pytest.mark.parametrize(
    ("said", "wrong"),
    [
        ("steepest", lambda dry: 0.857 / 0.858 * STRIBECK.steepest(dry)),
        ("inflection", lambda dry: 0.99 * STRIBECK.inflection(dry)),
        ("magnitude", scaled("stribeck_velocity", 0.5)),
        ("magnitude", scaled("static_friction", 1.01)),
        ("magnitude", lambda v, dry: stribeck_magnitude(v, dry) + 0.1 * v),
    ],
)
def test_what_the_friction_says_of_its_curve_is_checked(monkeypatch, said, wrong):
    none, flat = FRICTION._replace(coulomb_friction=0.0), ARM.dry_friction2
    flat = flat._replace(static_friction=flat.coulomb_friction)
    for arm in (ARM, ARM._replace(dry_friction1=none, dry_friction2=flat)):
        check_curve(arm, 2)
    for module in (friction_module, defects):
        monkeypatch.setattr(module, "STRIBECK", STRIBECK._replace(**{said: wrong}))
    with pytest.raises(NoBound, match="motor 1: friction is not a Stribeck curve that falls with"):
        check_curve(ARM, 2)
