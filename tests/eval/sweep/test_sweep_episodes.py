"""The numbers of episodes against independent loops over the environments, and against each other."""

import copy
import dataclasses
import itertools
import json
import math
import re
import shlex
from unittest import mock

import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm import ArmParameters, Robot, SweepConfig, robot_named
from fuzzyarm.cli._application import command_line
from fuzzyarm.cli._commands.sweep import _given
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.cases import CASES, case_for
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.sweep._distributions import DISTRIBUTIONS, NOISE, Distribution, columns_of
from fuzzyarm.eval.sweep._episodes import SweepResults, replay, run_plants
from fuzzyarm.eval.sweep._plants import Plants
from fuzzyarm.fuzzy_policy.law import law_of
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.policies import ANY_ROBOT, load_policy

POLICIES = {name: load_policy(name) for name in ("fuzzy-4", "elastic-observer")}
CONFIG = SweepConfig(policies=tuple(POLICIES), plants=6, distribution="all", seed=40)


@pytest.fixture(scope="module")
def whole():
    return run_plants(CONFIG, POLICIES, range(6))


def tip_errors(env, policy, seed, delay=0, noise=1.0, most=math.inf):
    """Return the tip errors of (the first steps of) an episode of one environment, by a second, independent loop."""
    observation, info = env.reset(seed=seed)
    torques, state, errors, done = [], None, [], False
    while not done and len(errors) < most:
        true = np.concatenate([info["q_motor"], info["dq_motor"]])
        observation[:4] = true + noise * (observation[:4] - true)
        torque, state = policy.predict(observation, state)
        torques.append(torque)
        observation, _, terminated, truncated, info = env.step(torques[max(0, len(errors) - delay)])
        errors.append(info["tip_error"])
        done = terminated or truncated
    return np.array(errors), truncated


def check(found, place, errors, rel):
    assert found.metrics["max_mm"][place] == pytest.approx(1e3 * errors.max(), rel=rel)
    assert found.metrics["rms_mm"][place] == pytest.approx(1e3 * math.sqrt(np.mean(errors**2)), rel=rel)
    assert found.seconds[place] == pytest.approx(1e-3 * len(errors))


PLACES = [*itertools.product(("nominal", "machining"), (1, 4))]


@pytest.mark.parametrize("where", slow_but(PLACES[::3], PLACES), ids=str)
def test_the_numbers_are_those_of_single_environments(whole, where):
    plants = Plants(CONFIG, range(6), CONFIG.cases)
    case, i = where
    c = CONFIG.cases.index(case)
    noise, delay = plants.values["noise"][i], int(plants.values["delay"][i])
    noisy = Disturbance(tip_force=CASES[case].disturbance.tip_force, encoder_noise=NOISE)
    env = FuzzyArmEnv(disturbance=noisy, randomisation=DISTRIBUTIONS["all"])
    for p, policy in enumerate(POLICIES.values()):
        errors, completed = tip_errors(env, policy, 40 + i, delay, noise)
        check(whole, (p, c, i), errors, rel=1e-12)
        assert whole.metrics["max_mm"][p, c, i] == 1e3 * errors.max() and whole.completed[p, c, i] == completed


def test_noise_and_delay_cover_their_ranges_and_depend_on_nothing_else_drawn():
    plants = Plants(SweepConfig(plants=3000, distribution="all"), range(3000), ["nominal"])
    noise, delay = plants.values["noise"], plants.values["delay"]
    assert 0.0 <= noise.min() < 0.01 and 1.99 < noise.max() < 2.0
    assert noise.mean() == pytest.approx(1.0, abs=4 * 2 / math.sqrt(12 * 3000))
    counts = np.bincount(delay.astype(int))
    assert len(counts) == 3 and np.all(np.abs(counts - 1000) < 4 * math.sqrt(3000 * 2 / 9))
    for extra, name in itertools.product(("noise", "delay"), columns_of(2)):
        assert abs(np.corrcoef(plants.values[name], plants.values[extra])[0, 1]) < 0.09 or name == extra


def assert_equal(found, expected):
    for name, array in expected.arrays.items():
        np.testing.assert_array_equal(found.arrays[name], array, err_msg=name)


