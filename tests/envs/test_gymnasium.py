"""The single environment among Gymnasium's own tools: its registry, its wrappers, its checker."""

import dataclasses
import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from support.batches import SHORT
from support.randomisation import ROBUST

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.paths import Spline
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference

LONG = JointReference(duration=1.6)
HOLDING = np.zeros(2)


def steps_until_the_end(env, **reset):
    """The steps of an episode, and whether it was truncated; the torques hold the arm on its path."""
    env.reset(**reset)
    for step in range(1, 5000):
        info = env.unwrapped._lanes  # the reference itself is the state to be in: no policy is needed
        values, row, table = info.values, info.clock[0, 0], info.table
        values[0, :4, 0], values[0, 4:8, 0] = np.tile(table[row, :2], 2), 0.0
        *_, terminated, truncated, _ = env.step(HOLDING)
        if terminated or truncated:
            return step, truncated
    raise AssertionError("the episode does not end")


@pytest.mark.parametrize(
    ("arguments", "steps"),
    [({}, 1500), ({"reference": SHORT}, 50), ({"case": "payload", "reference": LONG, "control_period": 5e-3}, 320)],
    ids=str,
)
def test_the_spec_states_the_steps_of_an_episode_and_no_wrapper_counts_them(arguments, steps):
    assert gym.spec("FuzzyArm-v0").max_episode_steps is None and FuzzyArmEnv().spec is None
    env = gym.make("FuzzyArm-v0", **arguments)
    assert type(env) is FuzzyArmEnv and env.spec.max_episode_steps == steps
    assert steps_until_the_end(env, seed=0) == (steps, True)
    again = gym.make(env.spec, max_episode_steps=-1)
    assert type(again) is FuzzyArmEnv and steps_until_the_end(gym.make(env.spec)) == (steps, True)
    assert steps_until_the_end(again, options={"reference": LONG}) == (round(1.6 / again.control_period), True)


def test_a_time_limit_of_the_users_own_truncates():
    made = gym.make("FuzzyArm-v0", max_episode_steps=100)
    assert made.spec.max_episode_steps == 100
    for env, steps in ((made, 100), (wrappers.TimeLimit(made.env, 5000), 1500)):
        assert isinstance(env, wrappers.TimeLimit) and steps_until_the_end(env) == (steps, True)
    env = gym.make("FuzzyArm-v0", randomisation="robust")  # of drawn references, the longest counts
    lengths = set()
    for seed in range(6):
        env.reset(seed=seed)
        lengths.add(env.unwrapped._lanes.schedule(0)[1].steps)
    assert len(lengths) > 1 and max(lengths) <= env.spec.max_episode_steps


@pytest.mark.slow
@pytest.mark.parametrize("period", [1e-3, 3e-3])
def test_a_video_of_each_step_shows_real_time(period, tmp_path):
    moviepy = pytest.importorskip("moviepy")
    reference = JointReference(duration=0.3, path=SHORT.path)
    made = gym.make("FuzzyArm-v0", render_mode="rgb_array", reference=reference, control_period=period)
    env = wrappers.RecordVideo(made, str(tmp_path / "videos"))
    assert steps_until_the_end(env) == (round(0.3 / period), True)
    env.close()
    (file,) = (tmp_path / "videos").glob("*.mp4")
    with moviepy.VideoFileClip(str(file)) as video:
        assert video.duration == pytest.approx(0.3, rel=0.05)


@pytest.mark.slow
def test_every_twentieth_picture_gives_a_video_in_real_time(tmp_path, monkeypatch):
    """The loop of the documentation."""
    moviepy = pytest.importorskip("moviepy")
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "tutorials" / "first-episode.md").read_text(encoding="utf-8")
    (loop,) = re.findall(r"```python\n([^`]*save_video[^`]*)```", page)
    exec(loop, {})
    with moviepy.VideoFileClip("videos/rl-video-episode-0.mp4") as video:
        assert video.duration == pytest.approx(1.5, rel=0.05) and video.fps == 50.0


