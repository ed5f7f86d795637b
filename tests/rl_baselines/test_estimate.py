"""The training of `learned-observer`: its network, its teacher, its draws, and that it learns."""

import dataclasses

import numpy as np
import pytest
import torch

from fuzzyarm import ArmParameters, load_policy, robot_named
from fuzzyarm.cli import main
from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.records import columns
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics, tip_jacobian
from fuzzyarm.envs.scenario.cases import Scenario, case_for
from fuzzyarm.envs.scenario.default_reference import reference_family
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, MachiningForce
from fuzzyarm.envs.scenario.kinematics import freedom
from fuzzyarm.envs.scenario.paths import Circle
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.fuzzy_policy.laws.learned.estimate import signals
from fuzzyarm.fuzzy_policy.laws.learned.estimate.rnn import EstimateBundle, EstimateNetwork, respond
from fuzzyarm.rl_baselines.config import EstimateConfig
from fuzzyarm.rl_baselines.estimate import _courses as courses_module
from fuzzyarm.rl_baselines.estimate._courses import HEAVIEST, Courses, TravelForce, _direction, _rotation, draw_courses
from fuzzyarm.rl_baselines.estimate._driving import DrivenLanes
from fuzzyarm.rl_baselines.estimate._teacher import Teacher
from fuzzyarm.rl_baselines.estimate.training import EstimateTraining
from fuzzyarm.rl_baselines.estimate.training import _Student as Student

ARM, PERIOD, NOTHING = ArmParameters(), 1e-3, DomainRandomisation()
SMALL = ArmParameters(
    **{"length": (0.3, 0.25), "mass": (4.0, 2.5), "inertia": (0.03, 0.013), "mass_center": (0.15, 0.125)},
    **{"motor_inertia": (0.3, 0.08), "stiffness": (8000.0, 2500.0), "damping": (3.0, 0.9)},
    **{"static_friction": (1.5, 0.8), "coulomb_friction": (1.0, 0.5), "torque_limit": (80.0, 35.0)},
)
ADAPTIVE = AdaptiveObserverPolicy(ARM, PERIOD)
# Where a known force has a kink the teacher's torque goes from limit to limit, which tells nothing of the filter.
SWINGING = AdaptiveWeights(largest_swing=2.5)
FILTER = ADAPTIVE.memory.noise.stop  # numbers of the filter; those of the fallback follow
SHORT = {"chunks": 2, "lanes": 4, "steps": 50, "window": 50, "updates": 2, "hidden": 5, "modulation": 2}
WORDS = ["--chunks", "1", "--lanes", "2", "--steps", "50", "--window", "50", "--updates", "1", "--hidden", "4"]


def test_the_network_in_torch_is_the_one_that_is_shipped():
    made, generator = Student(6, 3, torch.Generator().manual_seed(0), two_joints()), np.random.default_rng(0)
    with torch.no_grad():
        for matrix in (made.V, made.G, made.D):  # whose answer is zero at first
            matrix.normal_(std=0.02, generator=torch.Generator().manual_seed(1))
    sizes = signals.unexplained_parts(2, 2).belief.stop, signals.context_parts(2, 2).motion.stop, 6
    z, c, h = (0.5 * generator.normal(size=(4, size)) for size in sizes)
    tensors = [torch.from_numpy(part).float()[None] for part in (z, c)]
    rho, after = made(*tensors, torch.from_numpy(h).float(), torch.ones(1, 4, 1))
    network, torques = made.network(), np.array([90.0, 40.0])
    for lane, memory in enumerate(h.copy()):
        gap = signals.GAP_SHARE * torques * np.sinh(z[lane, signals.unexplained_parts(2, 2).gap])
        answer = respond(z[lane], c[lane], memory, gap, torques, network.layers, 2)
        np.testing.assert_allclose(rho[0, lane].detach().numpy(), answer, atol=1e-6)
        np.testing.assert_allclose(after[0, lane].detach().numpy(), memory, atol=1e-6)


