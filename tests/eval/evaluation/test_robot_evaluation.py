"""An evaluation of a robot: its loads, metrics of every joint, files that say which robot it was, and figures."""

import numpy as np
import pytest

from fuzzyarm import EvaluationConfig, evaluate, robot_named, write_results
from fuzzyarm.common.documents import read_json, record
from fuzzyarm.envs.physics.equations import bounds_of
from fuzzyarm.eval.episodes.rollout_file import read_rollouts, write_rollouts
from fuzzyarm.eval.evaluation.result_table import table_rows

ROBOT = robot_named("planar-3r")
pytestmark = pytest.mark.slow  # its simulation is compiled first


@pytest.fixture(scope="module")
def evaluation():
    return evaluate(EvaluationConfig(policies=("computed-torque",), cases=("nominal", "payload"), robot=ROBOT))


def test_the_robot_follows_its_default_reference_in_every_case(evaluation):
    assert evaluation.complete and [row["case"] for row in evaluation.rows] == ["nominal", "payload"]
    nominal, payload = evaluation.rows
    assert nominal["tip_error_max_mm"] < payload["tip_error_max_mm"] < 10.0
    assert list(evaluation.config.titles.values()) == ["Case 1: nominal", "Case 3: 2.7 kg payload"]


def test_there_are_metrics_of_every_joint(evaluation):
    row, rollout = evaluation.rows[0], evaluation.rollouts[0]
    peaks = np.abs(rollout.torque).max(axis=0)
    assert [row[f"torque_peak_{k}"] for k in (1, 2, 3)] == peaks.tolist() and "torque_peak_4" not in row
    assert row["torque_rms_3"] == pytest.approx(np.sqrt(np.mean(rollout.torque[:, 2] ** 2)))
    assert table_rows(evaluation.rows)[0][2][4].count(",") == 2
    low, high, velocity, _ = bounds_of(ROBOT)
    used = [np.abs(rollout.q_link - 0.5 * (low + high)) / (0.5 * (high - low)), np.abs(rollout.dq_motor) / velocity]
    assert row["domain_margin"] <= 1.0 - max(map(np.max, used)) + 1e-12


def test_results_and_rollouts_come_back_from_their_files(evaluation, tmp_path):
    write_results(evaluation, tmp_path)
    config = record(read_json(tmp_path / "results.json")["config"], EvaluationConfig)
    assert config == evaluation.config and config.robot.digest == ROBOT.digest
    assert config.command() == (
        "fuzzyarm evaluate --robot planar-3r --policy computed-torque --case nominal --case payload"
    )
    first = read_rollouts(write_rollouts(evaluation.rollouts, tmp_path))[0]
    assert first.torque.shape == (len(first.time), 3) and first.tip.shape == (len(first.time), 3)
    assert np.array_equal(first.q_link, evaluation.rollouts[0].q_link)
