"""Affine numbers: what floats compute at any point of the zonotope is held, operation by operation."""

import contextlib
from fractions import Fraction

import numpy as np
import pytest

from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.elementwise import gaussian, sign, sinc, sine_cosine
from fuzzyarm.envs.physics.friction import stick_slip, stribeck_magnitude
from fuzzyarm.envs.physics.integrator import loaded_step
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, State
from fuzzyarm.fuzzy_policy.laws._gain_schedule import corners_of, on_table
from fuzzyarm.fuzzy_policy.laws.learned.network import add_product, area_sine, hyperbolic_tangent
from fuzzyarm.numbers.functions import RECORDERS, floor, maximum, minimum, row, select
from fuzzyarm.proof.tip._affine import Affine, Space
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.zonotope import Zonotope

ARM = arm_constants(ArmParameters())
LINEAR = {
    "sum": lambda x, y: x + y,
    "difference": lambda x, y: 0.1 - x * 3.3 + 0.7 * (y - x),
    "quotient by a number": lambda x, y: (x - y) / 3.1,
}
BENT = {
    "product": lambda x, y: x * y,
    "square": lambda x, y: x * x,
    "quotient": lambda x, y: x / (y + 5.0),
    "inverse": lambda x, y: 1.7 / (x - 5.0),
    "sine": lambda x, y: sine_cosine(x)[0],
    "cosine": lambda x, y: sine_cosine(x)[1],
    "sinc": lambda x, y: sinc(x),
    "gaussian": lambda x, y: gaussian(x),
    "tanh": lambda x, y: hyperbolic_tangent(x),
    "asinh": lambda x, y: area_sine(x),
    "maximum": lambda x, y: maximum(x, 0.2),
    "minimum": lambda x, y: minimum(x, y),
    "clip": lambda x, y: minimum(maximum(x, -0.1), 0.3),
}
MIDDLES = [(0.3, -0.2), (0.0, 0.0), (-1.4, 1.1), (0.3, 0.3), (6.0, -3.0)]


pytestmark = pytest.mark.usefixtures("precision")


def space_of(*radii):
    """Return a space over numbers that deviate independently of each other."""
    base = Zonotope(len(radii), 0)
    base.add(np.diag(radii), 0)
    return Space(base)


@contextlib.contextmanager
def recording(space):
    RECORDERS.append(space)
    try:
        yield
    finally:
        RECORDERS.pop()


def held(function, middle, radii, count=60):
    """Run a function of numbers on affine ones and on floats; return how far off floats are, of what is allowed.

    The floats are at corners, at the middle, and anywhere. What is returned are (count, results) shares, 0 where both
    are zero, and the bounds (results,) of what is left beside the lines.
    """
    space, rng, rows = space_of(*radii), np.random.default_rng(0), []
    with recording(space):
        found = [space.number(x) for x in function(*space.variables(np.array(middle)))]
    lines = [[Fraction(x) for x in (number.middle, number.rest, *number.row.tolist())] for number in found]
    allowed = [rest + sum(map(abs, gains[len(middle) :]), Fraction(0)) for _, rest, *gains in lines]
    for _ in range(count):
        away = radii * np.array([rng.choice([-1.0, 1.0, 0.0, rng.uniform(-1.0, 1.0)]) for _ in middle])
        point = np.clip(np.array(middle) + 0.999999 * away, *(np.array(middle) + s * np.array(radii) for s in (-1, 1)))
        moved = [Fraction(x) - Fraction(m) for x, m in zip(point.tolist(), middle, strict=True)]
        with np.errstate(invalid="ignore"):
            values = function(*point.tolist())
        shares = []
        for value, (c, _, *gains), most in zip(values, lines, allowed, strict=True):
            missed = abs(Fraction(float(value)) - c - sum(r * x for r, x in zip(gains, moved, strict=False)))
            assert missed <= most
            shares.append(float(missed / most) if most else 0.0)
        rows.append(shares)
    return np.array(rows), np.array([float(x) for x in allowed])