def tip_errors(courses, steps, arm=ARM):
    """The tip errors [mm] (steps, lanes) where the teacher drives lanes whose torques are late or not."""
    adaptive = AdaptiveObserverPolicy(arm, PERIOD, SWINGING)
    lanes, teacher, told = courses.lanes, Teacher(adaptive, courses), adaptive.memory.commands
    observation = lanes.reset(list(range(lanes.count)))[0]
    memory, aside, errors = np.zeros((lanes.count, adaptive.memory_size)), np.empty((lanes.count, 2)), []
    late = courses.delay[:, np.newaxis]
    for _ in range(steps):
        wanted = teacher.torque(observation, memory[:, :FILTER])
        adaptive.act(observation, memory, aside)
        memory[:, told][:, :2] = wanted
        now, before = memory[:, told][:, :2], memory[:, told][:, 2:4]
        observation, _, scalars = lanes.step((1.0 - late) * now + late * before)
        errors.append(1e3 * scalars[1])
    return np.array(errors)


@pytest.mark.slow
def test_the_teacher_leads_the_tip_along_the_course_under_a_changing_force_and_with_late_torques():
    reference = JointReference(Circle((0.4, 0.6), 0.17), parameters=ARM)
    loads = [Disturbance(tip_force=MachiningForce(130.0, 90.0)), Disturbance(payload=Payload(6.0))]
    scenarios = [Scenario(load, reference) for load in loads for _ in range(2)]
    lanes = Lanes([ARM], scenarios, 4, control_period=PERIOD, substeps=5, randomisation=NOTHING, threads=1)
    courses = Courses(lanes, np.full((4, 8), np.nan), np.zeros(4), np.array([0.0, 1.0, 0.0, 1.0]), np.zeros(4))
    assert np.max(tip_errors(courses, 150)) < 0.8  # mm


@pytest.mark.slow
def test_the_teacher_is_the_adaptive_observer_that_knows():
    """On the known arm without load and noise its beliefs are right from the first sample, and so is that law."""
    scenario = Scenario(Disturbance(), JointReference(Circle((0.4, 0.6), 0.17), parameters=ARM))
    lanes = Lanes([ARM], [scenario], 1, control_period=PERIOD, substeps=5, randomisation=NOTHING, threads=1)
    teacher = Teacher(ADAPTIVE, Courses(lanes, np.full((1, 8), np.nan), *np.zeros((3, 1))))
    observation = lanes.reset([0])[0]
    memory, torque = np.zeros((1, ADAPTIVE.memory_size)), np.empty((1, 2))
    for _ in range(5):
        wanted = teacher.torque(observation, memory[:, :FILTER])
        ADAPTIVE.act(observation, memory, torque)
        np.testing.assert_allclose(wanted, torque, atol=0.05)  # N m; the lateness that it believes in is not quite 0
        observation = lanes.step(wanted)[0]


@pytest.fixture
def few_references(monkeypatch):
    monkeypatch.setattr(courses_module, "_family", lambda arm: reference_family(arm, 8))


