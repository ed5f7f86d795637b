"""The environments of any serial robot: one arm, a batch and tensors, against NumPy and against each other."""

import dataclasses

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from support.batches import batch, loop
from support.plain import hold_numpy
from support.results import assert_identical

from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import bounds_of, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.envs.physics.rigid_body import frames, gravity
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise, TorqueBias
from fuzzyarm.envs.scenario.randomisation import find_randomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.scenario.robot_reference import SplineReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv

pytestmark = pytest.mark.slow  # the code of three and more joints takes a while to compile
PLANAR = robot_named("planar-3r")
PLANTS = find_randomisation("plants", PLANAR)
VARIED = dataclasses.replace(PLANTS, payload=(0.0, 0.5), force=(0.5, 1.0), angle=(-0.01, 0.01))


def torques(robot, steps):
    return 0.4 * robot.drive("torque_limit") * np.random.default_rng(0).uniform(-1.0, 1.0, (steps, len(robot)))


def short(robot, duration=0.05):
    low, high = bounds_of(robot)[:2]
    start = 0.5 * (low + high) + np.minimum(0.3, 0.1 * (high - low))
    return SplineReference((tuple(start), tuple(start + 0.3 * duration)), duration, robot)


def disturbed(robot):
    disturbance = Disturbance(
        tip_force=ConstantForce((3.0, -2.0, 4.0), 0.004, 0.02),
        payload=Payload(0.4),
        torque_bias=TorqueBias(tuple(0.1 * (k + 1) for k in range(len(robot))), 0.002, 0.03),
        encoder_noise=EncoderNoise(1e-4, 1e-3),
    )
    return {"robot": robot, "reference": short(robot), "disturbance": disturbance}


@pytest.fixture(params=("planar-3r", "ur5", "panda"))
def robot(request):
    return robot_named(request.param)


@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space")
def test_spaces_have_five_numbers_and_one_torque_a_joint_and_gymnasium_accepts_them(robot):
    env, n = FuzzyArmEnv(robot=robot, reference=short(robot)), len(robot)
    low, high, velocity, torque = bounds_of(robot)
    assert env.observation_space.shape == (5 * n,) and env.action_space.shape == (n,)
    np.testing.assert_array_equal(env.action_space.high, torque.astype(np.float32))
    np.testing.assert_array_equal(env.observation_space.low[2 * n : 3 * n], low)
    np.testing.assert_allclose(env.observation_space.high[:n], high + 0.5 * (high - low), rtol=1e-15)
    np.testing.assert_array_equal(env.observation_space.high[3 * n : 4 * n], velocity)
    check_env(env, skip_render_check=True)


