"""The elastic observer on balls: every answer of the policy near a point lies in what is said of all of them."""

import numpy as np
import pytest
from flint import arb, ctx

from fuzzyarm import load_policy
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.friction import stick_slip, stribeck_magnitude
from fuzzyarm.envs.physics.integrator import loaded_step
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, State
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.certified.tip.bound import TipClaim, find_bound
from fuzzyarm.eval.certified.tip.enclosures import BITS
from fuzzyarm.eval.certified.tip.forms import Forms
from fuzzyarm.eval.certified.tip.observer_law import ObserverLaw, _interpolated
from fuzzyarm.eval.certified.tip.plant_set import SETS
from fuzzyarm.eval.certified.tip.predictor import Predictor
from fuzzyarm.eval.certified.tip.zonotope import Zonotope

REFERENCES = Schedule.build(JointReference(), Disturbance(), 1e-3, 2).references
ARM = arm_constants(ArmParameters())
UNITS = np.repeat([1e-4, 3e-2, 1e-4, 1e-4, 3e-2, 3e-2, 3.0], 2)  # of y, x̂ and d̂


@pytest.fixture(autouse=True)
def precision():
    with ctx.workprec(BITS):
        yield


@pytest.fixture(scope="module")
def policy():
    return load_policy("elastic-observer")


@pytest.fixture(scope="module")
def law(policy):
    return ObserverLaw(policy, REFERENCES[:400])


def answers(policy, k, numbers):
    """Return what the policy answers to (y, (x̂, d̂)⁻) at the k-th sample: u and the next (x̂, d̂)⁻."""
    memory = None
    for row in REFERENCES[: k + 1]:
        before = memory
        seen = np.concatenate([[0.0] * 4, row])
        _, memory = policy.predict(seen, memory)
    if before is not None:
        before = np.concatenate([before[:-10], numbers[4:]])
    torque, after = policy.predict(np.concatenate([numbers[:4], REFERENCES[k]]), before)
    return np.concatenate([torque, after[-10:]])


def near(law, k, slowest=0.0):
    """Return (y, (x̂, d̂)⁻) where the arm is wanted; motors that turn more slowly than that rest."""
    x = law._wanted[k].copy()
    x[4:6] = np.where(np.abs(x[4:6]) < slowest, 0.0, x[4:6])
    return np.concatenate([x[:2], x[4:6], x, [0.5, -0.3]])


@pytest.mark.parametrize("k", [0, 1, 5, 300])
def test_at_a_point_it_is_the_policy(policy, law, k):
    point = near(law, k)
    if k == 0:
        point[4:] = 0.0
    found = law.respond(k, point, Zonotope(14, 0))
    missed, allowed = np.abs(found.middle - answers(policy, k, point)), np.abs(found.columns).sum(axis=1) + found.box
    assert (missed <= allowed).all()
    assert (allowed[:2] < 1e-8).all() and (allowed[2:6] < 1e-11).all() and (allowed[6:] < 1e-9).all()


@pytest.mark.parametrize(("speed", "bend"), [(0.0, 1e-3), (1e-4, 1e-3), (0.3, 1e-3), (0.3, 0.5)])
def test_the_predicted_steps_are_those_of_the_integrator_but_for_rounding(speed, bend):
    """Five sub-steps of `loaded_step` in floats: at rest, nearly at rest, slipping, and with torques that cancel."""
    torque, load = np.array([64000.0, 12000.0]) * bend, np.array([-64000.0, -12000.0]) * bend
    numbers = np.array([0.7, 0.8, 0.7 - bend, 0.8 - bend, speed, -speed, speed, 0.0, *load, *torque])
    missed, allowed = predicted(numbers, 5)
    assert (missed <= allowed).all() and (allowed < 1e-8).all()


def test_the_rounding_of_a_predicted_step_is_needed():
    """A sub-step in floats from states whose torques cancel: most of them err by more than a bit of the result."""
    rng, worst = np.random.default_rng(0), 0.0
    for _ in range(12):
        angles, speeds, torques = (10.0 ** rng.uniform(low, high, 4) for low, high in ((-4, 0), (-4, 1), (-2, 4)))
        missed, allowed = predicted(np.concatenate([angles, speeds, torques]) * rng.choice([-1.0, 1.0], 12), 1)
        assert (missed <= allowed).all()
        worst = max(worst, float((missed / allowed).max()))
    assert worst > 1e-4


def predicted(numbers, steps):
    """Return by how much sub-steps of `loaded_step` in floats miss those that are predicted, and what is allowed."""
    forms = Forms(numbers, Zonotope(12, 0))
    Predictor(ARM, 2e-4, steps).advance(forms)
    state, (load, torque) = State(*(PerJoint(*pair) for pair in numbers[:8].reshape(4, 2))), numbers[8:].reshape(2, 2)
    for _ in range(steps):
        state = loaded_step(state, PerJoint(*torque), PerJoint(*load), ARM, 2e-4)
    return np.abs(np.concatenate([np.ravel(pair) for pair in state]) - forms.middle[:8]), forms.sizes()[:8]


LONGER = pytest.mark.slow


