"""A state of a batch is taken as a whole or refused as a whole; nothing that kernels index by is taken unchecked."""

import numpy as np
import pytest
from support.randomisation import ROBUST
from support.two_joints import LAYOUT

from fuzzyarm.envs.batch.layout import CLOCK
from fuzzyarm.envs.physics.records import columns
from fuzzyarm.envs.vector import FuzzyArmVectorEnv

LANES = 3


@pytest.fixture
def envs():
    envs = FuzzyArmVectorEnv(LANES, randomisation=ROBUST)
    envs.reset(seed=5)
    for _ in range(20):
        envs.step(np.full((LANES, 2), 30.0))
    return envs


def changed(name, place, value):
    def change(state):
        state[name][place] = value

    return change


BAD = [
    (changed("clock", (CLOCK.row, 1), 10**12), r"environment 1 is at row 1000000000000 of"),
    (changed("clock", (CLOCK.row, 0), -1), "environment 0 is at row -1 of"),
    (lambda state: state["clock"].__setitem__(CLOCK.row, state["clock"][CLOCK.last]), "at row [0-9]+ of"),
    (changed("clock", (CLOCK.first, 0), 1), "environment 0 is at row"),
    (changed("clock", (CLOCK.last, 2), 10**9), "environment 2 is at row"),
    (changed("clock", (CLOCK.key, 0), 7), "state"),
    (changed("drawn", (0, 0), 0.5), "does not match the random keys"),
    (changed("drawn", (-1, 0), 1e12), "does not match the random keys"),
    (changed("drawn", (-1, 0), np.nan), "not finite"),
    (changed("values", (0, 0), np.nan), "not finite"),
    (changed("values", (12, 0), 1.0), "does not match the random keys"),
    (lambda state: state.update(values=state["values"][:, :1]), "must be an array of float64"),
    (lambda state: state.update(clock=state["clock"].astype(float)), "must be an array of int64"),
    (lambda state: state.update(values=state["values"].astype(">f8")), "must be an array of float64"),
    (lambda state: state.update(drawn=state["drawn"].tolist()), "must be an array of float64"),
    (lambda state: state.pop("clock"), r"state\['clock'\] is None"),
    (lambda state: state.pop("made_of"), "other plants"),
    (lambda state: state.update(made_of=np.zeros(32, dtype=np.uint8)), "other plants"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_a_bad_state_is_refused_and_changes_nothing(envs, change, message):
    before, state = envs.get_state(), envs.get_state()
    change(state)
    with pytest.raises(ValueError, match=message):
        envs.set_state(state)
    with pytest.raises(TypeError, match="state = "):
        envs.set_state([state])
    assert all(np.array_equal(before[key], value) for key, value in envs.get_state().items())
    action = np.full((LANES, 2), -20.0)
    expected = envs.step(action)[0]
    envs.set_state(before)
    assert np.array_equal(envs.step(action)[0], expected)


def test_random_changes_are_refused_or_harmless(envs):
    tries, generator = 100, np.random.default_rng(0)
    good = envs.get_state()
    own_state = columns(LAYOUT.Lane).state
    refused = 0
    for _ in range(tries):
        state = {name: array.copy() for name, array in good.items()}
        name = generator.choice(["values", "clock", "drawn"])
        flat = state[name].reshape(-1).view(np.uint8)
        for place in generator.integers(0, len(flat), generator.integers(1, 4)):
            flat[place] ^= np.uint8(1 << generator.integers(8))
        try:
            envs.set_state(state)
        except ValueError:
            refused += 1
            continue
        same = [np.array_equal(state[key], good[key]) for key in ("clock", "drawn")]
        assert np.array_equal(state["values"][own_state.stop :], good["values"][own_state.stop :])
        assert all(same) or np.array_equal(state["clock"][CLOCK.first], good["clock"][CLOCK.first])
        for _ in range(3):
            envs.step(np.zeros((LANES, 2)))
    assert refused > tries / 2