def test_the_episode_begins_at_rest_with_the_motors_holding_the_weight(robot):
    env, n = FuzzyArmEnv(robot=robot), len(robot)
    observation, info = env.reset(seed=0)
    np.testing.assert_allclose(info["q_link"], env.reference.sample(0.0).q, rtol=0.0, atol=0.0)
    bent = robot.drive("stiffness") * (info["q_motor"] - info["q_link"])
    np.testing.assert_allclose(bent, gravity(robot, info["q_link"]), rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(info["tip"], frames(robot, info["q_link"]).tip, rtol=0.0, atol=1e-12)
    assert info["tip_error"] < 1e-9 and not info["dq_motor"].any() and info["tip"].shape == (3,)
    np.testing.assert_array_equal(observation, env.unwrapped._lanes.observation()[0])
    of_tip = "tip", "tip_reference", "external_force"
    assert all(info[name].shape == ((3,) if name in of_tip else (n,)) for name in VECTORS)


def test_a_step_is_the_numpy_arm_under_the_schedule(robot):
    """The reference back end: `hold_numpy` from what `info` says, bit for bit."""
    given, physics, bound = disturbed(robot), equations_of(robot), bounds_of(robot).torque
    env, payload = FuzzyArmEnv(**given), given["disturbance"].payload
    _, info = env.reset(seed=0)
    schedule = env._lanes.schedule(0)[1]
    place = physics.payload_place(payload, robot)
    arm = np.array(flat(physics.constants(physics.plant_of(robot), payload.mass, place, 0.0)))[:, np.newaxis]
    names = ("q_motor", "q_link", "dq_motor", "dq_link")
    for k, torque in enumerate(torques(robot, 30)):
        state = np.concatenate([info[name] for name in names])[:, np.newaxis]
        *_, info = env.step(torque)
        applied = (np.clip(torque, -bound, bound) + schedule.biases[k])[:, np.newaxis]
        force = schedule.forces[k][:, np.newaxis]
        expected = hold_numpy(physics, state, applied, force, arm, env.substep, env.substeps)[:, 0]
        np.testing.assert_array_equal(np.concatenate([info[name] for name in names]), expected)
        np.testing.assert_array_equal(info["external_force"], schedule.forces[k][:3])
    assert schedule.forces[10].any() and schedule.biases[10].all()


def test_a_batch_equals_gymnasiums_loop_over_single_arms(robot):
    setting = {"randomisation": VARIED, **disturbed(robot)}
    envs, expected = batch(18, **setting), loop(18, **setting)
    assert_identical(envs.reset(seed=7), expected.reset(seed=7))
    for step, action in enumerate(torques(robot, 55)):
        actions = np.tile(action, (18, 1))
        assert_identical(envs.step(actions), expected.step(actions), step)


@pytest.mark.parametrize(("dtype", "close"), [("float64", 1e-9), ("float32", 1e-4)])
def test_the_batch_in_tensors_is_the_batch(robot, dtype, close):
    torch = pytest.importorskip("torch")
    from fuzzyarm.rl_baselines.torch_env import TorchFuzzyArm

    setting = {"randomisation": VARIED, **disturbed(robot)}
    kind, envs = getattr(torch, dtype), FuzzyArmVectorEnv(3, **setting)
    tensors = TorchFuzzyArm(3, dtype=kind, compiled=False, **setting)
    np.testing.assert_allclose(tensors.reset(seed=3)[0].numpy(), envs.reset(seed=3)[0], rtol=0.0, atol=close)
    for action in torques(robot, 10):
        actions = np.tile(action, (3, 1))
        found, (_, reward, *_, info) = tensors.step(torch.tensor(actions, dtype=kind)), envs.step(actions)
        np.testing.assert_allclose(found[1].numpy(), reward, rtol=0.0, atol=10.0 * close)
        np.testing.assert_allclose(found[-1]["tip"].numpy(), info["tip"], rtol=0.0, atol=close)


LONGER = dataclasses.replace(PLANAR, tip=(PLANAR.tip[0] + 0.1, *PLANAR.tip[1:]))
REFUSED = [
    ({"robot": "ur55"}, ValueError, "unknown robot 'ur55'; choose from: .*planar-3r.*toml"),
    ({"robot": 7}, TypeError, "robot is of type int; give a name"),
    ({"robot": "ur5", "parameters": ArmParameters()}, ValueError, "give either robot"),
    ({"robot": "missing.toml"}, OSError, "missing.toml"),
    ({"robot": PLANAR, "reference": JointReference()}, ValueError, "moves 2 joints, but the plant has 3"),
    ({"robot": LONGER, "reference": short(PLANAR)}, ValueError, "has other joint frames or another tip"),
]


@pytest.mark.parametrize(("arguments", "kind", "message"), REFUSED)
def test_what_does_not_fit_is_refused_in_one_line(arguments, kind, message):
    with pytest.raises(kind, match=message) as caught:
        FuzzyArmEnv(**arguments)
    assert "\n" not in str(caught.value)


def test_actions_and_starts_of_another_size_are_refused():
    env = FuzzyArmEnv(robot=PLANAR)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"must be \(3,\): the three motor torques"):
        env.step(np.zeros(2))
    with pytest.raises(ValueError, match="must be 12 finite numbers"):
        env.reset(options={"initial_state": np.zeros(8)})
    with pytest.raises(ValueError, match="must have the same structure"):
        FuzzyArmVectorEnv(2, robot=["planar-3r", "ur5"], reference=short(PLANAR))
