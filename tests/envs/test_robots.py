"""The environments of any serial robot: one arm, a batch and tensors, against NumPy and against each other."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from support.plain import hold_numpy

from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import bounds_of, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.envs.physics.rigid_body import gravity, tip_position
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.disturbances import (
    ConstantForce,
    Disturbance,
    EncoderNoise,
    MachiningForce,
    TorqueBias,
)
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.robot_reference import SplineReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv

NAMES = "planar-3r", "ur5", "panda"
pytestmark = pytest.mark.slow  # the code of three and more joints takes a while to compile
VARIED = DomainRandomisation(
    mass=(0.9, 1.1),
    stiffness=(0.8, 1.2),
    dry_friction=(0.5, 1.5),
    payload=(0.0, 0.5),
    force=(0.5, 1.0),
    angle=(-0.01, 0.01),
)


def disturbed(joints):
    """Everything at once."""
    return Disturbance(
        tip_force=ConstantForce((3.0, -2.0, 4.0), 0.004, 0.02),
        payload=Payload(0.4),
        torque_bias=TorqueBias(tuple(0.1 * (k + 1) for k in range(joints)), 0.002, 0.03),
        encoder_noise=EncoderNoise(1e-4, 1e-3),
    )


def torques(robot, steps, seed=0):
    """Torques about those that hold the robot's weight at home, (steps, n) [N m]."""
    limit = robot.drive("torque_limit")
    return 0.4 * limit * np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, len(robot)))


def short(robot, duration=0.05):
    """A reference of fifty steps, well inside the ranges of the joints."""
    low, high = bounds_of(robot)[:2]
    start = 0.5 * (low + high) + np.minimum(0.3, 0.1 * (high - low))
    return SplineReference((tuple(start), tuple(start + 0.3 * duration)), duration, robot)


@pytest.fixture(params=NAMES)
def robot(request):
    return robot_named(request.param)


# --- spaces and readings -----------------------------------------------------------------------------------------


def test_spaces_have_five_numbers_and_one_torque_a_joint(robot):
    env, n = FuzzyArmEnv(robot=robot), len(robot)
    low, high, velocity, torque = bounds_of(robot)
    assert env.observation_space.shape == (5 * n,) and env.action_space.shape == (n,)
    np.testing.assert_array_equal(env.action_space.high, torque.astype(np.float32))
    np.testing.assert_array_equal(env.observation_space.low[2 * n : 3 * n], low)
    np.testing.assert_allclose(env.observation_space.high[:n], high + 0.5 * (high - low), rtol=1e-15)
    np.testing.assert_array_equal(env.observation_space.high[3 * n : 4 * n], velocity)


@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space")
def test_gymnasium_accepts_the_environment(robot):
    check_env(FuzzyArmEnv(robot=robot, reference=short(robot)), skip_render_check=True)