@pytest.mark.usefixtures("few_references")
def test_the_beliefs_of_the_teacher_are_the_plants():
    """What is drawn of a plant follows from its constants, but for viscous friction, of which there is no belief."""
    courses = draw_courses(ARM, 8, PERIOD, np.random.default_rng(1))
    courses.lanes.reset(list(range(8)))
    numbers = np.array(courses.lanes.numbers(columns(courses.lanes.layout.Lane).arm)).T
    p, settings = Teacher(ADAPTIVE, courses).beliefs()[:, 8:], ADAPTIVE.settings
    p[:, -1] = 0.0  # lateness
    believed = settings.base + (p - settings.guess) @ settings.slopes.T
    apart = np.abs(believed - numbers).max(axis=0)
    viscous = [two_joints().Arm._fields.index(f"viscous{joint}") for joint in (1, 2)]
    assert np.all(np.delete(apart, viscous) < 1e-9) and np.any(apart[viscous] > 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("arm", [ARM, SMALL], ids=["Table 1", "small"])
def test_the_motors_can_do_what_is_drawn(arm):
    courses, adaptive = draw_courses(arm, 12, PERIOD, np.random.default_rng(0)), AdaptiveObserverPolicy(arm, PERIOD)
    errors = tip_errors(dataclasses.replace(courses, delay=np.zeros(12)), 150, arm)
    carried = Teacher(adaptive, courses).beliefs()[:, 4 * 2 :][:, adaptive.belief.payload]
    assert 4.0 * signals.scale_of(arm).mass < np.max(carried) < 10.001 * signals.scale_of(arm).mass  # kg
    assert np.max(errors) < 1.5  # mm; ten times as much where a motor is at its limit


def test_units_scale_with_the_arm():
    assert signals.scale_of(ARM) == (1.0, 1.0, 1.0)
    same = np.array(signals.units_of(ARM).torque) / ARM.torque_limit
    np.testing.assert_array_equal(np.array(signals.units_of(SMALL).torque) / SMALL.torque_limit, same)
    doubled = dataclasses.replace(ARM, length=(1.0, 1.0), mass=tuple(3.0 * np.array(ARM.mass)))
    assert signals.scale_of(doubled) == pytest.approx((0.5, 3.0, 2.0))


@pytest.mark.usefixtures("few_references")
def test_motors_too_weak_for_any_course_are_named():
    weak = dataclasses.replace(ARM, torque_limit=(30.0, 10.0))
    message = "only 0 of 100 random motions and loads stay within the motors' torque limits; needed: "
    with pytest.raises(ValueError, match=message):
        draw_courses(weak, 1, PERIOD, np.random.default_rng(0))


@pytest.mark.slow
def test_the_same_seed_gives_the_same_network():
    trained, again = (EstimateTraining(EstimateConfig(**SHORT)).run() for _ in range(2))
    for field in dataclasses.fields(EstimateNetwork):
        assert getattr(trained.network, field.name).tobytes() == getattr(again.network, field.name).tobytes()
    untrained = Student(5, 2, torch.Generator().manual_seed(0), two_joints()).network()
    assert trained.network.A.tobytes() != untrained.A.tobytes()
    assert [row["chunk"] for row in trained.curve] == [0, 1]


@pytest.mark.slow
def test_a_lane_whose_filter_has_diverged_teaches_nothing():
    training, generator = EstimateTraining(EstimateConfig(**SHORT)), np.random.default_rng(5)
    policy = training._policy
    drive = DrivenLanes(draw_courses(ARM, 8, PERIOD, generator), policy, generator)
    drive.chunk(policy, 50)
    drive._memory[:, policy.filter] = np.nan
    drive._memory[:, policy.filter.start + FLAG.lost] = 1.0
    chunk = drive.chunk(policy, 50)
    diverged = chunk.begins[:, :, 0].numpy().all(axis=0)  # the other lanes began again
    assert 0 < diverged.sum() < 8
    assert all(torch.isfinite(part).all() for part in chunk)
    assert not chunk.free[:, diverged].any() and chunk.free[:, ~diverged].any()
    assert np.isfinite(training._update([chunk], 0))


@pytest.mark.slow
def test_training_lowers_the_loss():
    config = EstimateConfig(**{**SHORT, "chunks": 12, "lanes": 32, "updates": 10, "redraw": 100})
    losses = [row["loss"] for row in EstimateTraining(config).run().curve]
    assert np.mean(losses[-3:]) < 0.9 * np.mean(losses[:2])


@pytest.mark.parametrize("span", [np.eye(3)[:2], np.eye(3)[[2, 0]], np.eye(3)], ids=["xy", "zx", "space"])
def test_forces_point_where_the_tip_can_move(span):
    generator = np.random.default_rng(0)
    inside = span.T @ span
    for _ in range(50):
        direction, turn = _direction(span, generator), np.array(_rotation(span, 3, generator))
        assert np.linalg.norm(direction) == pytest.approx(1.0) and inside @ direction == pytest.approx(direction)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(inside @ turn @ direction, turn @ direction, atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1.0)
    across = TravelForce(3.0, 0.0, 1.0, 0.0, tuple(map(tuple, turn.tolist())), 0.01).at(np.zeros(1), direction[None])
    np.testing.assert_allclose(across[0], -3.0 * turn @ direction, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [("planar-3r", 96), ("ur5", 24)])
def test_what_is_drawn_is_the_robots(name, count):
    robot = robot_named(name)
    courses, scale = draw_courses(robot, count, PERIOD, np.random.default_rng(0)), signals.scale_of(robot)
    assert np.max(courses.payload) <= HEAVIEST * scale.mass
    assert np.max(courses.payload) > 0.3 * case_for("payload", robot).disturbance.payload.mass
    courses.lanes.reset(list(range(count)))
    limit, off = robot.drive("torque_limit"), np.eye(3) - freedom(robot).motion.T @ freedom(robot).motion
    forces = []
    for lane in range(count):
        reference, schedule = courses.lanes.schedule(lane)
        time = np.linspace(0.0, reference.duration, 60)
        q, dq, ddq = reference.sample(time)[:3]
        carrying = robot.with_payload(float(courses.payload[lane]))
        torque = inverse_dynamics(carrying, q, dq, ddq) + ddq * robot.drive("motor_inertia")
        force = schedule.disturbance.tip_force
        if force is not None:
            jacobian = tip_jacobian(robot, q)
            pushed = force.at(time, np.einsum("tai,ti->ta", jacobian, dq))
            torque -= np.einsum("tai,ta->ti", jacobian, pushed)
            np.testing.assert_allclose(pushed @ off, 0.0, atol=1e-9)
            forces.append(force)
        assert np.all(np.abs(torque) < 0.92 * limit)
    assert {type(force) for force in forces} == {ConstantForce, TravelForce}


@pytest.mark.slow
def test_the_beliefs_of_the_teacher_are_the_robots_plants():
    """What a lane drew, and no more: the factors of the draw, the payload, the lateness."""
    robot = robot_named("planar-3r")
    courses, adaptive = draw_courses(robot, 6, PERIOD, np.random.default_rng(1)), AdaptiveObserverPolicy(robot, PERIOD)
    courses.lanes.reset(list(range(6)))
    p, belief = Teacher(adaptive, courses).beliefs()[:, 12:], adaptive.belief
    drawn = courses.lanes.randomisation_info()
    assert courses.lanes.randomisation.varies and np.ptp(drawn["stiffness"]) > 0.1
    for name in ("stiffness", "damping", "friction", "mass", "motor_inertia"):
        factor = drawn["dry_friction" if name == "friction" else name]
        np.testing.assert_allclose(p[:, getattr(belief, name)], factor, atol=1e-9)
    np.testing.assert_allclose(p[:, belief.payload][:, 0], courses.payload, atol=1e-9)
    np.testing.assert_array_equal(p[:, belief.lateness][:, 0], courses.delay)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar-3r", "ur5"])
def test_a_training_ships_a_policy_of_the_robot(name, tmp_path):
    robot = robot_named(name)
    assert main(["train", "estimate", "--robot", name, *WORDS, "--out", str(tmp_path / "run")]) == 0
    bundle = EstimateBundle.load(tmp_path / "run" / "policy")
    assert bundle.arm == ArmDefinition(name, robot.digest)
    policy, state = load_policy(tmp_path / "run" / "policy", robot=name), None
    for _ in range(3):
        torque, state = policy.predict(np.zeros((5, 5 * len(robot))), state)
    assert torque.shape == (5, len(robot)) and np.isfinite(torque).all()


def test_settings_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="steps = 100 and window = 150"):
        EstimateConfig(steps=100, window=150)
    with pytest.raises(ValueError, match="chunks"):
        EstimateConfig(chunks=0)
