"""Domain randomisation: every draw in its range, uniform and on its own, and applied to what it names alone."""

import dataclasses

import numpy as np
import pytest
from scipy import stats
from support.randomisation import EVERYTHING, NOISY, SHORT
from support.results import identical
from support.two_joints import named

from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.observation import ACTION_SCALE, OBSERVATION_SCALE, observed
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.envs.scenario.default_reference import reference_family
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line
from fuzzyarm.envs.scenario.randomisation import ALLOWED, DomainRandomisation, find_randomisation
from fuzzyarm.envs.scenario.reference import JointReference

TABLE_1 = ArmParameters()
LONG = dataclasses.replace(TABLE_1, length=(0.6, 0.5))
REFERENCE = JointReference()
PER_JOINT = [name for name in ALLOWED if name not in ("payload", "force")]
# The factors of a draw, and the fields of `ArmParameters` that each scales.
SCALES = {
    "mass": ("mass", "inertia"),
    "motor_inertia": ("motor_inertia",),
    "stiffness": ("stiffness",),
    "damping": ("damping",),
    "dry_friction": ("static_friction", "coulomb_friction"),
    "viscous_friction": ("viscous_friction",),
}


def lanes_with(randomisation, count, disturbance=NOISY):
    """Lanes at the start of an episode, and the vectors of its first instant by name."""
    lanes = Lanes([TABLE_1], [(disturbance, None)], count, control_period=1e-3, substeps=5, randomisation=randomisation)
    return lanes, named(lanes.reset(range(count))[1])


def episode(env, torques, **reset):
    observation, info = env.reset(**reset)
    return [(observation, 0.0, False, False, info), *(env.step(torque) for torque in torques)]


TORQUES = np.array([110.0, 30.0]) + np.random.default_rng(0).normal(scale=10.0, size=(30, 2))


@pytest.mark.parametrize("name", ALLOWED)
def test_the_ends_of_what_is_allowed_are_allowed(name):
    low, high, _ = ALLOWED[name]
    for given in ([low, high], (low, low), (np.float64(low), high)):
        assert DomainRandomisation(**{name: given}).varies == (given[0] < given[1])
    for given in ((np.nextafter(low, -9.0), high), (low, np.nextafter(high, 9e9))):
        with pytest.raises(ValueError, match=rf"DomainRandomisation\.{name}\[[01]\] = "):
            DomainRandomisation(**{name: given})


def test_references_that_do_not_fit_are_refused_and_none_is_drawn_before_the_first_episode():
    with pytest.raises(TypeError, match=r"references: entry = Circle.* must be a .*[.]Reference"):
        DomainRandomisation(references=(REFERENCE, Circle()))
    with pytest.raises(ValueError, match=r"links of \(0\.6, 0\.5\) m, but the plant has links of \(0\.5, 0\.5\) m"):
        FuzzyArmEnv(randomisation=DomainRandomisation(references=(REFERENCE, JointReference(parameters=LONG))))
    with pytest.raises(ValueError, match="either a reference or a randomisation that draws references, not both"):
        FuzzyArmEnv(reference=REFERENCE, randomisation=EVERYTHING)
    env = FuzzyArmEnv(randomisation=EVERYTHING)
    for wrong in (Circle(), JointReference(parameters=LONG)):
        with pytest.raises(Exception, match=r"call env\.reset\(\)"):
            _ = env.reference
        with pytest.raises((TypeError, ValueError), match="reference"):
            env.reset(options={"reference": wrong})


def test_the_named_variations():
    nominal, plants, robust = (find_randomisation(name, TABLE_1) for name in ("nominal", "plants", "robust"))
    assert nominal == DomainRandomisation() and not nominal.varies and plants.varies and robust.varies
    assert (plants.mass, plants.stiffness, plants.dry_friction) == ((0.9, 1.1), (0.8, 1.2), (0.5, 1.5))
    assert (plants.payload, plants.force, plants.angle, plants.references) == ((0, 0), (1, 1), (0, 0), ())
    assert (robust.payload, robust.force, robust.angle) == ((0.0, 5.0), (0.0, 1.0), (-0.01, 0.01))
    assert robust.references == reference_family(TABLE_1)
    assert dataclasses.replace(robust, payload=(0, 0), force=(1, 1), angle=(0, 0), references=()) == plants
    assert find_randomisation(EVERYTHING, TABLE_1) is EVERYTHING