@pytest.mark.parametrize("name", [*LINEAR, *BENT])
@pytest.mark.parametrize("radius", [0.0, 1e-9, 1e-3, 0.4, 1.5])
@pytest.mark.parametrize("middle", MIDDLES)
def test_what_floats_compute_at_any_point_is_held(name, radius, middle):
    function = (LINEAR | BENT)[name]
    if name == "inverse" and middle[0] + radius > 5.0 > middle[0] - radius:
        with pytest.raises(NoBound, match="zero"):
            held(lambda x, y: [function(x, y)], middle, (radius, radius))
        return
    shares, allowed = held(lambda x, y: [function(x, y)], middle, (radius, radius))
    order = 0.0 if name in LINEAR else 0.51 * radius if name in ("maximum", "minimum", "clip") else 2.0 * radius**2
    assert allowed[0] < 1e-12 + 1e-5 * radius + order or (radius >= 0.4 and name in ("inverse", "quotient"))
    if name in BENT and radius == 0.4 and allowed[0] > 1e-6:
        assert shares.max() > 0.05  # what a function leaves beside its line is needed


@pytest.mark.parametrize("radius", [1e-6, 0.05])
def test_a_product_with_a_matrix(radius):
    rng = np.random.default_rng(2)
    table, middle = rng.normal(size=(6, 3)), rng.normal(size=6).tolist()

    def function(*x):
        sums, given = np.array([0.1, -0.2, 0.3], dtype=object), np.array(x, dtype=object)
        add_product(given, table, sums)
        return [*sums, *(hyperbolic_tangent(one) for one in sums)]

    shares, allowed = held(function, middle, [radius] * 6)
    assert (shares.max(axis=0) > 1e-3).all() and (allowed < 1e-12 + 10.0 * radius**2).all()
    assert (allowed[:3] < 1e-12).all()


@pytest.mark.parametrize(("angle", "radius"), [(1.2, 0.0), (1.2, 0.01), (0.4, 0.1), (1.3, 0.3)])
def test_gains_between_the_points_of_a_table(angle, radius):
    """What the interpolated gains leave beside a line is of the size of their differences."""
    table = np.random.default_rng(1).normal(size=(9, 1)) * 0.1 + np.array([5.0, -3.0, 2.0, 1.0])

    def function(q, x, y):
        return on_table(table, corners_of([0.0, q], (1,), True, 9), -1.0, [x, y], [1.0 + x, 2.0 * y])

    _, allowed = held(function, (angle, 0.2, -0.3), (radius, 0.01, 0.02))
    assert (allowed < 1e-12 + 0.25 * radius).all()


def test_a_whole_number_that_is_not_decided_has_several_values():
    x, y = space_of(0.4, 0.4).variables(np.array([2.9, 0.1]))
    assert floor(x - 0.4) == 2.0 and (floor(x) == 3.0).values == (False, True)
    places = minimum(2.0, maximum(0.0, floor(x) + 0.0))
    assert places.values == (2.0, 2.0) and (5.0 - 2.0 * floor(x)).values == (1.0, -1.0)
    assert [one.middle for one in (x - floor(x)).values] == pytest.approx([0.9, -0.1])
    with pytest.raises(NoBound, match="two table look-ups"):
        floor(x) + floor(y)
    for jump in (lambda: x * floor(x) + y, lambda: row([[1.0], [2.0]], floor(x)), lambda: 1.0 if floor(x) else 2.0):
        with pytest.raises((NoBound, TypeError)):
            float(np.sum([jump()]))


def test_choices_that_are_decided_are_made_and_others_have_no_bound():
    (x,) = space_of(0.5).variables(np.array([0.05]))
    for undecided in (
        lambda: select(x > 0.0, 1.0, 2.0),
        lambda: sign(x),
        lambda: 1.0 if x == 0.0 else 2.0,
        lambda: 1.0 if x else 2.0,
        lambda: select((x > 0.0) & (x > -1.0), x, 0.0),
    ):
        with pytest.raises(NoBound, match=r"either may be larger|does not determine"):
            undecided()
    for infinite in (lambda: x * 1e200 * 1e200 > 0.0, lambda: (x * 1e200 * 1e200) * 0.0):
        with np.errstate(all="ignore"), pytest.raises(NoBound, match="no finite bound"):
            infinite()
    assert select(x > -0.6, 1.0, 2.0) == 1.0 and select(x >= 0.6, 1.0, 2.0) == 2.0
    assert select((x > 0.0) & (x > 0.6), 1.0, 2.0) == 2.0 and select((x > 0.0) | (x < 0.6), 1.0, 2.0) == 1.0
    assert (x == 3.0) is False and (x != 3.0) is True
    assert maximum(x, -0.6) is x and minimum(x, -0.6) == -0.6


