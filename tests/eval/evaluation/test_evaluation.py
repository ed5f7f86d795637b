"""Evaluation as a library: records, reproducibility, and the results the project claims."""

import dataclasses
import json

import numpy as np
import pytest
from support.rollouts import made_rollout

from fuzzyarm import ArmParameters, EvaluationConfig, SweepConfig, evaluate, robot_named, write_results
from fuzzyarm.common.documents import read_json, record
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.equations import bounds_of
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.eval.episodes.metrics import METRICS, Metric, add_metric, metrics_of
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.eval.evaluation.ranking import document, markdown, rank_policies
from fuzzyarm.eval.evaluation.result_table import table_rows
from fuzzyarm.eval.evaluation.run import row_of
from fuzzyarm.eval.report._summary import metrics_table
from fuzzyarm.eval.sweep._episodes import run_plants
from fuzzyarm.eval.sweep.ranking import rank_sweeps
from fuzzyarm.eval.sweep.summary import summarise
from fuzzyarm.policies import load_policy


def test_noise_is_seeded(short):
    config = EvaluationConfig(policies=("fuzzy-4",), cases=("nominal",), seeds=2, encoder_noise=(1e-5, 1e-3))
    first, second = evaluate(config), evaluate(config)
    for one, other in zip(first.rows, second.rows, strict=True):  # bit for bit but for the clock
        assert one | {"predict_us": 0.0} == other | {"predict_us": 0.0}
    assert first.rows[0]["tip_error_max_mm"] != first.rows[1]["tip_error_max_mm"]
    assert " to " in table_rows(first.rows)[0][2][0]  # a median comes with its range


@pytest.mark.parametrize(("policy", "factor"), [("fuzzy-4-tip", 0.95), ("computed-torque-tip", 1.0 / 0.95)])
def test_a_stiffness_known_to_five_percent_costs_a_quarter_millimetre(policy, factor):
    arm = ArmParameters()
    plant = dataclasses.replace(arm, stiffness=tuple(factor * k for k in arm.stiffness))
    run = record_rollout(FuzzyArmEnv(parameters=plant), load_policy(policy), policy_name=policy, case="nominal", seed=0)
    assert 0.1 < metrics_of(run)["tip_error_max_mm"] < 0.25


def test_cells_below_a_micrometre_give_no_number():
    row = row_of(made_rollout(np.array([1e-3]))) | {"tip_error_max_mm": 0.00101, "tip_error_rms_mm": 0.00016}
    row |= {"circularity_link_min_mm": -0.00099, "circularity_link_max_mm": 0.0}
    ((_, _, cells),) = table_rows([row])
    assert (cells[0], cells[2], cells[3]) == ("0.00101", "< 0.001", "[> -0.001, < 0.001]")
    ((_, _, cells),) = table_rows([row, dict(row, tip_error_rms_mm=0.5)])
    assert cells[2] == "0.250 (< 0.001 to 0.500)"


def test_an_early_end_is_reported_not_hidden():
    arm = ArmParameters(velocity_limit=(3.4, 4.42))  # the reference just fits, ringing under the payload does not
    result = evaluate(EvaluationConfig(policies=("computed-torque",), cases=("payload",), parameters=arm))
    assert not result.complete
    assert "velocity left the domain" in result.rows[0]["reason"]
    assert "ended early in 1 of 1" in table_rows(result.rows)[0][1]


def test_the_configuration_comes_back_from_its_file_with_points_and_loads(tmp_path):
    changed = {"points": GivenPath(((0.4, 0.5), (0.5, 0.4)), duration=0.4), "force": (1.0, 2.0), "payload": 0.5}
    config = EvaluationConfig(policies=("computed-torque",), cases=("machining", "payload"), **changed)
    evaluation = evaluate(config)
    assert evaluation.complete and config.titles["payload"] == "Case 3: 0.5 kg payload"
    assert evaluation.rollouts[0].external_force.max() <= 2.0 and len(evaluation.rollouts[0].time) == 400
    write_results(evaluation, tmp_path)
    assert record(read_json(tmp_path / "results.json")["config"], EvaluationConfig) == config


