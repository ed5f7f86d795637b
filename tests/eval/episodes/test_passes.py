"""Passes recorded one after the other, and the rows that an evaluation makes of them."""

import numpy as np
import pytest

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.eval.episodes.rollout import record_passes
from fuzzyarm.eval.evaluation.recheck import recheck_results
from fuzzyarm.eval.evaluation.results_file import read_results
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate, write_results


class Counting:
    """A policy that tells in its torque which pass it is in, and counts how often it looks back."""

    looked_back = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        count = 0 if state is None else state
        return np.array([float(count), 0.0]), count

    def begin_pass(self, state):
        self.looked_back += 1
        return state + 1

    def repeated(self):
        return self


def test_each_pass_begins_with_what_begin_pass_returned(short):
    policy = Counting()
    runs = record_passes(FuzzyArmEnv(), policy, 3, policy_name="counting", case="nominal", seed=0)
    assert [run.torque[0, 0] for run in runs] == [0.0, 1.0, 2.0]
    assert [run.seed for run in runs] == [0, 1, 2]
    assert policy.looked_back == 2  # nothing is learned from the last one


def test_rows_hold_the_errors_of_every_pass_and_the_file_is_read_back(tmp_path, short):
    config = EvaluationConfig(policies=("fuzzy-4-tip",), cases=("machining",), passes=2)
    done = evaluate(config)
    (row,) = done.rows
    assert row["pass_2_max_mm"] == row["tip_error_max_mm"] < row["pass_1_max_mm"]
    assert row["pass_2_rms_mm"] == pytest.approx(row["tip_error_rms_mm"], rel=1e-12)
    assert config.command() == "fuzzyarm evaluate --policy fuzzy-4-tip --case machining --passes 2"
    write_results(done, tmp_path)
    assert not recheck_results(read_results(tmp_path)).differences
