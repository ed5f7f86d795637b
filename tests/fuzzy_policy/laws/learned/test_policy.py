"""A learned policy in use: the protocol of every policy, the hold, the base, and the robot that it is for."""

import dataclasses
import math

import gymnasium as gym
import numpy as np
import pytest
from support.bundles import bundle, robot_bundle
from support.policies import answers

from fuzzyarm import ArmParameters, MarginsConfig, Robot, load_policy, measure_margins, robot_named, run_episode
from fuzzyarm.envs.scenario.paths import Line
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.stability._linearisation import largest_radius, linearise_path
from fuzzyarm.eval.stability.margins import margin_notes
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy


def observations(calls):
    """Ten numbers (calls, 64, 10) of any kind."""
    return 0.3 * np.random.default_rng(0).normal(size=(calls, 64, 10))


def torques(policy, shown):
    return answers(policy, shown)[0]


def test_an_action_is_held_and_what_is_seen_between_does_not_matter():
    shown = observations(12)
    made = bundle(ActionDefinition(period=4e-3))
    every, fourth = torques(LearnedPolicy(made, 1e-3), shown), torques(LearnedPolicy(made, 4e-3), shown[::4])
    assert np.array_equal(every, np.repeat(fourth, 4, axis=0))
    assert not np.array_equal(fourth[0], fourth[1])


def test_the_base_is_evaluated_at_every_call_and_told_that_the_motors_stand_elsewhere():
    envs = gym.make_vec("FuzzyArm-v0", num_envs=4, randomisation="plants")
    shown, _ = envs.reset(seed=0)
    shown = np.array([shown + 1e-4 * k for k in range(6)])
    scale = (0.001, 0.002)
    shift = torques(LearnedPolicy(bundle(ActionDefinition(scale))), shown)  # the same network, as if it were a torque
    shifted = shown.copy()
    shifted[..., :2] -= shift
    base, alone = load_policy("fuzzy-4-tip", allow_unproven=True), torques(load_policy("fuzzy-4-tip"), shown)
    both = torques(LearnedPolicy(bundle(ActionDefinition(scale, base="fuzzy-4-tip")), base=base), shown)
    np.testing.assert_array_equal(both, torques(base, shifted))
    assert np.array_equal(shift[0], shift[1]) and not np.array_equal(both[0], both[1])
    assert np.abs(both - alone).min() > 1e-3


def test_a_shifted_base_brings_the_motors_to_its_target_plus_the_shift():
    """At rest, by the base's integral: no correction of torques could do that."""
    constant = silent(bundle(ActionDefinition((0.004, 0.006), base="fuzzy-4")), 0.5, -0.5)
    policy = LearnedPolicy(constant, base=load_policy("fuzzy-4"))
    run = run_episode(policy, reference=JointReference(Line((0.4, 0.5), (0.4, 0.501)), duration=3.0))
    assert run.completed
    np.testing.assert_allclose((run.q_motor - run.q_reference)[-1], [0.002, -0.003], atol=2e-5)


def test_a_smoothed_action_is_a_first_order_lag_of_what_the_network_says():
    shown = observations(9)
    shown[..., :4] = shown[..., 4:8]  # no error, and no memory: the network sees the reference alone
    memoryless = {"past_errors": 0, "past_actions": 0, "integral_time": 0.0}
    told, smoothed = (
        torques(LearnedPolicy(bundle(ActionDefinition((3.0, 2.0), 1e-3, smoothing_time=time), **memoryless)), shown)
        for time in (0.0, 4e-3)
    )
    expected, keep = 0.0, math.exp(-0.25)
    for said, answer in zip(told, smoothed, strict=True):
        expected = keep * expected + (1.0 - keep) * said
        np.testing.assert_allclose(answer, expected, rtol=1e-12, atol=1e-15)


def test_periods_and_bases_that_do_not_fit_are_named():
    residual, base = bundle(ActionDefinition((0.01, 0.01), base="fuzzy-4")), load_policy("fuzzy-4", allow_unproven=True)
    for made, period, given, message in (
        (bundle(), 1.5e-3, None, "acts every 0.002 s.* = 0.0015 s; allowed control periods: 0.002 s divided"),
        (bundle(), 4e-3, None, "control_period = 0.004 s"),
        (residual, 1e-3, None, "base = none is not the base .* trained: fuzzy-4"),
        (bundle(), 1e-3, base, "base = FuzzyPolicy is not the base .* trained: None"),
        (residual, 2e-3, base, "control_period = 0.001 s; needed: 0.002 s"),
    ):
        with pytest.raises(ValueError, match=message):
            LearnedPolicy(made, period, base=given)