@pytest.mark.parametrize("case", CASES)
def test_the_checker_of_gymnasium_has_no_wish_beyond_scaled_actions(case, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    said = []
    monkeypatch.setattr(gym.logger, "warn", lambda message, *args, **kwargs: said.append(message))
    check_env(gym.make("FuzzyArm-v0", case=case).unwrapped)
    assert len(said) == 1 and "symmetric and normalized" in said[0]
    said.clear()
    check_env(wrappers.RescaleAction(gym.make("FuzzyArm-v0"), np.float32(-1), np.float32(1)))
    assert [text for text in said if "different from the unwrapped version" not in text] == []


def test_seeds_of_any_size_and_numpys_integers():
    env, batch = (make("FuzzyArm-v0", randomisation=ROBUST) for make in (gym.make, gym.make_vec))
    for seed in (3, 2**31, np.int64(2**31), np.uint64(2**63), 2**70):
        observation, _ = env.reset(seed=int(seed))
        np.testing.assert_array_equal(env.reset(seed=seed)[0], observation)
        np.testing.assert_array_equal(batch.reset(seed=seed)[0][0], observation)
    for wrong in (-1, np.int64(-1), 1.0, "1"):
        with pytest.raises((gym.error.Error, TypeError, ValueError), match=r"[Ss]eed"):
            env.reset(seed=wrong)


LIGHT = ArmParameters(stiffness=(8e4, 1.6e4))
BENT = JointReference(Spline(((0.4, 0.5), (0.42, 0.52), (0.45, 0.5))), parameters=LIGHT)
LOADED = Disturbance(ConstantForce((0.0, 30.0), 0.1), Payload(2.0), encoder_noise=EncoderNoise(1e-5, 1e-3))


@dataclasses.dataclass(frozen=True)
class Own:
    """A force of the user's own."""

    force: float = 1.0

    def at(self, time, tip_velocity):
        return np.full((*np.shape(time), 2), self.force)


@pytest.mark.parametrize(
    "arguments",
    [
        {"robot": LIGHT},
        {"parameters": LIGHT, "reference": BENT},
        {"robot": robot_named("planar-3r").with_payload(0.5), "control_period": np.float64(2e-3)},
        {"disturbance": LOADED},
        {"randomisation": DomainRandomisation(payload=(0.0, 2.0), references=(SHORT, LONG)), "case": "machining"},
    ],
    ids=lambda arguments: "-".join(arguments),
)
def test_what_the_spec_writes_is_made_again(arguments):
    made = gym.make("FuzzyArm-v0", **arguments)
    again = gym.make(EnvSpec.from_json(made.spec.to_json()))
    assert again.spec.to_json() == made.spec.to_json()
    assert again.unwrapped.parameters == made.unwrapped.parameters
    first, _ = made.reset(seed=3)
    np.testing.assert_array_equal(again.reset(seed=3)[0], first)
    torque = 0.3 * made.action_space.high
    for _ in range(20):
        seen, other = made.step(torque), again.step(torque)
        np.testing.assert_array_equal(seen[0], other[0])
        np.testing.assert_array_equal(seen[4]["q_link"], other[4]["q_link"])


def test_wrappers_and_batches_write_their_specs_too():
    wrapped = wrappers.ClipAction(gym.make("FuzzyArm-v0", parameters=LIGHT, max_episode_steps=9))
    again = gym.make(EnvSpec.from_json(wrapped.spec.to_json()))
    assert isinstance(again, wrappers.ClipAction) and again.unwrapped.parameters == LIGHT
    assert steps_until_the_end(again, seed=0) == (9, True)
    for mode, given in (("vector_entry_point", [LIGHT, ArmParameters()]), ("sync", LIGHT)):
        envs = gym.make_vec("FuzzyArm-v0", num_envs=2, vectorization_mode=mode, parameters=given)
        same = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))
        assert type(same) is type(envs) and same.num_envs == 2
        np.testing.assert_array_equal(same.reset(seed=0)[0], envs.reset(seed=0)[0])


@pytest.mark.parametrize(
    "arguments", [{"disturbance": Disturbance(tip_force=Own())}, {"reference": object()}], ids=list
)
def test_what_cannot_be_made_again_is_not_written(arguments):
    spec = gym.make("FuzzyArm-v0").spec
    spec.kwargs |= arguments
    with pytest.raises(ValueError, match=r"(Own|object).* cannot be written as JSON: leave it out of the spec"):
        spec.to_json()


@pytest.mark.parametrize("name", ["physics.robot.os", "physics.robot.DIMENSIONS", "nowhere.Robot", "..cli.main", 3])
def test_data_name_records_of_the_package_alone(name):
    with pytest.raises(ValueError, match=rf"record = {name!r} does not name a data class"):
        gym.make("FuzzyArm-v0", robot={"record": name})