def test_the_episode_begins_at_rest_with_the_motors_holding_the_weight(robot):
    env, n = FuzzyArmEnv(robot=robot), len(robot)
    observation, info = env.reset(seed=0)
    np.testing.assert_allclose(info["q_link"], env.reference.sample(0.0).q, rtol=0.0, atol=0.0)
    bent = robot.drive("stiffness") * (info["q_motor"] - info["q_link"])
    np.testing.assert_allclose(bent, gravity(robot, info["q_link"]), rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(info["tip"], tip_position(robot, info["q_link"]), rtol=0.0, atol=1e-12)
    assert info["tip_error"] < 1e-9 and not info["dq_motor"].any() and info["tip"].shape == (3,)
    np.testing.assert_array_equal(observation, env.unwrapped._lanes.observation()[0])
    assert all(
        info[name].shape == ((3,) if name in ("tip", "tip_reference", "external_force") else (n,)) for name in VECTORS
    )


def test_a_step_is_the_numpy_arm_under_the_schedule(robot):
    """The reference back end: `hold_numpy` from what `info` says, bit for bit."""
    reference, n, physics = short(robot), len(robot), equations_of(robot)
    given = disturbed(n)
    env = FuzzyArmEnv(robot=robot, reference=reference, disturbance=given)
    _, info = env.reset(seed=0)
    schedule = env._lanes.schedule(0)[1]
    place = physics.payload_place(given.payload, robot)
    arm = np.array(flat(physics.constants(physics.plant_of(robot), given.payload.mass, place, 0.0)))[:, np.newaxis]
    low, high = -bounds_of(robot).torque, bounds_of(robot).torque
    for k, torque in enumerate(torques(robot, 30)):
        state = np.concatenate([info[name] for name in ("q_motor", "q_link", "dq_motor", "dq_link")])[:, np.newaxis]
        _, _, _, _, info = env.step(torque)
        applied = (np.clip(torque, low, high) + schedule.biases[k])[:, np.newaxis]
        force = schedule.forces[k][:, np.newaxis]
        expected = hold_numpy(physics, state, applied, force, arm, env.substep, env.substeps)[:, 0]
        found = np.concatenate([info[name] for name in ("q_motor", "q_link", "dq_motor", "dq_link")])
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.0)
        np.testing.assert_array_equal(info["external_force"], schedule.forces[k][:3])
    assert schedule.forces[10].any() and schedule.biases[10].all()


# --- lanes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("threads", [1, 2])
def test_lane_i_is_the_single_arm_bit_for_bit(robot, threads):
    setting = {"robot": robot, "reference": short(robot), "disturbance": disturbed(len(robot)), "randomisation": VARIED}
    lanes = 35
    envs, actions = FuzzyArmVectorEnv(lanes, threads=threads, **setting), torques(robot, 40)
    together = [envs.reset(seed=7)[0]]
    infos = []
    for action in actions:
        observation, _, _, _, info = envs.step(np.tile(action, (lanes, 1)))
        together.append(observation)
        infos.append(info)
    for lane in (0, 1, 31, 32, 34):
        env = FuzzyArmEnv(**setting)
        observation, _ = env.reset(seed=7 + lane)
        assert np.array_equal(observation, together[0][lane])
        for k, action in enumerate(actions):
            observation, reward, _, _, info = env.step(action)
            assert np.array_equal(observation, together[k + 1][lane])
            assert all(np.array_equal(info[name], infos[k][name][lane]) for name in VECTORS)
            assert reward == pytest.approx(infos[k]["reward_tracking"][lane], abs=0.11)
    assert info["randomisation"]["mass"].shape == (len(robot),)
    assert infos[0]["randomisation"]["mass"].shape == (lanes, len(robot))
    envs.close()


def test_a_batch_ends_and_begins_its_episodes(robot):
    envs, n = FuzzyArmVectorEnv(3, robot=robot, reference=short(robot, 0.01)), len(robot)
    envs.reset(seed=0)
    for _ in range(9):
        *_, truncated, info = envs.step(np.zeros((3, n)))
        assert not truncated.any()
    *_, truncated, info = envs.step(np.zeros((3, n)))
    assert truncated.all() and info["final_info"]["tip"].shape == (3, 3) and info["final_obs"][0].shape == (5 * n,)


def test_a_state_is_taken_up_again_and_that_of_another_robot_is_refused(robot):
    envs, actions = FuzzyArmVectorEnv(4, robot=robot, randomisation=VARIED), torques(robot, 20)
    envs.reset(seed=1)
    for action in actions[:10]:
        envs.step(np.tile(action, (4, 1)))
    state = envs.get_state()
    twin = FuzzyArmVectorEnv(4, robot=robot, randomisation=VARIED)
    twin.set_state(state)
    for action in actions[10:]:
        first, second = envs.step(np.tile(action, (4, 1))), twin.step(np.tile(action, (4, 1)))
        assert np.array_equal(first[0], second[0]) and np.array_equal(first[4]["tip"], second[4]["tip"])
    with pytest.raises(ValueError, match="other plants"):
        FuzzyArmVectorEnv(4).set_state(state)


