"""The configuration is the command line: every field a flag, every bad value one line."""

import argparse
import dataclasses
import math

import pytest

from fuzzyarm.cli import main
from fuzzyarm.rl_baselines.ppo_config import PRESETS, PPOConfig, add_run_flags, chosen_run

FIELDS = {field.name: field for field in dataclasses.fields(PPOConfig)}


def chosen(*flags):
    """What a command line asks for."""
    parser = argparse.ArgumentParser()
    add_run_flags(parser)
    return chosen_run(parser.parse_args([*map(str, flags), "--out", "here"]))[0]


def texts(value):
    """A value as words of a command line."""
    return [str(one) for one in (value if isinstance(value, tuple) else (value,))]


def other(field):
    """A value of a field that is not its default."""
    value = field.default
    if field.metadata["choices"]:
        return next(choice for choice in field.metadata["choices"] if choice != value)
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return "fuzzy-4"
    return tuple(2 * one for one in value) if isinstance(value, tuple) else value + 1 if value == 0 else value / 2


def test_without_flags_it_is_the_nominal_preset():
    assert chosen() == PRESETS["nominal"] == PPOConfig()
    assert {name: chosen("--preset", name) for name in PRESETS} == PRESETS


@pytest.mark.parametrize("name", FIELDS)
def test_every_field_is_a_flag_with_help(name, capsys):
    field, value = FIELDS[name], other(FIELDS[name])
    if isinstance(field.default, int) and not isinstance(field.default, bool):
        value = field.default * 2 or 1
    flag = f"--{name.replace('_', '-')}"
    words = [flag, *texts(value)] if not isinstance(value, bool) else [flag if value else f"--no-{flag[2:]}"]
    more = {} if name == "seed" else {"seed": 5}
    if name == "base":  # actions are angles then
        more["scale"] = (0.01, 0.02)
    for other_name, other_value in more.items():
        words += [f"--{other_name}", *texts(other_value)]
    assert chosen(*words) == dataclasses.replace(PPOConfig(), **{name: value} | more)
    with pytest.raises(SystemExit):
        chosen("--help")
    assert flag in capsys.readouterr().out and len(field.metadata["help"]) > 10


@pytest.mark.parametrize("config", PRESETS.values(), ids=PRESETS)
def test_a_configuration_survives_json(config):
    assert PPOConfig.from_dict(config.to_dict()) == config
    with pytest.raises(ValueError, match="misses or adds: lanes"):
        PPOConfig.from_dict({name: value for name, value in config.to_dict().items() if name != "lanes"})


BAD = {
    "--steps 4.5": r"--steps 4.5 must be a whole number; allowed: \[1, inf\)",
    "--lanes -1": r"--lanes -1 is out of range; allowed: \[1, 65536\]",
    "--lanes many": "--lanes many must be a whole number",
    "--gamma nan": r"--gamma nan is out of range; allowed: \[0, 1\]",
    "--learning-rate 0": r"--learning-rate 0.0 is out of range; allowed: \(0, inf\)",
    "--final-learning-rate 1": r"--final-learning-rate 1 is out of range; allowed: \[0, --learning-rate = 0.001\]",
    "--batch-size 100": "--batch-size 100 must divide --lanes times --rollout = 4096",
    "--scale 1 0": r"--scale 0.0 is out of range; allowed: \(0, inf\)",
    "--scale x 0": r"--scale x 0 must be a number; allowed: \(0, inf\)",
    "--hidden 64 0": "--hidden 0 is out of range",
    "--distribution other": "--distribution other is unknown; choose from: nominal, robust",
    "--preset other": "--preset other is unknown; choose from: nominal, robust, residual",
    "--action-period 1": r"--action-period 1.0 is out of range; allowed: \(0, 0.1\] s",
    "--base fuzzy-4": r"--scale 400 180 is out of range; allowed with a --base: \(0, 0.5\] rad",
    "--base fuzzy-5 --scale 0.1 0.1": "unknown policy 'fuzzy-5'",
    "--action-period 0.0015": "which is no whole multiple of control_period",
    "--resume --lanes 32 --preset robust": "--resume goes on as the run was configured; leave out --preset, --lanes",
    "--resume": "there is nothing to resume here",
}


@pytest.mark.parametrize(("flags", "message"), BAD.items(), ids=BAD)
def test_a_bad_value_is_one_line_and_exit_code_2(flags, message, tmp_path, capsys):
    import re

    assert main(["train", "ppo", *flags.split(), "--out", str(tmp_path / "run")]) == 2
    shown = capsys.readouterr()
    lines = [line for line in shown.err.splitlines() if line]
    assert not shown.out and len(lines) == 1
    assert re.search(f"^fuzzyarm train: .*{message}", lines[0])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"lanes": True}, "--lanes True is out of range"),
        ({"lanes": 8.0}, "--lanes 8.0 is out of range"),
        ({"scale": (1.0,)}, "must be a tuple of numbers"),
        ({"hidden": [8]}, "must be a tuple of numbers"),
        ({"base": ""}, "must be of type str"),
        ({"tensorboard": 1}, "must be of type bool"),
        ({"integral_time": math.inf}, "out of range"),
    ],
)
def test_a_wrong_type_is_refused_in_python_too(values, message):
    with pytest.raises(ValueError, match=message):
        PPOConfig(**values)