@pytest.mark.parametrize("nothing", ["nominal", DomainRandomisation(mass=[1, 1], payload=(0, 0))])
def test_a_variation_of_nothing_changes_no_bit_and_shows_nothing(nothing):
    plain, unvaried = FuzzyArmEnv(disturbance=NOISY), FuzzyArmEnv(disturbance=NOISY, randomisation=nothing)
    for seed in (1, None):
        first, second = (episode(env, TORQUES, seed=seed) for env in (plain, unvaried))
        assert identical(first, second) and not any("randomisation" in step[-1] for step in second)


def test_draws_are_uniform_in_their_range_and_quantities_joints_lanes_and_episodes_independent():
    many = lanes_with(EVERYTHING, 4000)[0].randomisation_info()
    for name in ALLOWED:
        low, high = getattr(EVERYTHING, name)
        assert many[name].shape == ((4000, 2) if name in PER_JOINT else (4000,))
        for sample in many[name].reshape(4000, -1).T:
            assert low <= sample.min() and sample.max() <= high
            assert stats.kstest((sample - low) / (high - low), "uniform").pvalue > 1e-4, name
    numbers, counts = np.unique(many["reference"], return_counts=True)
    assert numbers.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert stats.chisquare(counts).pvalue > 1e-4
    lanes, _ = lanes_with(EVERYTHING, 1)
    episodes = np.concatenate([lanes.restart(np.array([0])) is not None and lanes.drawn.T for _ in range(1000)])
    for drawn in (np.hstack([many[name].reshape(4000, -1) for name in (*ALLOWED, "reference")]), episodes):
        assert drawn.shape[1] == 17
        standard, limit = (drawn - drawn.mean(axis=0)) / drawn.std(axis=0), 5.0 / np.sqrt(len(drawn))
        between = standard.T @ standard / len(drawn) - np.eye(17)
        lagged = standard[1:].T @ standard[:-1] / (len(drawn) - 1)
        assert np.abs(between).max() < limit and np.abs(lagged).max() < limit


def test_the_same_seed_draws_the_same_and_info_shows_it_to_the_end_of_the_episode():
    env, again = (FuzzyArmEnv(randomisation=EVERYTHING) for _ in range(2))
    first = [env.reset(seed=seed)[1]["randomisation"] for seed in (5, None, None, 5, 6)]
    assert all(identical(again.reset(seed=seed)[1]["randomisation"], first[k]) for k, seed in enumerate((5, None)))
    assert identical(first[3], first[0]) and list(first[0]) == [*ALLOWED, "reference"]
    for name in ALLOWED:
        values = np.array([np.ravel(first[k][name]) for k in (0, 1, 2, 4)])
        assert all(len(set(column)) == 4 for column in values.T.tolist())
    for torque in TORQUES[:5]:
        later = env.step(torque)[-1]["randomisation"]
        assert identical(later, first[-1])
        if later["mass"].flags.writeable:
            later["mass"][:] = np.nan  # reaches nobody else


@pytest.mark.parametrize("own", [Payload(), Payload(2.0), Payload(2.0, at="link")], ids=["none", "tip", "link"])
def test_the_arm_of_each_lane_is_the_one_with_the_fields_it_drew(own):
    """Masses, motors, joints and friction scaled; the case's payload as it is and the drawn one at the tip."""
    lanes, _ = lanes_with(EVERYTHING, 40, Disturbance(payload=own))
    drawn = lanes.randomisation_info()
    for lane in range(40):
        factors = {field: drawn[name][lane] for name, fields in SCALES.items() for field in fields}
        fields = {name: tuple((getattr(TABLE_1, name) * factor).tolist()) for name, factor in factors.items()}
        arm = dataclasses.replace(TABLE_1, **fields)
        at_tip = own.mass * (own.at == "tip") + drawn["payload"][lane]
        expected = np.array(flat(arm_constants(arm, Payload(at_tip))))
        if own.at == "link":
            expected += np.array(flat(arm_constants(arm, own))) - np.array(flat(arm_constants(arm)))
        np.testing.assert_allclose(lanes.numbers(slice(8, 29))[:, lane], expected, rtol=1e-14)


