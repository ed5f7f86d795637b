"""The adapter for stable-baselines3 gives the same results as its loop over monitored single environments."""

import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RescaleAction
from slow_twins import slow_but
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecCheckNan, VecFrameStack, VecNormalize
from support.batches import torques
from support.results import identical

from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.paths import Lemniscate, Line
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.task import Termination
from fuzzyarm.rl_baselines.sb3_vec_env import StableBaselinesVecEnv

NOISY = Disturbance(encoder_noise=EncoderNoise(position=1e-5, velocity=1e-3))
SHORT = JointReference(path=Line((0.4, 0.5), (0.42, 0.5)), duration=0.05)  # 50 steps
LONGER = JointReference(path=Lemniscate((0.4, 0.5), 0.05), duration=0.4)
STILL = np.array([0.5, 0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0])
LANES = 4


def adapted(lanes=LANES, rescaled=False, **arguments):
    envs = gym.make_vec("FuzzyArm-v0", num_envs=lanes, **arguments)
    return StableBaselinesVecEnv(RescaleAction(envs, -1, 1) if rescaled else envs)


def monitored(lanes=LANES, rescaled=False, **arguments):
    """What it must equal: stable-baselines3's own loop."""

    def make():
        env = gym.make("FuzzyArm-v0", **arguments)
        return Monitor(gym.wrappers.RescaleAction(env, -1, 1) if rescaled else env)

    return DummyVecEnv([make] * lanes)


def both(wrap=lambda venv: venv, **arguments):
    """The adapter and the loop with the same seeds, reset."""
    pair = wrap(adapted(**arguments)), wrap(monitored(**arguments))
    for venv in pair:
        venv.seed(3)
    assert identical(*(venv.reset() for venv in pair))
    return pair


def assert_same_step(results, others):
    """Compare what two environments return; return why the lanes that ended did."""
    assert identical(results[:3], others[:3])
    ends = []
    for lane, (info, expected) in enumerate(zip(results[3], others[3], strict=True)):
        if not results[2][lane]:
            assert info == {}
            continue
        ends.append(expected.get("reason", "truncated"))
        assert identical(info["terminal_observation"], expected["terminal_observation"])
        assert info["TimeLimit.truncated"] is bool(expected["TimeLimit.truncated"])
        assert info.get("reason") == expected.get("reason")
        assert info["episode"]["l"] == expected["episode"]["l"]
        assert info["episode"]["r"] == pytest.approx(expected["episode"]["r"], rel=1e-6, abs=2e-6)
        assert info["episode"]["t"] > 0.0
    return ends


def wrapped(venv):
    return VecNormalize(VecFrameStack(VecCheckNan(venv), 2))


TRUNCATED, TERMINATED = {"truncated"}, {reason.text for reason in Termination if reason}
SETTINGS = {
    "wrapped": ({"wrap": wrapped, "disturbance": NOISY, "reference": SHORT}, [TRUNCATED]),
    "machining": ({"case": "machining", "reference": LONGER}, [TRUNCATED, TERMINATED]),
    "robust": ({"disturbance": NOISY, "randomisation": "robust"}, [TERMINATED]),
    "rescaled": ({"rescaled": True, "reference": LONGER}, [TRUNCATED, TERMINATED]),
}


@pytest.mark.parametrize("name", slow_but(["wrapped", "robust", "rescaled"], SETTINGS))
def test_it_equals_the_loop_over_monitored_single_environments(name):
    arguments, kinds = SETTINGS[name]
    venv, loop = both(**arguments)
    assert (venv.observation_space, venv.action_space) == (loop.observation_space, loop.action_space)
    ends = []
    for action in torques(0, 450, LANES):
        action[:2] *= 0.1
        scaled = (action / [500.0, 250.0]).astype(np.float32) if "rescaled" in arguments else action
        ends += assert_same_step(venv.step(scaled), loop.step(scaled))
    assert all(kind & set(ends) for kind in kinds)


