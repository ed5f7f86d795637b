"""The three autoreset modes of the batch: each is that of Gymnasium's loop over single environments, bit for bit."""

import copy
import itertools
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as wrappers
from support import batches
from support.batches import LEAVING, LIMIT, LONGER, NOISY, SHORT, loop, torques
from support.randomisation import ROBUST
from support.results import assert_identical, identical

from fuzzyarm.envs.vector import FuzzyArmVectorEnv

LANES = 4
SETTINGS = {"short": {"reference": SHORT}, "robust": {"randomisation": ROBUST}}


def batch(mode, **arguments):
    return batches.batch(LANES, autoreset_mode=mode, **arguments)


def resting(envs, steps=50):
    return [envs.step(np.zeros((LANES, 2))) for _ in range(steps)][-1]


MODES = [*itertools.product(("Disabled", "NextStep"), SETTINGS), ("SameStep", "short")]


@pytest.mark.parametrize(("mode", "setting"), MODES)
def test_ends_masks_seeds_and_options_equal_gymnasiums_loop_in_every_mode(mode, setting):
    """Where a mode resets lanes by itself, every other end is left to it, and a lane is reset meanwhile."""
    arguments = {"disturbance": NOISY, **SETTINGS[setting]}
    envs, expected = batch(mode, **arguments), loop(LANES, mode, **arguments)
    generator, resets, ends = np.random.default_rng(0), 0, 0
    assert_identical(envs.reset(seed=3), expected.reset(seed=3))
    for step, action in enumerate(torques(6, 250, LANES, hold=100)):
        results = envs.step(action)
        assert_identical(results, expected.step(action), step)
        ended = results[2] | results[3]
        whole = ended.any() and (mode == "Disabled" or ends % 2)
        ends += int(ended.any())
        if ended.any() or step % 37 == 0:
            others = generator.random(LANES) < 0.2
            mask = ended | others if whole else np.arange(LANES) == step % LANES
            options = [{}, {"case": "payload"}, {"reference": LONGER}, {"initial_state": LEAVING}][resets % 4]
            seed = [None, 17, [None, 5, 6, None]][resets % 3]
            masks = {"reset_mask": mask} | options
            assert_identical(envs.reset(seed=seed, options=masks), expected.reset(seed=seed, options=dict(masks)), step)
            assert masks["reset_mask"] is mask  # the caller's options stay as they are
            resets += 1
    assert resets > 9 and ends > 3
    assert_identical(envs.reset(seed=4), expected.reset(seed=4))  # with lanes that wait
    if setting == "short":  # tables that no lane is in are dropped
        assert len(envs.lanes.table) <= (1 + LANES) * 102


def test_make_vec_gives_it_by_name_and_in_every_mode_the_default_being_same_step():
    for arguments in ({}, {"vectorization_mode": "vector_entry_point"}):
        envs = gym.make_vec("FuzzyArm-v0", **arguments)
        assert type(envs) is FuzzyArmVectorEnv and envs.num_envs == 1
    assert FuzzyArmVectorEnv(np.int64(2)).num_envs == 2
    assert envs.metadata == FuzzyArmVectorEnv.metadata
    assert envs.metadata == {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}
    with pytest.raises(NotImplementedError, match="render"):
        envs.render()
    assert batch("Disabled").metadata["autoreset_mode"] is AutoresetMode.DISABLED
    for again in (batch(AutoresetMode.NEXT_STEP), gym.make_vec(batch("NextStep").spec)):
        assert again.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP and again.num_envs == LANES
    with pytest.raises(gym.error.Error, match="only through kwargs"):  # as for every vector_entry_point
        gym.make_vec("FuzzyArm-v0", num_envs=2, vector_kwargs={"autoreset_mode": "NextStep"})