@pytest.mark.parametrize("size", slow_but([4], [1, 4]))
def test_no_number_depends_on_the_chunk_it_was_computed_in(whole, size):
    parts = [run_plants(CONFIG, POLICIES, range(6)[start : start + size]) for start in range(0, 6, size)]
    assert_equal(SweepResults.joined(parts), whole)


def test_a_replay_is_the_episode_of_the_sweep_bit_for_bit(whole):
    for p, policy in enumerate(POLICIES):
        run = replay(CONFIG, POLICIES, 3, policy, "machining")
        assert 1e3 * run.tip_error.max() == whole.metrics["max_mm"][p, 1, 3]
        assert 1e3 * np.sqrt(np.cumsum(run.tip_error**2)[-1] / len(run.time)) == whole.metrics["rms_mm"][p, 1, 3]
        assert run.completed == whole.completed[p, 1, 3] and run.seed == 43
        assert run.time[-1] == pytest.approx(1.5) and np.abs(run.external_force).max() > 50.0
        assert np.allclose(np.hypot(*(run.tip - run.tip_reference).T), run.tip_error)


@pytest.mark.parametrize(("member", "policy"), [(6, "fuzzy-4"), (-1, "fuzzy-4"), (0, "x")])
def test_what_is_not_in_the_sweep_is_not_replayed(member, policy):
    with pytest.raises(ValueError, match="not in the sweep"):
        replay(CONFIG, POLICIES, member, policy, "payload")


ONE = {"policies": ("fuzzy-4",), "distribution": "nominal", "plants": 1}


def test_an_episode_that_ends_early_counts_up_to_its_end():
    winding = copy.copy(POLICIES["fuzzy-4"])
    winding.integral_at = None  # not held at the torque limits: it loses a heavy payload on soft joints
    soft = SweepConfig(**ONE, cases=("payload",), grid=(("stiffness", 0.5, 1.0, 2), ("payload", 0.0, 15.0, 2)))
    found = run_plants(soft, {"fuzzy-4": winding}, range(4))
    ended = np.flatnonzero(~found.completed[0, 0])
    assert 0 < len(ended) < 4
    for i in ended.tolist():
        stiffness, payload = found.plants["stiffness_1"][i], found.plants["payload"][i]
        drawn = DomainRandomisation(stiffness=(stiffness,) * 2, payload=(payload,) * 2)
        errors, completed = tip_errors(FuzzyArmEnv("payload", randomisation=drawn), winding, 0)
        assert not completed and len(errors) < 1500
        check(found, (0, 0, i), errors, rel=1e-6)
        run = replay(soft, {"fuzzy-4": winding}, i, "fuzzy-4", "payload")
        assert not run.completed and "left the domain" in run.reason and len(run.time) == len(errors)
        assert 1e3 * run.tip_error.max() == found.metrics["max_mm"][0, 0, i]


def test_a_grid_sets_every_pair_of_values_once_for_each_of_its_plants():
    config = SweepConfig(grid=(("delay", 0, 3, 4), ("mass", 0.9, 1.1, 3)), distribution="loads", plants=2)
    plants = Plants(config, range(config.total), ["nominal"])
    pairs = np.stack([plants.values["delay"], plants.values["mass_1"]], axis=1)
    expected = [(delay, mass) for delay in range(4) for mass in (0.9, 1.0, 1.1) for _ in range(2)]
    assert np.allclose(pairs, expected)
    assert np.array_equal(plants.values["mass_1"], plants.values["mass_2"])
    assert len(np.unique(plants.values["payload"])) == config.total  # what is drawn differs everywhere


@pytest.mark.parametrize(
    ("grid", "exact"),
    [
        ((("stiffness", 0.8, 1.2, 2), ("mass", 0.9, 1.1, 2)), True),
        ((("dry_friction", 0.0, 1.5, 2), ("damping", 0.5, 1.5, 2)), True),
        ((("motor_inertia", 0.9, 1.1, 2), ("viscous_friction", 0.5, 1.5, 2)), True),
        ((("payload", 1.0, 5.0, 2), ("force", 0.5, 1.5, 2)), False),  # the order of a sum differs
    ],
)
def test_a_grid_sets_what_the_environment_would_draw_from_a_range_of_one_point(grid, exact, short):
    config, policy = SweepConfig(**ONE, cases=("machining",), grid=grid), POLICIES["fuzzy-4"]
    found = run_plants(config, {"fuzzy-4": policy}, range(4)).metrics["max_mm"][0, 0]
    for i, values in enumerate(itertools.product(*(axis.values.tolist() for axis in config.grid))):
        drawn = DomainRandomisation(**{axis[0]: (value, value) for axis, value in zip(grid, values, strict=True)})
        errors, _ = tip_errors(FuzzyArmEnv("machining", randomisation=drawn), policy, 0, most=short)
        assert found[i] == (1e3 * errors.max() if exact else pytest.approx(1e3 * errors.max(), rel=1e-9))