@pytest.mark.parametrize("action", [ActionDefinition(), ActionDefinition((0.02, 0.01), base="fuzzy-4-tip")], ids=str)
def test_a_folder_is_the_policy_it_holds_and_its_base_comes_with_it(tmp_path, action):
    mine, shown = bundle(action), observations(6)
    mine.save(tmp_path / "mine")
    expected = torques(LearnedPolicy(mine, base=load_policy(action.base) if action.base else None), shown)
    for name in (tmp_path / "mine", str(tmp_path / "mine")):
        np.testing.assert_array_equal(torques(load_policy(name), shown), expected)
    bundle(ActionDefinition((0.01, 0.01), base="/somewhere/else.json")).save(tmp_path / "strange")
    with pytest.raises(ValueError, match="which is unknown; known: fuzzy-32"):
        load_policy(tmp_path / "strange")
    with pytest.raises(ValueError, match=r"is not a policy folder: it contains neither policy\.json nor weights"):
        load_policy(tmp_path)


def silent(made, *answer):
    """The bundle with a network that always gives the same answer."""
    network = dataclasses.replace(made.network, weights=tuple(map(np.zeros_like, made.network.weights)))
    for bias in network.biases:
        bias[:] = 0.0
    network.biases[-1][:] = answer
    return dataclasses.replace(made, network=network)


def test_margins_are_taken_over_the_action_period(tmp_path, few_postures):
    """A network that always answers zero leaves the base alone, at the period of the network."""
    silent(bundle(ActionDefinition((0.02, 0.01), base="fuzzy-4", period=2e-3)), 0.0, 0.0).save(tmp_path / "silent")
    document = measure_margins(MarginsConfig((str(tmp_path / "silent"), "fuzzy-4")))
    row, other = document["rows"]
    loops = linearise_path(load_policy("fuzzy-4", control_period=2e-3), ArmParameters(), 2e-3)
    expected = largest_radius(loops, delay=1.0)
    assert row["control_period"] == 2e-3 and other["control_period"] == 1e-3
    assert row["spectral_radius"]["one sample later"] == pytest.approx(expected, rel=1e-9)
    assert "silent acts every 2 ms" in " ".join(margin_notes(document))


ROBOT, OTHER_ARM = robot_named("planar-3r"), ArmParameters(mass=(20.0, 10.0))


def test_a_bundle_is_for_its_arm_alone(tmp_path):
    mine = tmp_path / "mine" / "policy"  # as fuzzyarm train names it
    mine.parent.mkdir()
    robot_bundle(ROBOT).save(mine)
    policy = load_policy(mine, robot=dataclasses.replace(ROBOT, name="the same numbers"))
    torque, _ = policy.predict(np.random.default_rng(0).normal(size=(7, 15)))
    assert torque.shape == (7, 3) and (np.abs(torque) <= [10.0, 11.0, 12.0]).all()
    robot_bundle(ROBOT, "\x1b[31mred\nline").save(tmp_path / "red")
    robot_bundle(Robot.of(OTHER_ARM)).save(tmp_path / "other")
    assert load_policy(tmp_path / "other", robot=OTHER_ARM).parameters == OTHER_ARM
    for policy, robot, message in (
        (mine, "ur5", r"^mine was trained on planar-3r and works only on it"),
        (mine, "paper", r"^mine was trained on planar-3r and works only on it"),
        (mine, dataclasses.replace(ROBOT, gravity=(9.8, 0.0, 0.0)), "^mine was trained on planar-3r"),
        (tmp_path / "red", "ur5", r"red was trained on \\x1b"),
        (tmp_path / "other", None, "other was trained on two-joint arm"),
        ("ppo-nominal", "ur5", "ppo-nominal was trained on the arm of Table 1"),
    ):
        with pytest.raises(ValueError, match=message) as refused:
            load_policy(policy, robot=robot)
        assert "\n" not in str(refused.value)
