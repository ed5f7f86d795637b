"""`learned-observer` of robots by their frames: what its network sees, its bundles, and that it acts."""

import dataclasses
import json

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import filled
from fuzzyarm.envs.physics.rigid_body import tip_jacobian
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.fuzzy_policy.known_arm import constants_of
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.bundle import BundleError
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.fuzzy_policy.laws.learned.estimate.network import EstimateBundle, EstimateNetwork, shapes_of
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.estimate.signals import context_of, context_parts, scale_of, turns_of, units_of

PLANAR, PERIOD = robot_named("planar-3r"), 1e-3


def network(joints, axes=3, seed=0):
    generator = np.random.default_rng(seed)
    return EstimateNetwork(
        **{
            name: ((0.0015 if name in "VGD" else 0.3) * generator.normal(size=shape)).astype(np.float32)
            for name, shape in shapes_of(7, 3, joints, axes).items()
        }
    )


@pytest.fixture
def folder(tmp_path):
    """A folder with a bundle of planar-3r."""
    EstimateBundle(network(3), ArmDefinition(PLANAR.name, PLANAR.digest), PERIOD).save(tmp_path / "mine")
    return tmp_path / "mine"


def test_a_bundle_of_a_robot_is_refused_for_any_other(folder):
    assert EstimateBundle.load(folder).serves(dataclasses.replace(PLANAR, name="the same numbers"))
    for robot in ("ur5", "paper", dataclasses.replace(PLANAR, gravity=(9.8, 0.0, 0.0))):
        with pytest.raises(ValueError, match="mine was trained on planar-3r and knows no other; take adaptive-obs"):
            load_policy(folder, robot=robot)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("arm"), "it names no arm, or two"),
        (lambda d: d.update(parameters=ArmParameters().to_dict()), "it names no arm, or two"),
        (lambda d: d.update(parameters=d.pop("arm") and ArmParameters().to_dict()), "its network for 3 joints"),
    ],
)
def test_a_bundle_that_does_not_say_for_which_arm_it_is_is_refused(folder, change, message):
    content = json.loads((folder / "policy.json").read_text())
    change(content)
    (folder / "policy.json").write_text(json.dumps(content))
    with pytest.raises(BundleError, match=message):
        EstimateBundle.load(folder)


def test_units_of_a_robot_are_those_of_the_same_arm_and_angles_add_about_parallel_axes():
    paper, robot = ArmParameters(), Robot.of(ArmParameters())
    assert scale_of(robot) == scale_of(paper) == (1.0, 1.0, 1.0)
    for name in ("torque", "load", "velocity", "acceleration", "slow", "slow_tip", "rest", "length"):
        np.testing.assert_allclose(getattr(units_of(robot), name), getattr(units_of(paper), name), rtol=1e-12)
    np.testing.assert_array_equal(turns_of(robot), turns_of(paper))
    np.testing.assert_array_equal(turns_of(paper), [0, 1])
    np.testing.assert_array_equal(turns_of(robot_named("ur5")), [0, 0, 1, 1, 0, 0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar-3r", "ur5"])
def test_the_context_of_a_robot_is_its_equations(name):
    robot = robot_named(name)
    joints, physics, units = len(robot), equations_of(robot), units_of(robot)
    part, generator = context_parts(joints, 3), np.random.default_rng(0)
    c, o, feedforward = np.empty(part.motion.stop), generator.normal(size=5 * joints), generator.normal(size=joints)
    limit, turns = robot.drive("torque_limit"), turns_of(robot)
    seen = observed(o)
    arm = filled(physics.Arm, constants_of(robot))
    context_of(physics)(seen, feedforward, limit, turns, arm, units, c)
    q, _, _, dq, ddq = np.split(o, 5)
    jacobian = tip_jacobian(robot, q)
    velocity = jacobian @ dq
    travel = velocity / np.sqrt(velocity @ velocity + (0.02 * scale_of(robot).length) ** 2)
    psi = [q[0]]
    for angle, turn in zip(q[1:], turns[1:], strict=True):
        psi.append(angle + turn * psi[-1])
    np.testing.assert_allclose(c[part.angles], np.ravel([np.cos(psi), np.sin(psi)], order="F"), atol=1e-12)
    np.testing.assert_allclose(c[part.travel], travel, atol=1e-12)
    np.testing.assert_allclose(c[part.lever], jacobian.T @ travel / scale_of(robot).length, atol=1e-12)
    np.testing.assert_allclose(c[part.velocities], dq / units.velocity)
    np.testing.assert_allclose(c[part.accelerations], ddq / units.acceleration)
    np.testing.assert_allclose(c[part.feedforward], feedforward / limit)


@pytest.fixture(scope="module")
def planar():
    return LearnedObserverPolicy(network(3), PLANAR, PERIOD)


@pytest.mark.slow
def test_on_a_robot_a_lane_is_the_single_arm_and_rest_is_the_elastic_observers(planar):
    generator, states, batch_state = np.random.default_rng(1), [None] * 3, None
    for _ in range(10):
        observations = 0.3 * generator.normal(size=(3, 15))
        batch, batch_state = planar.predict(observations, batch_state, np.zeros(3, dtype=bool))
        for lane in range(3):
            single, states[lane] = planar.predict(observations[lane], states[lane])
            assert single.tobytes() == batch[lane].tobytes()
            assert states[lane].tobytes() == batch_state[lane].tobytes()
    observer, memory, own = ElasticObserverPolicy(PLANAR, PERIOD), None, None
    posture = np.array([0.6, 0.8, 0.5])
    rest = np.concatenate([posture, np.zeros(3), posture, np.zeros(6)])
    for _ in range(20):
        read = rest + np.concatenate([1e-4 * generator.normal(size=6), np.zeros(9)])
        expected, memory = observer.predict(read, memory)
        torque, own = planar.predict(read, own)
        assert torque.tobytes() == expected.tobytes()


@pytest.mark.slow
def test_the_margins_of_a_robot_are_the_elastic_observers(planar):
    own, base = (
        policy_margins(policy, PLANAR, PERIOD)["spectral_radius"]["nominal"]
        for policy in (planar, ElasticObserverPolicy(PLANAR, PERIOD))
    )
    assert own == base


@pytest.mark.slow
def test_a_network_of_other_joints_is_refused():
    with pytest.raises(ValueError, match="the network is for 6 joints and a tip in 3 axes, the arm has 3 and 3"):
        LearnedObserverPolicy(network(6), PLANAR, PERIOD)


@pytest.mark.slow
def test_an_export_that_would_be_too_long_is_refused_in_one_line(tmp_path, capsys):
    ur5 = robot_named("ur5")
    EstimateBundle(network(6), ArmDefinition(ur5.name, ur5.digest), PERIOD).save(tmp_path / "mine")
    command = ["export", "c", str(tmp_path / "mine"), "--robot", "ur5", "--out", str(tmp_path / "new")]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert "it remembers" in error and error.count("\n") == 1
