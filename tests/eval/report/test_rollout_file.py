"""Rollouts on disk: bit for bit, tied to their results, and nothing is executed."""

import dataclasses

import numpy as np
import pytest

from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.episodes.rollout_file import digest, read_rollouts, write_rollouts

FIELDS = [field.name for field in dataclasses.fields(Rollout)]


def test_a_round_trip_keeps_every_bit(evaluation, tmp_path):
    again = read_rollouts(write_rollouts(evaluation.rollouts, tmp_path))
    for before, after in zip(evaluation.rollouts, again, strict=True):
        for name in FIELDS:
            assert np.array_equal(getattr(before, name), getattr(after, name)), name
            assert type(getattr(before, name)) is type(getattr(after, name)), name
    assert digest(again) == digest(evaluation.rollouts)


def test_the_digest_sees_a_change_in_any_field(evaluation):
    run = evaluation.rollouts[0]
    for name in FIELDS:
        value = getattr(run, name)
        if isinstance(value, np.ndarray):
            value = value.copy() if value.size else np.zeros((1, 1))  # beliefs, of a policy that says nothing
            value.flat[-1] = np.nextafter(value.flat[-1], np.inf)
        else:
            value = {str: "other", bool: False, int: 1, float: 0.5, tuple: ("payload",)}[type(value)]
        assert digest([dataclasses.replace(run, **{name: value})]) != digest([run]), name


def test_nothing_is_unpickled(tmp_path, capsys):
    class Loud:
        def __reduce__(self):
            return print, ("executed",)

    path = tmp_path / "rollouts.npz"
    np.savez(path, **{"0.policy": np.array(Loud(), dtype=object)})
    with pytest.raises(ValueError, match="is damaged"):
        read_rollouts(path)
    assert "executed" not in capsys.readouterr().out


@pytest.mark.parametrize("number", [1e300, -1e61, np.nan, np.inf])
def test_a_number_whose_square_is_none_is_told(evaluation, tmp_path, number):
    run = evaluation.rollouts[0]
    position = run.q_motor.copy()
    position[3, 1] = number
    path = write_rollouts([dataclasses.replace(run, q_motor=position)], tmp_path)
    with pytest.raises(ValueError, match=r"rollouts\.npz is damaged \(q_motor is not finite, or beyond 1e\+60\)"):
        read_rollouts(path)


def test_a_damaged_file_is_told(evaluation, tmp_path):
    path = write_rollouts(evaluation.rollouts[:1], tmp_path)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    for damaged in (b"", b"no zip", path.read_bytes()[:-200], content):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"rollouts\.npz is damaged"):
            read_rollouts(path)