def test_python_does_for_a_step_of_many_lanes_what_it_does_for_two():
    def instructions(lanes):
        venv, action, count = adapted(lanes, randomisation="plants"), np.zeros((lanes, 2)), 0

        def trace(frame, event, _):
            nonlocal count
            frame.f_trace_opcodes = True
            count += event == "opcode"
            return trace

        venv.reset()
        venv.step(action)
        before = sys.gettrace()
        sys.settrace(trace)
        try:
            venv.step(action)
        finally:
            sys.settrace(before)
        return count

    assert 0 < instructions(2) == instructions(500)


def test_an_episode_tells_its_mean_tip_error():
    venv, errors = adapted(2, reference=SHORT), []
    venv.seed(0)
    venv.reset()
    for action in torques(0, 50, 2):
        *_, infos = venv.step(0.1 * action)
        final = venv.vector_info.get("final_info", venv.vector_info)
        errors.append(final["tip_error"])
    for told, expected in zip(infos, np.mean(errors, axis=0), strict=True):
        assert told["episode"]["tip_error"] == pytest.approx(expected, rel=1e-12)


def test_an_environment_that_resets_itself_a_step_later_is_refused_and_any_other_is_taken():
    later = gym.make_vec("FuzzyArm-v0", num_envs=2, vectorization_mode="sync")
    with pytest.raises(ValueError, match=r"NEXT_STEP; stable-baselines3 needs .*SAME_STEP"):
        StableBaselinesVecEnv(later)
    same = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": AutoresetMode.SAME_STEP}}
    venv, native = (adapted(reference=SHORT, **how) for how in (same, {}))
    assert identical(venv.reset(), native.reset())
    for action in torques(0, 60, LANES):
        results, others = venv.step(action), native.step(action)
        assert identical(results[:3], others[:3])
        assert all((a.keys() == b.keys()) for a, b in zip(results[3], others[3], strict=True))


def test_seeds_hold_for_the_next_reset_and_the_streams_go_on_after_it():
    venv, loop = (make(disturbance=NOISY, randomisation="plants") for make in (adapted, monitored))
    assert venv.seed(7) == loop.seed(7) == [7, 8, 9, 10]
    starts = []
    for _ in range(3):
        starts.append(venv.reset())
        assert identical(starts[-1], loop.reset())
    assert len(np.unique(np.concatenate(starts), axis=0)) == 3 * LANES
    venv.seed(7)
    assert identical(venv.reset(), starts[0])


OPTIONS = {
    "one for all": {"case": "payload", "initial_state": STILL},
    "one per lane": [{"case": case} for case in ("payload", "nominal", "machining", "payload")],
    "references": [{"reference": reference} for reference in (LONGER, SHORT, LONGER, SHORT)],
}


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_options_hold_for_one_episode_of_each_lane(options):
    venv, loop = both(reference=SHORT)
    for one in (venv, loop):
        one.set_options(options)
    for _ in range(2):  # the second reset knows nothing of them
        assert identical(venv.reset(), loop.reset())
        for action in torques(0, 130, LANES):
            assert_same_step(venv.step(action), loop.step(action))


def test_attributes_are_found_through_wrappers_and_by_lane():
    venv = VecFrameStack(adapted(rescaled=True, control_period=2e-3), 2)
    assert venv.get_attr("control_period") == [2e-3] * LANES
    assert venv.get_attr("substeps", indices=[0, -1]) == [10, 10] and venv.get_attr("substeps", indices=1) == [10]
    assert venv.get_attr("single_action_space")[0].high.tolist() == [1.0, 1.0]  # the outermost's
    assert venv.has_attr("substeps") and not venv.has_attr("gravity")
    assert venv.get_attr("render_mode") == [None] * LANES and venv.render_mode is None
    with pytest.raises(AttributeError, match="gravity"):
        venv.get_attr("gravity")
    with pytest.raises(IndexError):
        venv.get_attr("substeps", indices=[LANES])
