"""An evaluation along a path and with loads of one's own: it is recorded, and read back the same."""

from fuzzyarm.common.documents import read_json, record
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate, write_results


def test_the_configuration_comes_back_from_its_file_with_points_and_loads(tmp_path):
    points = GivenPath(((0.4, 0.5), (0.5, 0.4)), duration=0.4)
    config = EvaluationConfig(
        policies=("computed-torque",), cases=("machining", "payload"), points=points, force=(1.0, 2.0), payload=0.5
    )
    evaluation = evaluate(config)
    assert evaluation.complete and config.titles["payload"] == "Case 3: 0.5 kg payload"
    assert evaluation.rollouts[0].external_force.max() <= 2.0 and len(evaluation.rollouts[0].time) == 400
    write_results(evaluation, tmp_path)
    assert record(read_json(tmp_path / "results.json")["config"], EvaluationConfig) == config
    assert config.command() is None  # points are no words of a command line


def test_names_and_loads_are_words_of_the_command():
    config = EvaluationConfig(path="line", force=(1.0, 2.0), payload=0.5)
    assert config.command() == "fuzzyarm evaluate --path line --force 1.0 2.0 --payload 0.5"