def test_the_drawn_force_scales_that_of_the_case():
    env = FuzzyArmEnv("machining", randomisation=DomainRandomisation(force=(0.2, 0.8)))
    drawn, nominal = (episode(e, TORQUES, seed=2) for e in (env, FuzzyArmEnv("machining")))
    factor = drawn[0][-1]["randomisation"]["force"]
    assert 0.2 <= factor <= 0.8 and nominal[-1][-1]["external_force"].any()
    for first, second in zip(drawn, nominal, strict=True):
        assert np.array_equal(first[-1]["external_force"], factor * second[-1]["external_force"])
    for factor, case in ((0.0, "nominal"), (1.0, "machining")):  # no force, and that of the case, to the bit
        env = FuzzyArmEnv("machining", randomisation=DomainRandomisation(force=(factor, factor)))
        for first, second in zip(episode(env, TORQUES), episode(FuzzyArmEnv(case), TORQUES), strict=True):
            assert np.array_equal(first[0], second[0])


def test_an_episode_starts_at_rest_beside_the_reference_with_the_motors_holding_the_arm_of_table_1():
    lanes, start = lanes_with(dataclasses.replace(EVERYTHING, angle=(-0.3, 0.3)), 40)
    drawn = lanes.randomisation_info()
    on_reference = np.array([lanes.schedule(lane)[0].sample(0.0).q for lane in range(40)])
    assert np.array_equal(start["q_link"], on_reference + drawn["angle"])
    gravity = rigid_inverse_dynamics(start["q_link"], *np.zeros((2, 40, 2)), arm_constants(TABLE_1))
    np.testing.assert_allclose(start["q_motor"], start["q_link"] + gravity / TABLE_1.stiffness, rtol=0.0, atol=1e-15)
    assert not start["dq_link"].any() and not start["dq_motor"].any()


def test_the_drawn_reference_is_followed_unless_another_is_given_for_an_episode():
    env, seen = FuzzyArmEnv(randomisation=EVERYTHING), set()
    for seed in range(20):
        options = {3: {"reference": REFERENCE}, 4: {"case": "payload"}}.get(seed)
        start, *steps = episode(env, TORQUES[:3], seed=seed, options=options)
        number = int(start[-1]["randomisation"]["reference"])
        reference = REFERENCE if seed == 3 else SHORT[number]
        assert env.reference is reference
        for observation, *_, info in (start, *steps):
            sample = reference.sample(info["time"])
            np.testing.assert_allclose(observation[4:], np.concatenate(sample), rtol=0.0, atol=1e-12)
            np.testing.assert_allclose(info["tip_reference"], reference.tip(info["time"]).position, atol=1e-15)
        seen.add(number)
    assert seen == set(range(5))


@pytest.mark.parametrize("arm", [TABLE_1, LONG, dataclasses.replace(TABLE_1, length=(0.3, 0.5))], ids="ABC")
def test_every_reference_of_the_family_can_be_tracked(arm):
    references = reference_family(arm)
    assert reference_family(arm, 5) == references[:5] and len(set(references)) == 32
    shapes = [type(reference.path) for reference in references]
    assert [shapes.count(shape) for shape in (Circle, Lemniscate, Line)] == [24, 4, 4]
    turns = [reference.path.turns for reference in references if isinstance(reference.path, Circle)]
    assert set(turns) == {-1.0, 1.0} and 4 < turns.count(1.0) < 20
    reach = sum(arm.length)
    FuzzyArmEnv(parameters=arm, randomisation=DomainRandomisation(references=references))  # fits the observation space
    for reference in references:
        times = np.linspace(0.0, reference.duration, 1001)
        motion, distance = reference.sample(times), np.hypot(*reference.tip(times).position.T)
        # The family is sifted at 200 points of the path; between them a curve strays by less than a millimetre.
        assert 0.3 * reach - 1e-3 < distance.min() and distance.max() < 0.92 * reach + 1e-3
        assert np.abs(motion.q).max() <= np.pi and np.abs(motion.dq).max() <= 15.0
        fastest = 2.2 * (1.46 if isinstance(reference.path, Lemniscate) else 1.0)
        speed = np.linalg.norm(reference.tip(times).velocity, axis=-1).max() / reach
        assert 0.4 - 1e-6 < speed < fastest + 1e-6


def test_scales_are_the_magnitudes_of_the_family_and_the_limits_of_the_motors():
    rows = np.concatenate([Schedule.build(one, Disturbance(), 5e-3).references for one in reference_family(TABLE_1)])
    scale = observed(OBSERVATION_SCALE)
    reference = [scale.q_reference, scale.dq_reference, scale.ddq_reference]
    np.testing.assert_allclose(np.ravel(reference), np.sqrt(np.mean(rows**2, axis=0)), rtol=0.03)
    np.testing.assert_array_equal(reference[:2], [scale.q_motor, scale.dq_motor])
    np.testing.assert_array_equal(ACTION_SCALE, FuzzyArmEnv().action_space.high)
