"""A metric that is added is in the results, their table, the report, a sweep and both leaderboards."""

import json

import numpy as np
import pytest

from fuzzyarm.eval.episodes.metrics import METRICS, Metric, add_metric
from fuzzyarm.eval.evaluation.ranking import document, markdown, rank_policies
from fuzzyarm.eval.evaluation.result_table import table_rows
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate, write_results
from fuzzyarm.eval.report.summary import metrics_table
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.episodes import run_plants
from fuzzyarm.eval.sweep.ranking import rank_sweeps
from fuzzyarm.eval.sweep.summary import summarise, summary_csv
from fuzzyarm.policies import load_policy


@pytest.fixture(autouse=True)
def added():
    add_metric(
        Metric(
            "tip_mean_square",
            "mm^2",
            "Mean square of the tip error.",
            lambda run: 1e6 * np.mean(run.tip_error**2),
            column="mean square",
            form="{:.5e}",
            swept=lambda errors: 1e6 * errors.squares / errors.steps,
            key="mean_square",
            words="mean square of the tip error",
            ranked=True,
        )
    )
    yield
    del METRICS["tip_mean_square"]


def test_in_evaluations(tmp_path, short):
    done = evaluate(EvaluationConfig(policies=("fuzzy-4",), cases=("nominal",)))
    (row,) = done.rows
    assert row["tip_mean_square"] == pytest.approx(row["tip_error_rms_mm"] ** 2)
    text = f"{row['tip_mean_square']:.5e}"
    assert table_rows(done.rows)[0][2][-1] == text
    table = metrics_table(done.rows, done.config.titles)
    assert "mean square [mm^2]" in table and text in table
    write_results(done, tmp_path)
    assert "tip_mean_square" in (tmp_path / "results.csv").read_text()
    board = rank_policies([tmp_path])
    assert "mean square, nominal [mm^2]" in markdown(board) and text in markdown(board)
    assert document(board)["standings"][0]["mean square"] == {"nominal": row["tip_mean_square"]}


def test_in_sweeps(tmp_path):
    config = SweepConfig(policies=("fuzzy-4",), cases=("nominal",), plants=3)
    results = run_plants(config, {"fuzzy-4": load_policy("fuzzy-4")}, range(3))
    summary = summarise(config, results)
    (row,) = summary["rows"]
    assert row["mean_square"]["0.5"]["value"] == pytest.approx(row["rms_mm"]["0.5"]["value"] ** 2)
    assert row["worst"][0]["mean_square"] > 0.0 and "mean_square_0.99_value" in summary_csv(summary["rows"])
    (tmp_path / "sweep.json").write_text(json.dumps(summary))
    table = markdown(rank_sweeps([tmp_path]))
    assert "99 % of plants, mean square, nominal [mm^2]" in table
    assert f"{row['mean_square']['0.99']['value']:.5e}" in table
