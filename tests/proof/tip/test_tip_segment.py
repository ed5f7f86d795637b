"""What happens within a segment: the torques of the uncertain constants, and the deviation between its ends."""

import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm

from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.policies.tip_bound import TipClaim, problem_of
from fuzzyarm.proof.tip._defects import PeriodMotion, TipForces
from fuzzyarm.proof.tip._remainders import ConstantForces
from fuzzyarm.proof.tip.centre import DEGREE, Mode
from fuzzyarm.proof.tip.friction_bounds import Friction, Plan, Speed
from fuzzyarm.proof.tip.period import Period
from fuzzyarm.proof.tip.plant import BallPlant, PlantSet
from fuzzyarm.proof.tip.transition import Linear
from fuzzyarm.proof.tip.tube import Tube
from fuzzyarm.proof.tip.zonotope import Zonotope

PERIOD = 1e-3


pytestmark = pytest.mark.usefixtures("precision")


def any_frictions(motion, mode, torques, plant):
    anything = Speed(-np.inf, np.inf)
    return [Friction(j, Plan.ANY, mode, motion, float(torques[j]), plant, anything) for j in range(2)]


@pytest.mark.parametrize("name", ["stiffness", "damping", "motor_inertia", "viscous_friction"])
def test_what_is_not_linear_in_time_is_within_the_rest_and_the_rest_is_needed(name):
    rng = np.random.default_rng(5)
    angles = rng.normal(size=(4, DEGREE + 1)) * 0.1 ** np.arange(DEGREE + 1)
    motion = PeriodMotion(angles, PERIOD, two_joints())
    plant = BallPlant.of(ArmParameters(), Disturbance(), PlantSet(**{name: (0.9, 1.1)}))
    frictions = any_frictions(motion, Mode.FORWARD, (0.0, 0.0), plant)
    found, half = ConstantForces.of(motion, (), plant).with_friction(plant, frictions), plant.half(name)
    channels = getattr(plant.layout.channels, "joint" if name in ("stiffness", "damping") else "motor")
    gaps, angle = [], [np.polynomial.Polynomial(row) for row in angles]
    for s in np.linspace(-1.0, 1.0, 41):
        for joint in range(2):
            bending = angle[joint] - angle[2 + joint]
            torque = {
                "stiffness": bending(s),
                "damping": bending.deriv()(s) * 2.0 / PERIOD,
                "motor_inertia": -angle[joint].deriv(2)(s) * (2.0 / PERIOD) ** 2,
                "viscous_friction": -angle[joint].deriv()(s) * 2.0 / PERIOD,
            }[name] * half[joint]
            channel = channels.start + joint
            linear = found.level[channel].sum() + s * found.slope[channel].sum()
            gaps.append(abs(torque - linear) / found.rest[channel])
            assert abs(torque) <= found.motor[joint] * (1 + 1e-12)
    assert 0.3 < max(gaps) <= 1.0 + 1e-9


def test_between_its_ends_a_segment_is_bounded_and_the_curvature_is_needed():
    """|S e^{At} ξ| for random ξ at 40 instants, against the bound of `Period`; the ends alone are often exceeded."""
    problem = problem_of(TipClaim("fuzzy-4-tip", "nominal", "table-1", PlantSet(), steps=1))
    step = next(iter(Tube(problem)))
    rng, beyond, free = np.random.default_rng(6), 0, [False] * 2
    period = Period(step.segments[-1], step.torque, TipForces((), (), np.eye(2), np.zeros(2)), problem.plant)
    frictions = any_frictions(period.motion, Mode.REST, step.torque, problem.plant)
    links = period._links.at, period._lever, np.zeros(2)
    system = Linear.of(problem.plant.middle, *links, free, free, np.zeros((0, 6)))
    driven, solution = period._constants.with_friction(problem.plant, frictions), system.over(period.motion.duration)
    instants = [expm(system.A * t) for t in np.linspace(0.0, period.motion.duration, 40)]
    for _ in range(30):
        start = Zonotope(10, 0)
        start.add(rng.normal(size=(10, 1)) * np.repeat([1e-3, 1e-3, 1.0, 1.0, 10.0], 2)[:, np.newaxis], 0)
        _, bound = period._free(start, system, solution, driven)
        seen = np.array([np.abs(system.S @ at @ start.columns)[:, 0] for at in instants])
        assert (seen <= bound * (1 + 1e-12)).all()
        beyond += int((seen.max(axis=0) > np.maximum(seen[0], seen[-1]) * (1 + 1e-6)).sum())
    assert beyond > 10


def test_deviations_count_from_another_centre_within_the_box():
    """x - a = (x - b) + (b - a): what the centre moves is added, or a state at the old centre would be left out."""
    z, rng, tube = Zonotope(8, 0), np.random.default_rng(7), Tube(problem_of(TipClaim("fuzzy-4-tip", steps=1)))
    before, after = rng.normal(size=8), rng.normal(size=8)
    tube._shift(z, [arb(x) for x in before], after)
    moved = np.abs(before - after)
    assert (moved <= z.totals()).all() and (z.totals() <= moved * (1 + 1e-9)).all()
