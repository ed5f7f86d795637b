"""A guest in a shield: what acts, what the guest is given, and names."""

import warnings

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.export._c_text import program_of
from fuzzyarm.export.c_files import export_c
from fuzzyarm.fuzzy_policy.laws.guest import ShieldedPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.policies.shield import shielded
from fuzzyarm.policies.spec import any_guest, recorded, resolve, without_guest
from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnEnv

MARGIN = np.array([4.0, 2.0])


class _Scripted(Policy):
    """Asks for given torques; it is no law, and may fail."""

    def __init__(self, *answers):
        super().__init__(load_policy("fuzzy-4-tip", control_period=1e-3).parameters, 1e-3)
        self.answers = list(answers)

    def act(self, observation, memory, torque):
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        torque[:] = answer


def _rollout(policy, case="nominal", steps=200, beside=None):
    """Return the torques of a policy in an episode, and those of another that sees the same samples."""
    env = FuzzyArmEnv(case)
    observation, info = env.reset(seed=0)
    state, other, torques, others, errors = None, None, [], [], []
    for _ in range(steps):
        torque, state = policy.predict(observation, state)
        if beside is not None:
            asked, other = beside.predict(observation, other)
            others.append(asked)
        observation, *_, info = env.step(torque)
        torques.append(torque)
        errors.append(info["tip_error"])
    return np.array(torques), np.array(others), np.array(errors)


@pytest.mark.parametrize("guest", ["ppo-robust", "adaptive-observer", "fuzzy-4"])
def test_whatever_a_guest_asks_for_the_torque_stays_within_the_margin_of_the_law(guest):
    law = load_policy("fuzzy-4-tip", control_period=1e-3)
    policy = load_policy(f"shield:fuzzy-4-tip:{guest}:4,2")
    torque, own, _ = _rollout(policy, "payload", beside=law)
    assert (np.abs(torque - own) <= MARGIN * (1.0 + 1e-12)).all()
    assert (np.abs(torque - own).max(axis=0) > 0.99 * MARGIN).all()  # the payload is worth more than the margin


def test_within_the_margin_the_guest_acts():
    law = load_policy("fuzzy-4-tip", control_period=1e-3)
    torque, asked, _ = _rollout(
        shielded(law, "elastic-observer", (1e3, 1e3)), steps=50, beside=load_policy("elastic-observer")
    )
    np.testing.assert_array_equal(torque, asked)


def test_the_law_acts_where_a_guest_fails_or_returns_no_number():
    guest = _Scripted([[np.nan, 1e9]], ValueError("no"), [[np.inf, -np.inf]], ZeroDivisionError("no"))
    law = load_policy("fuzzy-4-tip", control_period=1e-3)
    torque, own, _ = _rollout(ShieldedPolicy(law, guest, MARGIN), steps=4, beside=law)
    np.testing.assert_allclose(torque - own, [[0.0, 2.0], [0.0, 0.0], [4.0, -2.0], [0.0, 0.0]], atol=1e-9)


def test_an_observer_in_a_shield_knows_the_torque_that_acts():
    """Unaware of it, the observer takes u - π for a load."""
    law, guest = (load_policy(name, control_period=1e-3) for name in ("fuzzy-4-tip", "elastic-observer"))
    policy, unaware = ShieldedPolicy(law, guest, (0.5, 0.25)), ShieldedPolicy(law, _NotALaw(guest), (0.5, 0.25))
    loads = []
    for one in (policy, unaware):
        env, state = FuzzyArmEnv(), None
        observation, _ = env.reset(seed=0)
        for _ in range(300):
            torque, state = one.predict(observation, state)
            observation, *_ = env.step(torque)
        loads.append(np.abs(guest.estimate(state[law.memory_size :])[1]).max())
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

    law = load_policy("fuzzy-4-tip", control_period=1e-3)
    policy = shielded("fuzzy-4-tip", Own(), MARGIN)
    with pytest.warns(
        RuntimeWarning,
        match="the shield's policy failed; its law acts alone: Own: predict failed.*is gone",
    ):
        torque, own, _ = _rollout(policy, steps=3, beside=law)
    np.testing.assert_allclose(torque - own, [[4.0, 2.0], [4.0, 2.0], [0.0, 0.0]], atol=1e-9)


def test_a_learner_beside_a_law_acts_as_its_shield_does():
    env = FuzzyArmLearnEnv("nominal", shield="fuzzy-4-tip:4,2")
    env.reset(seed=0)
    law = load_policy("fuzzy-4-tip", control_period=1e-3)
    guest = _Scripted(*[[[2.0, -1.0]]] * 30)
    _, _, errors = _rollout(ShieldedPolicy(law, guest, MARGIN, beside=True), steps=30)
    seen = [env.step(np.array([0.5, -0.5]))[-1]["tip_error"] for _ in range(30)]
    np.testing.assert_array_equal(seen, errors)


def test_a_shield_is_written_in_c_like_any_law():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = program_of(load_policy("shield:fuzzy-4-tip:ppo-robust:4,2")).source_text("shield", "double")
    assert "shield_step" in text


def test_an_observer_is_not_written_in_float_because_it_is_a_guest(tmp_path):
    with pytest.raises(ValueError, match='needs number = "double"'):
        export_c("shield", load_policy("shield:fuzzy-4-tip:adaptive-observer:4,2"), tmp_path, "float")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("shield:fuzzy-4-tip:any:4,2", "stands for a shield with any policy inside, which only fuzzyarm prove accepts"),
        ("shield:fuzzy-4-tip:ppo-robust:4", "must be 2 real numbers"),
        ("shield:fuzzy-4-tip:ppo-robust:a,b", "its margin 'a,b' must be one torque for each joint"),
        ("shield:fuzzy-4-tip:ppo-robust:-1,2", r"margin\[0\] = -1.0 N m is out of range"),
        ("shield:fuzzy-4-tip:os:getcwd:4,2", "names code, which load_policy does not run"),
        ("shield:os:ppo-robust:4,2", "unknown policy 'os'"),
        ("shield:fuzzy-4-tip", "unknown policy .* shield:LAW:POLICY:4,2"),
        ("shield:fuzzy-4-tip:shield:fuzzy-4:fuzzy-4:1,1:4,2", "unknown policy"),
    ],
)
def test_other_names_are_refused(name, message):
    with pytest.raises(ValueError, match=message):
        load_policy(name)


def test_a_name_is_recorded_without_the_machine_and_any_guest_stands_for_it():
    name = "shield:fuzzy-4-tip:/home/me/runs/mine:4,2"
    assert recorded(name) == resolve(name).label == "shield:fuzzy-4-tip:mine:4,2"
    assert any_guest(name) == "shield:fuzzy-4-tip:any:4,2"
    assert without_guest(name) == ("fuzzy-4-tip", (4.0, 2.0))
    assert resolve(any_guest(name)).files() == resolve("fuzzy-4-tip").files()
