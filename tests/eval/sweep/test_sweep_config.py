import dataclasses
import json
import shlex

import pytest

from fuzzyarm.cli.application import command_line
from fuzzyarm.cli.sweep import _given
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.cases import CASES, case_for
from fuzzyarm.eval.sweep.config import Axis, SweepConfig
from fuzzyarm.eval.sweep.distributions import DISTRIBUTIONS, Distribution
from fuzzyarm.policies import ANY_ROBOT

GRID = (Axis("stiffness", 0.7, 1.3, 3), Axis("payload", 0.0, 5.0, 2))
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


def test_another_arm_survives_json_and_comes_from_a_file(tmp_path):
    config = SweepConfig(parameters=ArmParameters(mass=(14.0, 8.0)))
    assert SweepConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert config.command() is None  # no option says what is in a file
    (tmp_path / "arm.toml").write_text("mass = [14.0, 8.0]\n")
    assert parsed(["sweep", "--robot", str(tmp_path / "arm.toml")]) == config


def test_a_grid_alone_varies_nothing_else_and_has_one_plant_in_a_cell():
    config = parsed(["sweep", "--grid", "stiffness", "0.7", "1.3", "3", "--grid", "payload", "0", "5", "2"])
    assert (config.total, config.distribution, config.drawn()) == (6, "nominal", Distribution())


def test_what_a_grid_sets_is_not_drawn():
    drawn = SweepConfig(grid=GRID, distribution="loads").drawn()
    assert drawn.stiffness == (1.0, 1.0) and drawn.payload == (0.0, 0.0)
    assert drawn.mass == DISTRIBUTIONS["loads"].mass


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"policies": ("fuzzy-4", "fuzzy-4")}, "different"),
        ({"cases": ("nowhere",)}, "choose from: nominal, machining, payload"),
        ({"plants": 0}, "plants = 0"),
        ({"bound": float("nan")}, "bound = nan"),
        ({"distribution": "nominal"}, "repeat one and the same run"),
        ({"ranges": (("colour", 0.0, 1.0),)}, "choose from: mass, motor_inertia"),
        ({"ranges": (("mass", 1.2, 0.8),)}, "mass"),
        ({"ranges": (("delay", 0.5, 2.0),)}, "whole control periods"),
        ({"grid": (GRID[0], GRID[0])}, "two different quantities"),
        ({"grid": (GRID[0], Axis("payload", 5.0, 5.0, 2))}, "low must be below high"),
        ({"grid": (GRID[0], Axis("payload", 0.0, 5.0, 1))}, "= 1 is out of range; allowed: 2, 3"),
        ({"grid": (GRID[0], Axis("delay", 0.0, 2.0, 4))}, "no whole control periods"),
        ({"grid": GRID, "distribution": "nominal", "plants": 2}, "one and the same"),
        ({"grid": GRID, "map": ("mass_1", "mass_2")}, "a grid are over its own two"),
        ({"map": ("mass_1", "noise")}, "choose from: mass_1"),
        ({"map": ("mass_1",)}, "two different columns"),
        ({"parameters": {"mass": (14.0, 8.0)}}, "must be a fuzzyarm.envs.physics.parameters.ArmParameters"),
    ],
)
def test_bad_values_are_named_with_what_is_allowed(arguments, expected):
    with pytest.raises((TypeError, ValueError)) as caught:
        SweepConfig(**arguments)
    assert expected in str(caught.value)


def test_a_robot_has_columns_for_its_joints_and_payloads_of_its_case():
    """It comes back from its own document, and a shipped one has a command line."""
    robot = robot_named("planar-3r")
    config = SweepConfig.of({"robot": robot})
    assert config.policies == ANY_ROBOT and config.joints == 3
    assert len(config.drawn().varying(config.joints)) == 6 * 3 + 2
    assert config.drawn().payload == (0.0, case_for("payload", robot).disturbance.payload.mass)
    assert config.titles["payload"] == case_for("payload", robot).title != CASES["payload"].title
    assert SweepConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert "--robot planar-3r" in config.command()
    assert dataclasses.replace(config, robot=robot.with_payload(1.0)).command() is None
