"""The training of `learned-observer`: its linear loops, its network, its teacher, and that it learns."""

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from fuzzyarm.envs.batch.lanes import Lanes  # noqa: E402
from fuzzyarm.envs.observation import START  # noqa: E402
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, mass_matrix  # noqa: E402
from fuzzyarm.envs.physics.parameters import ArmParameters  # noqa: E402
from fuzzyarm.envs.scenario.disturbances import Disturbance, MachiningForce  # noqa: E402
from fuzzyarm.envs.scenario.paths import Circle  # noqa: E402
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation  # noqa: E402
from fuzzyarm.envs.scenario.reference import JointReference  # noqa: E402
from fuzzyarm.envs.scenario.scenario import Scenario  # noqa: E402
from fuzzyarm.eval.stability.linearisation import linearise  # noqa: E402
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy  # noqa: E402
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights, feedback_gain, sampled_arm  # noqa: E402
from fuzzyarm.learned_policy.estimate.network import EstimateNetwork, respond  # noqa: E402
from fuzzyarm.learned_policy.estimate.policy import QUICK, SEEN, SEEN_PARTS, LearnedObserverPolicy  # noqa: E402
from fuzzyarm.learned_policy.estimate.signals import CONTEXT, QUICK_SHARE, UNEXPLAINED, UNEXPLAINED_PARTS  # noqa: E402
from fuzzyarm.rl_baselines.estimate.config import EstimateConfig  # noqa: E402
from fuzzyarm.rl_baselines.estimate.courses import Courses, draw_courses  # noqa: E402
from fuzzyarm.rl_baselines.estimate.stability import CONDITIONS, Loops, eigenvalue_loss  # noqa: E402
from fuzzyarm.rl_baselines.estimate.student import Student  # noqa: E402
from fuzzyarm.rl_baselines.estimate.teacher import Teacher  # noqa: E402
from fuzzyarm.rl_baselines.estimate.training import EstimateTraining  # noqa: E402

ARM, PERIOD, NOTHING = ArmParameters(), 1e-3, DomainRandomisation()
SHORT = {
    "chunks": 2,
    "lanes": 4,
    "steps": 50,
    "window": 50,
    "updates": 2,
    "hidden": 5,
    "modulation": 2,
    "points": 3,
    "stability": 1.0,
}


def student(seed=0, output=0.02):
    """A student whose output is not zero."""
    made = Student(6, 3, torch.Generator().manual_seed(seed))
    with torch.no_grad():
        for matrix in (made.V, made.D):
            matrix.normal_(std=output, generator=torch.Generator().manual_seed(seed + 1))
    return made


def points(hidden, count=4, seed=0):
    generator = np.random.default_rng(seed)
    return (0.5 * generator.normal(size=(count, size)) for size in (UNEXPLAINED, CONTEXT, hidden))


def test_the_network_in_torch_is_the_one_that_is_shipped():
    made, (z, c, h) = student(), points(6)
    tensors = [torch.from_numpy(part).float()[None] for part in (z, c)]
    rho, after = made(*tensors, torch.from_numpy(h).float(), torch.ones(1, 4, 1))
    for lane in range(4):
        memory, answer = h[lane].copy(), np.empty(2)
        respond(z[lane], c[lane], memory, answer, *made.network().arguments)
        np.testing.assert_allclose(rho[0, lane].detach().numpy(), answer, atol=1e-6)
        np.testing.assert_allclose(after[0, lane].detach().numpy(), memory, atol=1e-6)


def test_the_slopes_of_the_network_are_its_differences():
    made, (z, c, h) = student(), points(6)
    z[:, UNEXPLAINED_PARTS.load] *= 0.01  # where the network is half silent
    slopes = made.slopes(*map(torch.from_numpy, (z, c, h)))
    arguments, step = made.network().arguments, 1e-6

    def answer(z, h):
        memory, rho = h.copy(), np.empty(2)
        respond(z, c[0], memory, rho, *arguments)
        return np.concatenate([memory, rho])

    by_z = [(answer(z[0] + d, h[0]) - answer(z[0] - d, h[0])) / (2 * step) for d in step * np.eye(UNEXPLAINED)]
    by_h = [(answer(z[0], h[0] + d) - answer(z[0], h[0] - d)) / (2 * step) for d in step * np.eye(6)]
    np.testing.assert_allclose(np.transpose(by_z), torch.cat([slopes.h_z, slopes.rho_z], 1)[0].detach(), atol=1e-6)
    np.testing.assert_allclose(np.transpose(by_h), torch.cat([slopes.h_h, slopes.rho_h], 1)[0].detach(), atol=1e-6)