def test_plants_are_drawn_around_the_robot(short):
    arm = ArmParameters(length=(0.45, 0.55), mass_center=(0.22, 0.27), stiffness=(5e4, 1e4))
    given = {"policies": ("computed-torque",), "cases": ("machining",), "distribution": "plants", "parameters": arm}
    law, reference = load_policy("computed-torque", robot=arm), JointReference(parameters=arm)
    found = run_plants(SweepConfig(**given, plants=2), {"computed-torque": law}, range(2)).metrics["max_mm"][0, 0]
    load = case_for("machining", arm).disturbance
    env = FuzzyArmEnv(disturbance=load, parameters=arm, reference=reference, randomisation=DISTRIBUTIONS["plants"])
    assert found.tolist() == [1e3 * tip_errors(env, law, i, most=short)[0].max() for i in range(2)]


def test_a_policy_that_fails_is_named():
    failing = mock.Mock(spec=["predict"], predict=mock.Mock(side_effect=ValueError("out of ideas")))
    with pytest.raises(ValueError, match="policy mine, plants 2 to 3: out of ideas"):
        run_plants(CONFIG, {"mine": failing}, range(2, 4))


@pytest.mark.slow
@pytest.mark.parametrize("grid", [(), (("mass", 0.8, 1.2, 2), ("stiffness", 0.9, 1.1, 2))])
def test_the_two_joint_arm_as_a_robot_has_the_errors_of_the_two_joint_arm(grid):
    """Equal draws, loads, noise and delay; the equations of motion and the reference are generated."""
    plants = {"grid": grid, "distribution": "nominal", "plants": 1} if grid else {"distribution": "all", "plants": 3}
    arm, robot = ArmParameters(), Robot.of(ArmParameters())
    found = []
    for given, one in (({"parameters": arm}, arm), ({"robot": robot}, robot)):
        config = SweepConfig(policies=("computed-torque",), cases=("nominal", "payload"), **plants, **given)
        policies = {"computed-torque": load_policy("computed-torque", robot=one)}
        found.append(run_plants(config, policies, range(config.total)))
    expected, result = found
    np.testing.assert_array_equal(result.plants, expected.plants, strict=True)
    for name in ("max_mm", "rms_mm"):
        np.testing.assert_allclose(result.metrics[name], expected.metrics[name], rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["fuzzy-4", "fuzzy-1-tip", "computed-torque", "computed-torque-tip", "elastic-observer"]
)
@pytest.mark.parametrize("distribution", ["loads", "all"])
def test_a_kernel_of_law_and_plant_has_the_bits_of_the_loop(name, distribution, monkeypatch):
    # 65 plants in three cases are more than one group of lanes, and no whole number of blocks; some end early.
    given = {"policies": (name,), "distribution": distribution}
    heavy = SweepConfig(**given, plants=40, ranges=(("payload", 0.0, 60.0),), cases=("machining",))
    for config in (SweepConfig(**given, plants=65, seed=3), heavy):
        results = []
        for threshold in (1, 10**9):
            monkeypatch.setattr("fuzzyarm.eval.sweep._episodes._WORTHWHILE", threshold)
            results.append(run_plants(config, {name: load_policy(name)}, config.members(0)))
        assert_equal(*results)


def test_a_law_that_a_subclass_changes_is_not_compiled():
    class Gentle(FuzzyPolicy):
        def act(self, observation, memory, torque):
            super().act(observation, memory, torque)
            torque *= 0.5

    policy = load_policy("fuzzy-4")
    assert law_of(policy).memory == (0.0, 0.0)
    assert law_of(Gentle(policy.controller)) is None
    assert law_of(load_policy("ppo-robust")) is not None