@pytest.mark.parametrize(
    "duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"]
)
def test_a_copy_goes_on_bit_for_bit(robot, duplicate):
    env, actions = FuzzyArmEnv(robot=robot, disturbance=disturbed(len(robot))), torques(robot, 10)
    env.reset(seed=2)
    for action in actions[:5]:
        env.step(action)
    twin = duplicate(env)
    for action in actions[5:]:
        assert np.array_equal(env.step(action)[0], twin.step(action)[0])


def test_the_batch_in_tensors_is_the_batch(robot):
    torch = pytest.importorskip("torch")
    from fuzzyarm.rl_baselines.torch_env import TorchFuzzyArm

    setting = {"robot": robot, "reference": short(robot), "disturbance": disturbed(len(robot)), "randomisation": VARIED}
    lanes, n = 3, len(robot)
    envs = FuzzyArmVectorEnv(lanes, **setting)
    tensors = TorchFuzzyArm(lanes, dtype=torch.float64, compiled=False, **setting)
    found, (expected, _) = tensors.reset(seed=3), envs.reset(seed=3)
    assert found.shape == (lanes, 5 * n)
    np.testing.assert_allclose(found.numpy(), expected, rtol=0.0, atol=1e-12)
    for action in torques(robot, 10):
        actions = np.tile(action, (lanes, 1))
        found, (expected, reward, *_, info) = tensors.step(torch.tensor(actions)), envs.step(actions)
        np.testing.assert_allclose(found[0].numpy(), expected, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(found[1].numpy(), reward, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(found[-1]["tip"].numpy(), info["tip"], rtol=0.0, atol=1e-10)
    single = TorchFuzzyArm(lanes, dtype=torch.float32, compiled=False, **setting)
    single.reset(seed=3)
    for action in torques(robot, 10):
        last = single.step(torch.tensor(np.tile(action, (lanes, 1)), dtype=torch.float32))
    np.testing.assert_allclose(last[-1]["tip"].numpy(), info["tip"], rtol=0.0, atol=1e-5)


# --- disturbances ------------------------------------------------------------------------------------------------


def test_noise_has_its_spread_in_every_joint():
    robot = robot_named("planar-3r")
    reference, noise = short(robot, 1.0), EncoderNoise(1e-3, 1e-2)
    envs = FuzzyArmVectorEnv(200, robot=robot, reference=reference, disturbance=Disturbance(encoder_noise=noise))
    observation, info = envs.reset(seed=0)
    errors = [observation[:, :6] - np.hstack([info["q_motor"], info["dq_motor"]])]
    for _ in range(20):
        observation, *_, info = envs.step(np.zeros((200, 3)))
        errors.append(observation[:, :6] - np.hstack([info["q_motor"], info["dq_motor"]]))
    rows = np.concatenate(errors) / np.repeat([1e-3, 1e-2], 3)
    np.testing.assert_allclose(rows.std(axis=0), 1.0, atol=0.05)
    np.testing.assert_allclose(np.corrcoef(rows.T), np.eye(6), atol=0.06)


def test_a_payload_at_the_tip_is_a_heavier_last_link():
    robot = robot_named("planar-3r")
    carried = FuzzyArmEnv(robot=robot, reference=short(robot), disturbance=Disturbance(payload=Payload(2.0)))
    heavier = FuzzyArmEnv(robot=robot.with_payload(2.0), reference=short(robot))
    start = {"initial_state": np.concatenate([np.full(6, 0.3), np.zeros(6)])}
    carried.reset(seed=0, options=start)
    heavier.reset(seed=0, options=start)
    for torque in torques(robot, 30):
        first, second = carried.step(torque), heavier.step(torque)
    np.testing.assert_allclose(first[0], second[0], rtol=0.0, atol=1e-10)
    plain = FuzzyArmEnv(robot=robot, reference=short(robot))
    plain.reset(seed=0, options=start)
    for torque in torques(robot, 30):
        third = plain.step(torque)
    assert np.abs(third[0] - first[0]).max() > 1e-4


# --- arguments ---------------------------------------------------------------------------------------------------


def test_a_robot_by_name_by_file_and_as_an_object_is_the_same(tmp_path):
    from fuzzyarm.envs.physics import robot as module

    source = module._SHIPPED / "planar-3r.toml"
    mine = tmp_path / "mine.toml"
    mine.write_text(source.read_text())
    for given in ("planar-3r", str(mine), mine, robot_named("planar-3r")):
        env = gym.make("fuzzyarm:FuzzyArm-v0", robot=given)
        assert env.unwrapped.parameters.digest == robot_named("planar-3r").digest
    envs = gym.make_vec("fuzzyarm:FuzzyArm-v0", num_envs=2, robot="planar-3r", vectorization_mode="vector_entry_point")
    assert envs.single_action_space.shape == (3,)


def test_the_papers_robot_is_the_arm_of_table_1():
    assert FuzzyArmEnv(robot="paper").parameters == ArmParameters()


REFUSED = {
    "no such robot": ({"robot": "ur55"}, ValueError, "unknown robot 'ur55'; choose from: .*planar-3r.*toml"),
    "no robot": ({"robot": 7}, TypeError, "robot is int; it must be a name"),
    "both": ({"robot": "ur5", "parameters": ArmParameters()}, ValueError, "give either robot"),
    "no file": ({"robot": "missing.toml"}, OSError, "missing.toml"),
    "reference of another arm": (
        {"robot": "planar-3r", "reference": "paper"},
        ValueError,
        "moves 2 joints, the plant has 3",
    ),
    "force in a plane": (
        {"robot": "planar-3r", "disturbance": Disturbance(tip_force=ConstantForce((1.0, 2.0)))},
        ValueError,
        r"must be \([0-9]+, 3\)",
    ),
    "bias of two": (
        {"robot": "planar-3r", "disturbance": Disturbance(torque_bias=TorqueBias((1.0, 2.0)))},
        ValueError,
        "TorqueBias.torque has 2 numbers; needed: 3",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_fit_is_refused_in_one_line(name):
    arguments, kind, message = REFUSED[name]
    if arguments.get("reference") == "paper":
        arguments = {**arguments, "reference": FuzzyArmEnv().reference}
    with pytest.raises(kind, match=message) as caught:
        FuzzyArmEnv(**arguments)
    assert "\n" not in str(caught.value)


def test_actions_and_starts_of_another_size_are_refused():
    env = FuzzyArmEnv(robot="planar-3r")
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"must be \(3,\): the three motor torques"):
        env.step(np.zeros(2))
    with pytest.raises(ValueError, match="is not finite; allowed: ±"):
        env.step(np.array([0.0, np.nan, 0.0]))
    with pytest.raises(ValueError, match="must be 12 finite numbers"):
        env.reset(options={"initial_state": np.zeros(8)})
    with pytest.raises(ValueError, match="must have the same structure"):
        FuzzyArmVectorEnv(2, robot=["planar-3r", "ur5"], reference=FuzzyArmEnv(robot="planar-3r").reference)


def test_a_reference_of_a_robot_with_other_frames_is_refused():
    robot = robot_named("planar-3r")
    longer = copy.copy(robot)
    object.__setattr__(longer, "tip", (robot.tip[0] + 0.1, *robot.tip[1:]))
    longer.__dict__.pop("arrays", None)
    with pytest.raises(ValueError, match="whose joints or tip are elsewhere"):
        FuzzyArmEnv(robot=longer, reference=short(robot))


def test_the_case_of_a_robot_moves_its_tip():
    robot = robot_named("planar-3r")
    env = FuzzyArmEnv(robot=robot, reference=short(robot), disturbance=Disturbance(tip_force=MachiningForce(20.0, 5.0)))
    env.reset(seed=0)
    for _ in range(25):
        *_, info = env.step(np.zeros(3))
    velocity = env.reference.tip(info["time"] - 0.5e-3).velocity
    assert info["external_force"] @ velocity < 0.0