@pytest.fixture(scope="module")
def loops():
    return Loops.of(LearnedObserverPolicy(student().network()))


class Creeping(LearnedObserverPolicy):
    """The reference of an arm at rest seems to move, so that the network acts."""

    def observe(self, observation, memory, torque, seen):
        moving = observation.copy()
        moving[:, START.dq_reference :][:, :2] = 2e-3  # rad/s
        super().observe(moving, memory, torque, seen)


def creeping(made, loops, which, load=0.0):
    """Points in the loops `which` with nothing unexplained but a load, for postures (0.6, 1.2) rad."""
    seen, observation = np.zeros((1, SEEN)), np.zeros((1, 10))
    observation[0, START.q_motor :][:2] = observation[0, START.q_reference :][:2] = 0.6, 1.2
    policy = Creeping(made.network())
    policy.observe(observation, np.zeros((1, policy.memory_size)), np.empty((1, 2)), seen)
    c, z = torch.from_numpy(seen[0, SEEN_PARTS[1]]).repeat(len(which), 1), torch.zeros(len(which), UNEXPLAINED)
    z[:, UNEXPLAINED_PARTS.load] = load
    return loops.points(np.array(which), z, c, torch.zeros(len(which), 6))


def test_the_linear_loop_is_the_one_whose_margins_are_measured(loops):
    made = student(output=0.016)
    policy, loaded = Creeping(made.network()), len(CONDITIONS) - 1
    loop = linearise(policy, ARM, np.array([0.6, 1.2]), PERIOD, Payload(CONDITIONS[loaded].payload))
    memory, seen = loop.equilibrium[np.newaxis, 8:].copy(), np.zeros((1, SEEN))
    h = torch.from_numpy(memory[:, policy.hidden].copy())
    observation = np.zeros((1, 10))
    observation[0, START.q_motor :][:2], observation[0, START.q_reference :][:2] = loop.equilibrium[:2], (0.6, 1.2)
    policy.without_dry_friction().observe(observation, memory, np.empty((1, 2)), seen)
    z, c, _ = (torch.from_numpy(seen[:, part]) for part in SEEN_PARTS)
    where = loops.points(np.array([loaded]), z, c, h)
    _, radius = eigenvalue_loss(made, loops, where, 0.99)
    measured = np.abs(np.linalg.eigvals(loop.matrix())).max()
    assert radius == pytest.approx(measured, rel=1e-3)
    assert abs(radius - float(loops.reference[int(where.loop[0])])) > 1e-3  # the network is part of the loop


def test_a_network_that_follows_the_second_observer_has_its_loop(loops):
    made = student(output=0.0)
    with torch.no_grad():
        made.D[:, UNEXPLAINED_PARTS.quick] = QUICK_SHARE * torch.eye(2)
    quick = ElasticObserverPolicy(ARM, PERIOD, QUICK)
    alone = linearise(quick, ARM, np.array([0.6, 1.2]), PERIOD)
    for number in (2, 3, 4):  # in which it is unstable
        where = creeping(made, loops, [number], load=1.0)
        measured = np.abs(np.linalg.eigvals(alone.matrix(CONDITIONS[number].gain, CONDITIONS[number].delay))).max()
        _, radius = eigenvalue_loss(made, loops, where, 0.99)
        assert radius == pytest.approx(measured, rel=2e-3) and radius > 1.1