@pytest.mark.parametrize(
    ("v", "alpha", "spread", "slope"),
    [
        (0.5, 3.0, (0.05, 2.0, 0.06), 1.0),  # slips
        (-0.5, 3.0, (0.05, 2.0, 0.06), 1.0),
        (0.0, 8.0, (0.0, 1.0, 0.02), 1.0),
        (2e-5, 0.3, (1e-5, 0.2, 1e-5), 0.0),  # comes to rest
        (1e-4, 0.5, (2e-4, 0.5, 2e-4), 0.5),  # either
        (1e-4, -2.0, (3e-4, 1.0, 1e-2), 0.5),
        (0.02, 1.0, (0.1, 5.0, 0.1), 1.0),  # any friction
    ],
)
def test_every_motor_of_the_box_is_held_after_a_kick(v, alpha, spread, slope):
    """v' and e for (v, α) and the velocity that friction depends on; each bound is nearly reached by one motor."""

    def function(v, a, m):
        f = stribeck_magnitude(m, ARM.dry_friction1) * (1.0 / ARM.motor_inertia1)
        return stick_slip(v, a, f, 2e-4)

    shares, allowed = held(function, (v, alpha, v), spread, 400)
    assert shares[:, 1].max() > 0.05 and (shares[:, 0].max() > 0.2 or slope == 0.0)
    space = space_of(*spread)
    with recording(space):
        after = space.number(function(*space.variables(np.array([v, alpha, v])))[0])
    assert after.row[0] == pytest.approx(slope, abs=1e-12) and (slope or not allowed[0])


@pytest.mark.parametrize("speed", [0.0, 1e-4, 0.3])
def test_predicted_steps_are_held(speed):
    """Five sub-steps of `loaded_step`, of a motor that rests, nearly rests or slips, with all else near a point."""

    def function(*x):
        state = State(*(PerJoint(*x[k : k + 2]) for k in (0, 2, 4, 6)))
        for _ in range(5):
            state = loaded_step(state, PerJoint(50.0, -10.0), PerJoint(*x[8:]), ARM, 2e-4)
        return [number for pair in state for number in pair]

    middle = (0.7, 0.8, 0.699, 0.801, speed, -speed, speed, 0.0, 1.0, -2.0)
    shares, allowed = held(function, middle, [1e-6] * 4 + [1e-5] * 4 + [0.1] * 2, 30)
    assert shares.max() > 1e-3 and (allowed < np.repeat([1e-8, 1e-8, 1e-4, 1e-5], 2)).all()


def test_condensed_columns_hold_all_and_not_much_more():
    rng, base = np.random.default_rng(3), Zonotope(5, 0)
    base.add(rng.normal(size=(5, 5)) @ rng.normal(size=(5, 4000)) * rng.exponential(size=4000) ** 3, 0)
    columns, box = base.condensed()
    assert columns.shape[1] < 2100
    for along in rng.normal(size=(40, 5)):
        exact, found = np.abs(along @ base.columns).sum(), np.abs(along @ columns).sum() + np.abs(along) @ box
        assert exact <= found <= 1.2 * exact
    assert isinstance(Space(base).number(1.0), Affine)


def test_a_motion_of_unknown_duration_or_of_negative_friction_has_no_bound():
    space = space_of(0.1, 0.1)
    x, y = space.variables(np.array([1.0, 2.0]))
    for friction, duration in ((1.0, y), (y - 3.0, 0.1)):
        with recording(space), pytest.raises(NoBound, match="motion"):
            stick_slip(x, x, friction, duration)
