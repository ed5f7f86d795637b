import argparse
import json

import numpy as np
import pytest

from fuzzyarm.eval.sweep.command import add_sweep_command, configured
from fuzzyarm.eval.sweep.config import COLUMNS, DISTRIBUTIONS, QUANTITIES, Axis, Distribution, SweepConfig, column_label

GRID = (Axis("stiffness", 0.7, 1.3, 3), Axis("payload", 0.0, 5.0, 2))
CONFIGS = [
    SweepConfig(),
    SweepConfig(policies=("fuzzy-4", "a folder/my own.json-tip"), cases=("payload",), plants=7, seed=3, bound=12.5),
    SweepConfig(distribution="all", ranges=(("payload", 0.1, 1 / 3),), map=("delay", "stiffness_2"), worst=0, chunk=9),
    SweepConfig(grid=GRID, distribution="plants", plants=4),
]


def parsed(words):
    parser = argparse.ArgumentParser()
    add_sweep_command(parser.add_subparsers())
    return configured(parser.parse_args(words))


@pytest.mark.parametrize("config", CONFIGS)
def test_a_configuration_survives_json_and_its_own_command_line(config):
    import shlex

    assert SweepConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert parsed(shlex.split(config.command())[1:]) == config


def test_a_grid_alone_varies_nothing_else_and_has_one_plant_in_a_cell():
    config = parsed(["sweep", "--grid", "stiffness", "0.7", "1.3", "3", "--grid", "payload", "0", "5", "2"])
    assert (config.total, config.distribution, config.drawn()) == (6, "nominal", Distribution())


def test_what_a_grid_sets_is_not_drawn():
    drawn = SweepConfig(grid=GRID, distribution="loads").drawn()
    assert drawn.stiffness == (1.0, 1.0) and drawn.payload == (0.0, 0.0)
    assert drawn.mass == DISTRIBUTIONS["loads"].mass


def test_the_members_of_the_chunks_are_all_plants_once():
    config = SweepConfig(plants=1003, chunk=100)
    assert [i for number in range(config.chunks) for i in config.members(number)] == list(range(1003))


def test_every_column_has_a_label_with_a_unit():
    for column in COLUMNS:
        assert column_label(column).endswith("]") and "[" in column_label(column)
    assert len(COLUMNS) == 6 * 2 + 4 and len(QUANTITIES) == 10
    assert np.all([len(DISTRIBUTIONS[name].varying) for name in ("plants", "loads", "all")] == np.array([12, 14, 16]))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"policies": ()}, "policies"),
        ({"policies": ("fuzzy-4", "fuzzy-4")}, "different"),
        ({"cases": ("nowhere",)}, "choose from: nominal, machining, payload"),
        ({"plants": 0}, "plants = 0"),
        ({"plants": True}, "plants = True"),
        ({"seed": -1}, "seed = -1"),
        ({"chunk": 0}, "chunk = 0"),
        ({"bound": 0.0}, "bound = 0.0"),
        ({"bound": float("nan")}, "bound = nan"),
        ({"distribution": "none"}, "choose from: nominal, plants, loads, all"),
        ({"distribution": "nominal"}, "repeat one and the same run"),
        ({"ranges": (("colour", 0.0, 1.0),)}, "choose from: mass, motor_inertia"),
        ({"ranges": (("mass", 1.2, 0.8),)}, "mass"),
        ({"ranges": (("delay", 0.5, 2.0),)}, "whole control periods"),
        ({"ranges": (("noise", -1.0, 2.0),)}, "noise"),
        ({"grid": GRID[:1]}, "two different quantities"),
        ({"grid": (GRID[0], GRID[0])}, "two different quantities"),
        ({"grid": (GRID[0], Axis("payload", 5.0, 0.0, 2))}, "payload"),
        ({"grid": (GRID[0], Axis("payload", 5.0, 5.0, 2))}, "low must be below high"),
        ({"grid": (GRID[0], Axis("payload", 0.0, 5.0, 1))}, "1 values"),
        ({"grid": (GRID[0], Axis("delay", 0.0, 2.0, 4))}, "no whole control periods"),
        ({"grid": GRID, "distribution": "nominal", "plants": 2}, "one and the same"),
        ({"grid": GRID, "map": ("mass_1", "mass_2")}, "a grid has its own two"),
        ({"map": ("mass_1", "noise")}, "choose from: mass_1"),
        ({"map": ("mass_1",)}, "two different columns"),
    ],
)
def test_bad_values_are_named_with_what_is_allowed(arguments, expected):
    with pytest.raises(ValueError, match=expected.replace("(", r"\(")):
        SweepConfig(**arguments)


@pytest.mark.parametrize("change", [{"more": 1}, {"grid": [[1]]}, {"plants": "3"}, {"ranges": [["mass"]]}])
def test_a_changed_document_is_refused(change):
    with pytest.raises(ValueError):
        SweepConfig.from_dict(SweepConfig().to_dict() | change)