@pytest.mark.parametrize(
    ("changed", "command", "page"),
    [
        ({"path": "line", "force": (1.0, 2.0), "payload": 0.5}, "--path line --force 1.0 2.0 --payload 0.5", ""),
        ({"policies": ("fuzzy-4",), "cases": ("payload",)}, "--policy fuzzy-4 --case payload", ""),
        ({"parameters": ArmParameters(mass=(12.0, 9.0))}, None, "--robot FILE"),
        ({"robot": dataclasses.replace(robot_named("planar-3r"), name="mine")}, None, "--robot FILE"),
        ({"points": GivenPath(((0.4, 0.5), (0.5, 0.4)))}, None, "--path FILE"),
        ({"control_period": 2e-3, "cases": ("payload",)}, "--case payload --control-period 0.002", ""),
    ],
)
def test_the_command_of_a_configuration_and_what_the_page_shows_for_unknown_files(changed, command, page):
    config = EvaluationConfig(**changed)
    assert config.command() == (command and f"fuzzyarm evaluate {command}")
    assert config.command(placeholders=True) == f"fuzzyarm evaluate {command or page}"


def test_a_law_whose_loop_is_unstable_on_light_rotors_is_said_to_be_so():
    """The law's bandwidth is too large for them; it follows the path all the same."""
    arm = ArmParameters(motor_inertia=(1.0, 0.2))
    policies = "computed-torque", "elastic-observer"
    (line,) = evaluate(EvaluationConfig(policies=policies, cases=("nominal",), parameters=arm)).remarks
    assert line.startswith("computed-torque: its loop is unstable on this arm (spectral radius 1.0")


@pytest.mark.slow  # its simulation is compiled first
def test_a_robot_follows_its_default_reference_and_has_metrics_of_every_joint():
    robot = robot_named("planar-3r")
    config = EvaluationConfig(policies=("computed-torque",), cases=("nominal", "payload"), robot=robot)
    assert list(config.titles.values()) == ["Case 1: nominal", "Case 3: 2.7 kg payload"]
    found = evaluate(config)
    (row, payload), run = found.rows, found.rollouts[0]
    assert found.complete and [row["case"], payload["case"]] == ["nominal", "payload"]
    assert row["tip_error_max_mm"] < payload["tip_error_max_mm"] < 10.0
    peaks = np.abs(run.torque).max(axis=0)
    assert [row[f"torque_peak_{k}"] for k in (1, 2, 3)] == peaks.tolist() and "torque_peak_4" not in row
    assert row["torque_rms_3"] == pytest.approx(np.sqrt(np.mean(run.torque[:, 2] ** 2)))
    assert table_rows(found.rows)[0][2][4].count(",") == 2
    low, high, velocity, _ = bounds_of(robot)
    used = [np.abs(run.q_link - 0.5 * (low + high)) / (0.5 * (high - low)), np.abs(run.dq_motor) / velocity]
    assert row["domain_margin"] <= 1.0 - max(map(np.max, used)) + 1e-12


@pytest.fixture
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


def test_an_added_metric_is_in_evaluations(tmp_path, short, added):
    (row,) = (done := evaluate(EvaluationConfig(policies=("fuzzy-4",), cases=("nominal",)))).rows
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


def test_an_added_metric_is_in_sweeps(tmp_path, added):
    config = SweepConfig(policies=("fuzzy-4",), cases=("nominal",), plants=3)
    summary = summarise(config, run_plants(config, {"fuzzy-4": load_policy("fuzzy-4")}, range(3)))
    (row,) = summary["rows"]
    assert row["mean_square"]["0.5"]["value"] == pytest.approx(row["rms_mm"]["0.5"]["value"] ** 2)
    assert row["worst"][0]["mean_square"] > 0.0 and row["mean_square"]["0.99"]["value"] > 0.0
    (tmp_path / "sweep.json").write_text(json.dumps(summary))
    table = markdown(rank_sweeps([tmp_path]))
    assert "99 % of plants, mean square, nominal [mm^2]" in table
    assert f"{row['mean_square']['0.99']['value']:.5e}" in table
