"""The episode loop, single and batched: the same signals for the same arm, and lanes that end at different times."""

import dataclasses

import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise, MachiningForce
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import TipErrors, episodes
from fuzzyarm.eval.episodes.rollout import Rollout, Signals, record_rollout

NOISY = Disturbance(tip_force=MachiningForce(), encoder_noise=EncoderNoise(1e-5, 1e-3))
REFERENCES = [JointReference(duration=duration) for duration in (1.4, 1.2, 1.5)]


class Escaping:
    """Computed torque, but full torque in lane 1 from call 300 on: that episode is terminated."""

    def __init__(self):
        self.law, self.calls, self.starts = load_policy("computed-torque"), 0, []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        torque, state = self.law.predict(observation, state, episode_start, deterministic)
        self.calls += 1
        self.starts.append(episode_start.copy())
        if self.calls > 300:
            torque[1] = self.law.parameters.torque_limit
        return torque, state


def recorded(envs, policy, lanes):
    """Return the rollout of each lane, and the tip errors of all."""
    signals, errors = [Signals(lane) for lane in range(lanes)], TipErrors(lanes)
    for step in episodes(envs, policy, envs.reset(seed=5)):
        errors.add(step)
        for one in signals:
            one.add(step)
    parameters = load_policy("computed-torque").parameters
    given = {"policy": "", "case": "", "control_period": 1e-3, "parameters": parameters}
    return [one.rollout(seed=5 + lane, **given) for lane, one in enumerate(signals)], errors


@pytest.mark.parametrize("name", slow_but(["elastic-observer"], ["computed-torque", "elastic-observer"]))
def test_each_lane_is_the_single_arm(name):
    envs = FuzzyArmVectorEnv(3, disturbance=NOISY, reference=REFERENCES, threads=1)
    runs, errors = recorded(envs, load_policy(name), 3)
    for lane, (run, reference) in enumerate(zip(runs, REFERENCES, strict=True)):
        env = FuzzyArmEnv(disturbance=NOISY, reference=reference)
        alone = record_rollout(env, load_policy(name), policy_name="", case="", seed=5 + lane)
        assert alone.step_time > 0.0
        for field in dataclasses.fields(Rollout):
            if field.name != "step_time":
                np.testing.assert_array_equal(getattr(run, field.name), getattr(alone, field.name), err_msg=field.name)
        assert errors.largest[lane] == alone.tip_error.max()
        assert errors.rms[lane] == pytest.approx(np.sqrt(np.mean(alone.tip_error**2)), rel=1e-12)
        assert errors.steps[lane] == len(alone.time) == round(1e3 * reference.duration)
    assert errors.completed.all()


def test_a_terminated_lane_stops_there_and_the_others_go_on():
    policy = Escaping()
    envs = FuzzyArmVectorEnv(3, reference=JointReference(duration=1.2), threads=1)
    (first, escaped, last), errors = recorded(envs, policy, 3)
    assert (first.completed, escaped.completed, last.completed) == (True, False, True)
    assert errors.completed.tolist() == [True, False, True]
    assert escaped.reason.endswith("left the domain (25)")
    assert first.reason == last.reason == ""
    assert escaped.domain_use[-1] > 1.0 >= escaped.domain_use[:-1].max()
    assert 300 < len(escaped.time) < len(first.time) == 1200
    assert escaped.time[-1] == pytest.approx(1e-3 * len(escaped.time))  # not the instant of the next episode
    assert errors.steps.tolist() == [len(first.time), len(escaped.time), len(last.time)]
    starts = np.array(policy.starts)
    assert starts[0].all()
    assert not starts[1:, [0, 2]].any()
    assert np.flatnonzero(starts[1:, 1])[0] + 1 == len(escaped.time)


def test_what_the_policy_reads_and_what_the_motors_get_can_be_changed():
    env, given = FuzzyArmEnv(reference=JointReference(duration=0.6)), []

    class Seen:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            given.append(observation)
            return np.array([1.0, 2.0]), state

    start = env.reset(seed=0)
    run = episodes(env, Seen(), start, sense=lambda o, info: o + info["time"], actuate=lambda torque: 3.0 * torque)
    step = next(run)
    np.testing.assert_array_equal(given[0], start[0] + start[1]["time"])
    np.testing.assert_array_equal(step.info["torque"], [3.0, 6.0])
    next(run)
    np.testing.assert_array_equal(given[1], step.observation + step.info["time"])


def test_every_step_says_what_the_policy_remembers_and_how_long_it_took():
    env, law = FuzzyArmEnv(reference=JointReference(duration=0.6)), load_policy("fuzzy-4")
    (observation, info), memory = env.reset(seed=0), np.full(law.memory_size, 1e-3)
    expected = law.predict(observation, memory)
    step = next(episodes(env, law, (observation, info), memory=memory))
    np.testing.assert_array_equal(step.info["torque"], expected[0])
    np.testing.assert_array_equal(step.memory, expected[1])
    assert 0.0 < step.seconds < 1.0