def test_the_derivative_of_the_eigenvalue_loss_is_its_difference(loops):
    made = student(output=0.01)
    where = creeping(made, loops, [1, 2, 4, 7], load=0.1)
    made = made.double()
    loss, _ = eigenvalue_loss(made, loops, where, 0.9)
    loss.backward()
    direction = torch.randn(made.V.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    values = []
    for sign in (1.0, -1.0):
        with torch.no_grad():
            made.V.add_(sign * 1e-6 * direction)
            values.append(float(eigenvalue_loss(made, loops, where, 0.9)[0]))
            made.V.sub_(sign * 1e-6 * direction)
    assert float((made.V.grad * direction).sum()) == pytest.approx((values[0] - values[1]) / 2e-6, rel=1e-3)


def test_the_teacher_leads_the_tip_along_the_course_under_a_changing_force():
    reference = JointReference(Circle((0.4, 0.6), 0.17), parameters=ARM)
    loads = [Disturbance(tip_force=MachiningForce(130.0, 90.0)), Disturbance(payload=Payload(6.0))]
    scenarios = [Scenario(load, reference) for load in loads]
    lanes = Lanes([ARM], scenarios, 2, control_period=PERIOD, substeps=5, randomisation=NOTHING, threads=1)
    teacher = Teacher(ARM, Courses(lanes, np.full((2, 8), np.nan), np.zeros(2), np.zeros(2)))
    observation = lanes.layout.split(lanes.reset([0, 1]))[0]
    teacher.begin(np.ones(2, dtype=bool))
    errors = []
    for _ in range(150):
        observation, _, scalars = lanes.layout.split(lanes.step(teacher.torque(observation)))
        errors.append(1e3 * scalars[1])
    assert np.all(np.max(errors, axis=0) < 0.8)  # mm; 1.3 under the force without its rate


def test_the_teacher_is_stiff_only_where_torques_are_on_time():
    scenario = Scenario(Disturbance(), JointReference(Circle((0.4, 0.6), 0.17), parameters=ARM))
    lanes = Lanes([ARM], [scenario], 4, control_period=PERIOD, substeps=5, randomisation=NOTHING, threads=1)
    lanes.reset([0] * 4)
    aside, weights = lanes.numbers(slice(8)).T.copy(), (QUICK, ObserverWeights())
    aside[::2] += (error := 1e-5 * np.arange(1.0, 9.0))
    observation = lanes.layout.split(lanes.reset([0] * 4, None, aside))[0]
    teacher = Teacher(ARM, Courses(lanes, aside, np.zeros(4), np.array([0.0, 0.0, 1.0, 1.0])))
    teacher.begin(np.ones(4, dtype=bool))
    torque = teacher.torque(observation)
    for pair, weight in zip(np.split(torque, 2), weights, strict=True):
        inertia = np.array(mass_matrix(np.cos(aside[0, 1]), arm_constants(ARM)))[[[0, 1], [1, 2]]]
        gain = feedback_gain(*sampled_arm(ARM, PERIOD, inertia), np.array(ARM.torque_limit), weight)
        np.testing.assert_allclose(pair[1] - pair[0], gain @ error, rtol=0.01)  # the gains are interpolated


def test_the_motors_can_do_what_is_drawn():
    courses = draw_courses(ARM, 12, PERIOD, np.random.default_rng(0))
    lanes, teacher, errors = courses.lanes, Teacher(ARM, dataclasses.replace(courses, delay=np.zeros(12))), []
    observation = lanes.layout.split(lanes.reset(list(range(12))))[0]
    teacher.begin(np.ones(12, dtype=bool))
    for _ in range(150):
        observation, _, scalars = lanes.layout.split(lanes.step(teacher.torque(observation)))
        errors.append(1e3 * scalars[1])
    assert np.max(errors) < 1.5  # mm; ten times as much where a motor is at its limit


@pytest.fixture(scope="module")
def trained():
    return EstimateTraining(EstimateConfig(**SHORT)).run()


def test_the_same_seed_gives_the_same_network(trained):
    again = EstimateTraining(EstimateConfig(**SHORT)).run()
    for field in dataclasses.fields(EstimateNetwork):
        one, two = getattr(trained.network, field.name), getattr(again.network, field.name)
        assert one.tobytes() == two.tobytes()
    assert trained.network.A.tobytes() != Student(5, 2, torch.Generator().manual_seed(0)).network().A.tobytes()
    assert [row["chunk"] for row in trained.curve] == [0, 1]


@pytest.mark.slow
def test_training_lowers_the_loss():
    config = EstimateConfig(**{**SHORT, "chunks": 12, "lanes": 32, "updates": 10, "redraw": 100})
    losses = [row["loss"] for row in EstimateTraining(config).run().curve]
    assert np.mean(losses[-3:]) < 0.9 * np.mean(losses[:2])


def test_settings_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="steps = 100 and window = 150"):
        EstimateConfig(steps=100, window=150)
    with pytest.raises(ValueError, match="largest"):
        EstimateConfig(largest=1.1)
