"""What a policy believes is kept with its rollout, in the file and on the report's page."""

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pytest

from fuzzyarm.cli.evaluate import _remarkable
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.scenario.disturbances import Disturbance, TorqueBias
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.eval.episodes.rollout_file import read_rollouts, write_rollouts
from fuzzyarm.eval.evaluation.results_file import _check_rollout as _check_stored
from fuzzyarm.eval.evaluation.results_file import _check_row
from fuzzyarm.eval.evaluation.run import EvaluationConfig, _row
from fuzzyarm.eval.report.beliefs import belief_figures
from fuzzyarm.policies import load_policy


@pytest.fixture(scope="module")
def runs():
    env = FuzzyArmEnv(case="machining")
    names = ("adaptive-observer", "elastic-observer")
    return [record_rollout(env, load_policy(name), policy_name=name, case="machining", seed=0) for name in names]


def test_beliefs_come_back_from_the_file_and_are_checked(runs, tmp_path):
    noted = dataclasses.replace(runs[0], note="its filter diverged, or its torques swung, at 0.002 s")
    path = write_rollouts([noted, runs[1]], tmp_path)
    first, second = read_rollouts(path)
    np.testing.assert_array_equal(first.beliefs, runs[0].beliefs)
    assert first.belief_names == runs[0].belief_names and first.note == noted.note
    assert second.beliefs.size == 0 and second.belief_names == () and second.note == ""
    for damaged in (
        {"belief_names": runs[0].belief_names[:-1]},
        {"belief_names": (*runs[0].belief_names[:-1], "payload")},  # twice
        {"beliefs": np.where(runs[0].beliefs == runs[0].beliefs[3, 2], np.inf, runs[0].beliefs)},
    ):
        with pytest.raises(ValueError, match=r"rollouts\.npz is damaged \(belief"):
            read_rollouts(write_rollouts([dataclasses.replace(runs[0], **damaged)], tmp_path))


def test_the_page_shows_what_is_believed_beside_the_truth(runs):
    drawn = belief_figures(runs)
    assert drawn.count("<figure>") == drawn.count('class="belief-band"') == 1 and "adaptive-observer" in drawn
    assert belief_figures(runs[1:]) == ""
    columns = "payload", "stiffness_1", "stiffness_2", "offset_1", "offset_2", "lateness"
    values, deviations = (4.2, 1.04, 0.97, -1e-9, 0.3, 2e-3), (1.5, 0.02, 0.1, 2.0, 0.0, 5e-4)
    names = tuple(name + end for name in columns for end in ("", "_deviation"))
    numbers = np.tile([number for pair in zip(values, deviations, strict=True) for number in pair], (3, 1))
    numbers[2] = np.nan  # the filter has diverged
    run = dataclasses.replace(runs[0], beliefs=numbers, belief_names=names, note="a <note>")
    pushed = dataclasses.replace(
        EvaluationConfig(payload=7.5).case("payload", None),
        disturbance=Disturbance(payload=Payload(7.5), torque_bias=TorqueBias((3.0, -1.0))),
    )
    drawn = belief_figures([run, dataclasses.replace(run, seed=1, note="")], {"machining": pushed})
    rows = re.findall(r"<tr><th scope=.row.>(.*?)</th>(.*?)</tr>", drawn)
    assert {label: re.findall(r"<td.*?>(.*?)</td>", cells) for label, cells in rows} == {
        "payload [kg]": ["4.2 ± 1.5", "7.5"],
        "stiffness": ["1.040 ± 0.020", "0.97 ± 0.10", "1"],
        "offset [N m]": ["0.0 ± 2.0", "0.3000 ± 0.0000", "3, -1"],
        "lateness [ms]": ["2.00 ± 0.50", "0"],
    }
    assert "at 0.002 s" in drawn and "seed 0: a &lt;note&gt;" in drawn and "seed 1" not in drawn
    assert "<svg" not in drawn  # no force is believed


class Diverging:
    """A policy at rest whose filter diverges at the sixth sample; before that an estimate stands at its end twice."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros(2), 0 if state is None else state + 1

    def beliefs(self, state):
        ends = {"payload": np.array(state == 4), "joint_stiffness": np.array(state in (1, 3)), "mass": np.array(False)}
        kept = np.zeros(2), np.zeros(2), np.array(state), np.array(np.inf if state == 2 else 1.0), np.zeros(2)
        names = "force", "force_deviation", "payload", "payload_deviation", "offset"  # which has no deviation
        return SimpleNamespace(
            **dict(zip(names, kept, strict=True)), diverged=np.array(state >= 5), at_end=ends, other_path=state >= 3
        )


def test_what_has_to_be_known_is_on_the_console_in_the_results_in_the_file_and_on_the_page(tmp_path):
    run = record_rollout(FuzzyArmEnv(), Diverging(), policy_name="own", case="nominal", seed=0)
    said = (
        "its path differs from that of the pass before from 0.003 s on, and it no longer expects the forces of that; "
        "its filter diverged, or its torques swung, at 0.005 s, and its fallback acted since; "
        "estimates that stood at an end of their range: joint stiffness (first at 0.001 s), "
        "payload (first at 0.004 s, and at last)"
    )
    assert run.note == said
    assert _remarkable([dataclasses.replace(run, completed=True)]) == [f"own in case nominal, seed 0: {said}"]
    row = _row(run, [run])
    assert row["note"] == said
    _check_row(row, ("nominal", "own", 0))
    write_rollouts([run], tmp_path)
    assert read_rollouts(tmp_path / "rollouts.npz")[0].note == said
    _check_stored(run, row)
    with pytest.raises(ValueError, match="the note on own in case nominal is not that of its rollout"):
        _check_stored(run, row | {"note": "all is well"})
    assert said in belief_figures([run])


def test_a_filter_that_has_diverged_believes_nothing():
    run = record_rollout(FuzzyArmEnv(), Diverging(), policy_name="own", case="nominal", seed=0)
    assert "offset_1" not in run.believed
    np.testing.assert_array_equal(run.believed["payload"][:7], [0.0, 1.0, 2.0, 3.0, 4.0, np.nan, np.nan])
    np.testing.assert_array_equal(run.believed["payload_deviation"][:4], [1.0, 1.0, np.nan, 1.0])