def test_disabled_refuses_a_mask_that_does_not_name_all_at_first_and_to_step_a_lane_that_is_over():
    envs, everywhere = batch("Disabled", reference=SHORT), {"reset_mask": np.ones(LANES, dtype=bool)}
    with pytest.raises(ResetNeeded, match="without a reset_mask first"):
        envs.reset(options={"reset_mask": np.arange(LANES) == 1})
    assert identical(envs.reset(seed=1, options=everywhere)[0], batch("Disabled", reference=SHORT).reset(seed=1)[0])
    envs.reset(seed=0, options={"initial_state": LEAVING})
    while not resting(envs, 1)[2].all():
        pass
    with pytest.raises(ResetNeeded, match=r"over in environments 0, 1, 2, 3: call envs\.reset\(options=\{'reset_mask'"):
        resting(envs, 1)
    envs.reset(options=everywhere)
    resting(envs, 1)


def test_next_step_ignores_whatever_the_action_of_an_ended_lane_is_and_refuses_others_without_moving():
    envs = batch("NextStep", reference=[SHORT, LONGER, LONGER, LONGER])
    envs.reset(seed=0)
    assert resting(envs)[3].tolist() == [True, False, False, False]
    twin = copy.deepcopy(envs)
    ignored, refused = np.zeros((LANES, 2)), np.zeros((LANES, 2))
    ignored[0], refused[1] = np.nan, np.inf
    with pytest.raises(ValueError, match=r"environment 1: action = .* is not finite"):
        envs.step(refused)
    results = envs.step(ignored)
    assert_identical(results, resting(twin, 1))
    assert results[-1]["time"][0] == 0.0 and results[1][0] == 0.0 and np.isnan(ignored[0]).all()


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_states_and_copies_remember_which_lanes_wait(mode):
    arguments = {"reference": [SHORT, LONGER, LONGER, SHORT], "disturbance": NOISY}
    envs = batch(mode, **arguments)
    envs.reset(seed=0)
    resting(envs)
    state, other = envs.get_state(), batch(mode, **arguments)
    other.set_state(state)
    twins, action = [other, copy.deepcopy(envs), pickle.loads(pickle.dumps(envs))], torques(0, 1, LANES)[0]

    def goes_on(made):
        if mode == "NextStep":
            return made.step(action), made.step(action)
        with pytest.raises(ResetNeeded, match="environments 0, 3"):
            made.step(action)
        return made.reset(options={"reset_mask": np.array([True, False, False, True])}), made.step(action)

    expected = goes_on(envs)
    assert all(identical(goes_on(twin), expected) for twin in twins)
    message = "are awaiting a reset, but this autoreset_mode resets at once; use the autoreset_mode with which"
    with pytest.raises(ValueError, match=message):
        batch("SameStep", **arguments).set_state(state)


WRAPPED = {
    "DictInfoToList": wrappers.DictInfoToList,
    "learning stack": lambda envs: wrappers.NormalizeReward(
        wrappers.NormalizeObservation(wrappers.RescaleAction(wrappers.RecordEpisodeStatistics(envs), -1, 1))
    ),
}


def without_clock(results):
    """The results without the seconds that RecordEpisodeStatistics measures."""
    info = results[-1]
    if isinstance(info, dict) and "episode" in info:
        info["episode"] = {name: value for name, value in info["episode"].items() if "t" not in name}
    return results


@pytest.mark.parametrize(("mode", "name"), [*(("NextStep", name) for name in WRAPPED), ("SameStep", "DictInfoToList")])
def test_wrappers_show_the_same_around_the_batch_and_around_the_loop(mode, name):
    arguments = {"disturbance": NOISY, "reference": SHORT}
    envs, expected = WRAPPED[name](batch(mode, **arguments)), WRAPPED[name](loop(LANES, mode, **arguments))
    assert identical(envs.reset(seed=0), expected.reset(seed=0))
    ends = 0
    for step, action in enumerate(torques(4, 170, LANES, hold=100) / LIMIT):
        scaled = action * envs.single_action_space.high
        results = without_clock(envs.step(scaled))
        assert identical(results, without_clock(expected.step(scaled))), step
        ends += int((results[2] | results[3]).sum())
    assert ends > LANES