@pytest.mark.parametrize(
    ("k", "size"),
    [(300, 1.0), (12, 0.3), (0, 0.1), pytest.param(300, 0.05, marks=LONGER), pytest.param(12, 3.0, marks=LONGER)],
)
def test_every_answer_near_the_point_is_held_and_what_is_not_linear_is_needed(policy, law, k, size):
    """At 300 motors slip, at 12 they are slow; x = c + Σ columns g, with columns that the observer adds."""
    point, rng = near(law, k), np.random.default_rng(k)
    if k == 0:
        point[4:] = 0.0
    seen = Zonotope(14, 0)
    seen.add(np.diag(size * UNITS)[:, : 4 if k == 0 else 14], 0)
    found, worst = law.respond(k, point, seen), np.zeros(12)
    given, own = np.split(found.columns, [seen.columns.shape[1]], axis=1)
    rest = np.abs(own).sum(axis=1) + found.box
    for _ in range(30):
        g = rng.choice([-1.0, 1.0], given.shape[1]) * rng.uniform(0.5, 1.0, given.shape[1])
        exact = answers(policy, k, point + seen.columns @ g)
        worst = np.maximum(worst, np.abs(exact - found.middle - given @ g) / rest)
    assert (worst <= 1.0).all() and worst.max() > 0.02
    assert k == 12 or (rest[:2] < 0.03 * np.abs(given[:2]).sum(axis=1)).all()


@pytest.mark.parametrize(
    ("v", "alpha", "spread", "kind"),
    [
        (0.5, 3.0, (2.0, 0.05, 0.06), "slips"),
        (-0.5, 3.0, (2.0, 0.05, 0.06), "slips"),
        (0.0, 8.0, (1.0, 0.0, 0.02), "slips"),
        (2e-5, 0.3, (0.2, 1e-5, 1e-5), "rests"),
        (1e-4, 0.5, (0.5, 2e-4, 2e-4), "either"),
        (1e-4, -2.0, (1.0, 3e-4, 1e-2), "either"),
        (0.02, 1.0, (5.0, 0.1, 0.1), "anything"),
    ],
)
def test_a_kick_holds_every_motor_of_the_box(v, alpha, spread, kind):
    """v' and e of `stick_slip` for sampled (α, v, v_m), and at corners; each bound is nearly reached by one of them."""
    h, rng, worst = 2e-4, np.random.default_rng(1), np.zeros(2)
    kick = Predictor(ARM, h, 5)._slid(0, arb(h), (alpha, v, v), spread)
    start, gains = [float(kick.speed.mid()), float(kick.way.mid())], np.array([kick.speed_gain, kick.way_gain])
    rests = np.array([kick.speed_rest, kick.way_rest])
    for _ in range(400):
        away = rng.choice([-1.0, 1.0, 0.0, rng.uniform(-1.0, 1.0)], 3) * spread
        f = stribeck_magnitude(v + away[2], ARM.dry_friction1) / ARM.motor_inertia1
        exact = np.array(stick_slip(v + away[1], alpha + away[0], f, h))
        left = exact - start - gains @ away[[1, 0, 2]]
        if kind in ("slips", "anything"):  # what v' leaves also moves the motor, by h/2 of it
            left[1] -= 0.5 * h * left[0]
        worst = np.maximum(worst, np.abs(left) / np.maximum(rests, 1e-15))
    assert (worst <= 1.0 + 1e-9).all()
    assert worst[0] > 0.2 or kind == "rests"
    assert {"slips": 1.0, "rests": 0.0, "either": 0.5, "anything": 1.0}[kind] == kick.speed_gain[0]


@pytest.mark.parametrize(("middle", "radius"), [(1.2, 0.0), (1.2, 0.01), (np.arccos(0.25), 0.02), (0.0, 0.3)])
def test_gains_between_the_points_of_the_table(policy, middle, radius):
    """On a box that holds a corner of the line every slope of a secant from its middle is held."""
    table = policy.observer
    value, slope = _interpolated(table, arb(middle, radius))
    at, _ = _interpolated(table, arb(middle))
    for share in (-1.0, -0.4, 0.7, 1.0) if radius else (0.0,):
        angle = middle + share * radius
        place = 0.5 * (np.cos(angle) + 1.0) * 8.0
        left = min(int(place), 7)
        exact = table[left] + (place - left) * (table[left + 1] - table[left])
        for i in range(10):
            for j in range(4):
                assert value[i][j].overlaps(arb(exact[i, j], 1e-9))
                secant = (arb(exact[i, j], 1e-9) - at[i][j]) / (share * radius) if radius else slope[i][j]
                assert slope[i][j].overlaps(secant)


def test_the_observer_has_a_tube():
    """Known plants: what is simulated, nearly; any friction: far wider."""
    exact = find_bound(TipClaim("elastic-observer", "nominal", "table-1", SETS["table-1"], steps=8))
    wide = find_bound(TipClaim("elastic-observer", "nominal", "any-friction", SETS["any-friction"], steps=8))
    assert exact.largest < 2e-7
    assert (wide.tip[1:] > exact.tip[1:]).all() and 1e-6 < wide.largest < 1e-3