GRID = (("stiffness", 0.7, 1.3, 3), ("payload", 0.0, 5.0, 2))
CONFIGS = [
    SweepConfig(),
    SweepConfig(policies=("fuzzy-4", "a folder/my own.json-tip"), cases=("payload",), plants=7, seed=3, bound=12.5),
    SweepConfig(distribution="all", ranges=(("payload", 0.1, 1 / 3),), map=("delay", "stiffness_2"), worst=0, chunk=9),
    SweepConfig(grid=GRID, distribution="plants", plants=4),
]


def parsed(words):
    command, bound, _ = command_line(words).parse_args(words)
    return SweepConfig.of(_given(command(*bound.args, **bound.kwargs)))


@pytest.mark.parametrize("config", CONFIGS)
def test_a_configuration_survives_json_and_its_own_command_line(config):
    assert SweepConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert parsed(shlex.split(config.command())[1:]) == config


def test_another_arm_comes_from_a_file_whose_content_no_option_holds(tmp_path):
    (tmp_path / "arm.toml").write_text("mass = [14.0, 8.0]\n")
    config = parsed(["sweep", "--robot", str(tmp_path / "arm.toml")])
    assert config == SweepConfig(parameters=ArmParameters(mass=(14.0, 8.0))) and config.command() is None


def test_a_grid_alone_varies_nothing_else_and_has_one_plant_in_a_cell():
    config = parsed(["sweep", "--grid", "stiffness", "0.7", "1.3", "3", "--grid", "payload", "0", "5", "2"])
    assert (config.total, config.distribution, config.drawn()) == (6, "nominal", Distribution())
    drawn = SweepConfig(grid=GRID, distribution="loads").drawn()  # what the grid sets is not drawn
    assert drawn.stiffness == (1.0, 1.0) and drawn.payload == (0.0, 0.0)
    assert drawn.mass == DISTRIBUTIONS["loads"].mass


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"policies": ("fuzzy-4", "fuzzy-4")}, "distinct"),
        ({"cases": ("nowhere",)}, "choose from: nominal, machining, payload"),
        ({"plants": 0}, "plants = 0"),
        ({"bound": float("nan")}, "bound = nan"),
        ({"distribution": "nominal"}, "would repeat one run"),
        ({"ranges": (("colour", 0.0, 1.0),)}, "choose from: mass, motor_inertia"),
        ({"ranges": (("mass", 1.2, 0.8),)}, "mass"),
        ({"ranges": (("delay", 0.5, 2.0),)}, "whole numbers of control periods"),
        ({"grid": (GRID[0], GRID[0])}, "two different quantities"),
        ({"grid": (GRID[0], ("payload", 5.0, 5.0, 2))}, "low must be below high"),
        ({"grid": (GRID[0], ("payload", 0.0, 5.0, 1))}, "= 1 is out of range; allowed: 2, 3"),
        ({"grid": (GRID[0], ("delay", 0.0, 2.0, 4))}, "must be whole numbers of control periods"),
        ({"grid": GRID, "distribution": "nominal", "plants": 2}, "would repeat one run"),
        ({"grid": GRID, "map": ("mass_1", "mass_2")}, "cannot be combined with a grid, whose two"),
        ({"map": ("mass_1", "noise")}, "choose from: mass_1"),
        ({"map": ("mass_1",)}, "two different columns"),
    ],
)
def test_bad_values_are_named_with_what_is_allowed(arguments, expected):
    with pytest.raises((TypeError, ValueError), match=re.escape(expected)):
        SweepConfig(**arguments)


def test_a_robot_has_columns_for_its_joints_and_payloads_of_its_case():
    robot = robot_named("planar-3r")
    config = SweepConfig.of({"robot": robot})
    assert config.policies == ANY_ROBOT and config.joints == 3
    assert len(config.drawn().varying(config.joints)) == 6 * 3 + 2
    assert config.drawn().payload == (0.0, case_for("payload", robot).disturbance.payload.mass)
    assert config.titles["payload"] == case_for("payload", robot).title != CASES["payload"].title
    assert SweepConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert "--robot planar-3r" in config.command()
    assert dataclasses.replace(config, robot=robot.with_payload(1.0)).command() is None
