"""A guest in a shield: what acts, what the guest is given, and names."""

import itertools
import warnings

import numpy as np
import pytest
from support.policies import answers

from fuzzyarm import ArmParameters, export_c, load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.export._c_text import program_of
from fuzzyarm.fuzzy_policy.laws.guest import ShieldedPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.policies.shield import shielded
from fuzzyarm.policies.spec import any_guest, recorded, resolve, without_guest
from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnEnv

MARGIN = np.array([4.0, 2.0])


def law():
    return load_policy("fuzzy-4-tip", control_period=1e-3)


class _Scripted(Policy):
    """Asks for given torques; it is no law, and may fail."""

    def __init__(self, *answers):
        super().__init__(ArmParameters(), 1e-3)
        self.answers = list(answers)

    def act(self, observation, memory, torque):
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        torque[:] = answer


def _rollout(policy, beside, steps, case="nominal"):
    """Return the torques of a policy in an episode, and those of another that sees the same samples."""
    env = FuzzyArmEnv(case)
    start = env.reset(seed=0)
    run = list(itertools.islice(episodes(env, policy, start), steps))
    seen = [start[0], *(step.observation for step in run[:-1])]
    return np.array([step.info["torque"] for step in run]), answers(beside, seen)[0]


@pytest.mark.parametrize("guest", ["ppo-robust", "adaptive-observer", "fuzzy-4"])
def test_whatever_a_guest_asks_for_the_torque_stays_within_the_margin_of_the_law(guest):
    torque, own = _rollout(load_policy(f"shield:fuzzy-4-tip:{guest}:4,2"), law(), 200, "payload")
    assert (np.abs(torque - own) <= MARGIN * (1.0 + 1e-12)).all()
    assert (np.abs(torque - own).max(axis=0) > 0.99 * MARGIN).all()  # the payload is worth more than the margin


def test_within_the_margin_the_guest_acts():
    policy = shielded(law(), "elastic-observer", (1e3, 1e3))
    np.testing.assert_array_equal(*_rollout(policy, load_policy("elastic-observer"), 50))


def test_the_law_acts_where_a_guest_fails_or_returns_no_number():
    guest = _Scripted([[np.nan, 1e9]], ValueError("no"), [[np.inf, -np.inf]], ZeroDivisionError("no"))
    torque, own = _rollout(ShieldedPolicy(law(), guest, MARGIN), law(), 4)
    np.testing.assert_allclose(torque - own, [[0.0, 2.0], [0.0, 0.0], [4.0, -2.0], [0.0, 0.0]], atol=1e-9)


def test_an_observer_in_a_shield_knows_the_torque_that_acts():
    """Unaware of it, the observer takes u - π for a load."""
    guest, env, loads = load_policy("elastic-observer", control_period=1e-3), FuzzyArmEnv(), []
    for one in (guest, _NotALaw(guest)):
        policy = ShieldedPolicy(law(), one, (0.5, 0.25))
        *_, last = itertools.islice(episodes(env, policy, env.reset(seed=0)), 300)
        loads.append(np.abs(guest.estimate(last.memory[law().memory_size :])[1]).max())
    assert loads[0] < 0.1 * loads[1]


class _NotALaw(Policy):
    """A law that its shield does not recognise."""

    def __init__(self, law):
        super().__init__(law.parameters, law.control_period)
        self.law, self.memory_size = law, law.memory_size

    def act(self, observation, memory, torque):
        self.law.act(observation, memory, torque)


def test_an_object_with_a_state_of_its_own_is_a_guest_and_its_first_failure_is_a_warning():
    class Own:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            calls = 1 if state is None else state["calls"] + 1
            if calls == 3:
                raise RuntimeError("the network is gone")
            return np.full(2, 1e3), {"calls": calls}

    with pytest.warns(RuntimeWarning, match="shield failed; the shield's law acts alone: Own: predict failed.*is gone"):
        torque, own = _rollout(shielded("fuzzy-4-tip", Own(), MARGIN), law(), 3)
    np.testing.assert_allclose(torque - own, [[4.0, 2.0], [4.0, 2.0], [0.0, 0.0]], atol=1e-9)


def test_a_learner_beside_a_law_acts_as_its_shield_does():
    learner, env = FuzzyArmLearnEnv("nominal", shield="fuzzy-4-tip:4,2"), FuzzyArmEnv()
    learner.reset(seed=0)
    policy = ShieldedPolicy(law(), _Scripted(*[[[2.0, -1.0]]] * 30), MARGIN, beside=True)
    for step in itertools.islice(episodes(env, policy, env.reset(seed=0)), 30):
        assert learner.step(np.array([0.5, -0.5]))[-1]["tip_error"] == step.info["tip_error"]


def test_a_shield_is_written_in_c_like_any_law(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = program_of(load_policy("shield:fuzzy-4-tip:ppo-robust:4,2")).source_text("shield", "double")
    assert "shield_step" in text
    with pytest.raises(ValueError, match='needs number = "double"'):  # an observer, although it is a guest
        export_c("shield", load_policy("shield:fuzzy-4-tip:adaptive-observer:4,2"), tmp_path, "float")


def test_other_names_are_refused():
    for name, message in (
        ("shield:fuzzy-4-tip:any:4,2", "stands for a shield with any policy inside, which only fuzzyarm prove accepts"),
        ("shield:fuzzy-4-tip:ppo-robust:4", "must be 2 real numbers"),
        ("shield:fuzzy-4-tip:ppo-robust:a,b", "its margin 'a,b' must be one torque for each joint"),
        ("shield:fuzzy-4-tip:ppo-robust:-1,2", r"margin\[0\] = -1.0 N m is out of range"),
        ("shield:fuzzy-4-tip:os:getcwd:4,2", "names code, which load_policy does not run"),
        ("shield:os:ppo-robust:4,2", "unknown policy 'os'"),
        ("shield:fuzzy-4-tip", "unknown policy .* shield:LAW:POLICY:4,2"),
        ("shield:fuzzy-4-tip:shield:fuzzy-4:fuzzy-4:1,1:4,2", "unknown policy"),
    ):
        with pytest.raises(ValueError, match=message):
            load_policy(name)


def test_a_name_is_recorded_without_the_machine_and_any_guest_stands_for_it():
    name = "shield:fuzzy-4-tip:/home/me/runs/mine:4,2"
    assert recorded(name) == resolve(name).label == "shield:fuzzy-4-tip:mine:4,2"
    assert any_guest(name) == "shield:fuzzy-4-tip:any:4,2"
    assert without_guest(name) == ("fuzzy-4-tip", (4.0, 2.0))
    assert resolve(any_guest(name)).files() == resolve("fuzzy-4-tip").files()
