"""What a policy believes is kept with its rollout, in the file and on the report's page."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from fuzzyarm.cli.evaluate import _remarkable
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.eval.episodes.beliefs import belief_names
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.eval.episodes.rollout_file import read_rollouts, write_rollouts
from fuzzyarm.eval.evaluation.results_file import _check_row
from fuzzyarm.eval.evaluation.run import EvaluationConfig, _row
from fuzzyarm.eval.report.beliefs import belief_charts
from fuzzyarm.policies import load_policy


@pytest.fixture(scope="module")
def runs():
    env = FuzzyArmEnv(case="machining")
    names = ("adaptive-observer", "elastic-observer")
    return [record_rollout(env, load_policy(name), policy_name=name, case="machining", seed=0) for name in names]


def test_estimated_force_follows_the_true_one(runs):
    believed = dict(zip(belief_names(2), runs[0].beliefs.T, strict=True))
    assert len(runs[0].beliefs) == len(runs[0].time)
    estimate = np.column_stack([believed["force_x"], believed["force_y"]])
    # The belief after sample k is that of the force at sample k, the record that of sample k + 1.
    error = np.linalg.norm(estimate[1:] - runs[0].external_force[:-1], axis=1)
    assert np.median(error[100:-100]) < 0.3 * np.median(np.linalg.norm(runs[0].external_force, axis=1))
    assert np.all(believed["payload_deviation"] > 0.0)


def test_a_policy_without_beliefs_has_none(runs):
    assert runs[1].beliefs.size == 0


def test_beliefs_come_back_from_the_file_and_are_checked(runs, tmp_path):
    write_rollouts(runs, tmp_path)
    first, second = read_rollouts(tmp_path / "rollouts.npz")
    np.testing.assert_array_equal(first.beliefs, runs[0].beliefs)
    assert second.beliefs.size == 0


def test_the_page_shows_a_chart_of_those_who_say_what_they_believe(runs):
    drawn = belief_charts(runs)
    assert drawn.count("<figure>") == 1 and "adaptive-observer" in drawn and "kg true" in drawn
    assert belief_charts(runs[1:]) == ""
    heavier = EvaluationConfig(payload=7.5).case("payload", None)
    assert "7.5 kg true" in belief_charts(runs, {"machining": heavier})


class Diverging:
    """A policy at rest whose filter diverges at the third sample, while an estimate stands at its end."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros(2), 0 if state is None else state + 1

    def beliefs(self, state):
        ends = {"payload": np.array(False), "joint_stiffness": np.array(state == 1)}
        kept = np.zeros(2), np.zeros(2), np.array(0.0), np.array(1.0)
        names = "force", "force_deviation", "payload", "payload_deviation"
        return SimpleNamespace(**dict(zip(names, kept, strict=True)), diverged=np.array(state >= 2), at_end=ends)


def test_a_diverged_filter_is_named_on_the_console_and_in_the_results(tmp_path):
    run = record_rollout(FuzzyArmEnv(), Diverging(), policy_name="own", case="nominal", seed=0)
    said = (
        "its filter diverged at 0.002 s, and its fallback acted since; "
        "its estimate of joint stiffness stood at the end of its range at last"
    )
    assert run.note == said
    assert _remarkable([dataclasses.replace(run, completed=True)]) == [f"own in case nominal, seed 0: {said}"]
    row = _row(run, [run])
    assert row["note"] == said
    _check_row(row, ("nominal", "own", 0))
    write_rollouts([run], tmp_path)
    assert read_rollouts(tmp_path / "rollouts.npz")[0].note == ""


def test_estimates_within_their_range_are_not_named(runs):
    assert all(run.note == "" for run in runs)
