"""Figures and tables are those of the shipped policies, or a line says which are not."""

import dataclasses
import json
import shutil

import pytest

from fuzzyarm.policies import registry


@pytest.fixture
def published(module):
    return module("published")


@pytest.fixture
def record(published):
    return json.loads(published.RECORD.read_text(encoding="utf-8"))


def test_every_figure_and_result_shows_the_policies_that_are_shipped(published, record):
    """To mend it, measure the results again that show an older policy; `python benchmarks/readme.py` does the rest."""
    assert published.differences(record) == []


def test_the_command_draws_every_figure(module, record):
    pictures = module("figures").FIGURES
    assert pictures.keys() == record["figures"].keys()
    for name, picture in pictures.items():
        entry = record["figures"][name]
        assert (set(picture.results), set(picture.policies)) == (set(entry["results"]), set(entry["policies"]))
        assert picture.results or picture.policies


def test_the_figure_of_a_finished_study_is_refused_when_its_result_has_changed(published, module, monkeypatch):
    name = "adaptive_front.png"
    picture = module("figures").FIGURES[name]
    assert picture.draw is None
    monkeypatch.setattr(published, "figure_record", lambda *_: {"sha256": "another"})
    monkeypatch.setattr(published, "write_atomically", lambda *_: None)
    with pytest.raises(ValueError, match=f"{name} is older than what it shows; its study is finished"):
        published.publish({name: picture})


def test_a_changed_file_of_a_policy_is_found_wherever_the_policy_is_shown(published, record, tmp_path, monkeypatch):
    own = registry.POLICIES["ppo-robust"]
    shutil.copytree(own.path, tmp_path / "policy")
    (tmp_path / "policy" / "policy.json").write_bytes((own.path / "policy.json").read_bytes() + b"\n")
    monkeypatch.setitem(registry.POLICIES, "ppo-robust", dataclasses.replace(own, path=tmp_path / "policy"))
    found = published.differences(record)
    assert "overview.png, ppo-robust: the policy was another one" in found
    assert {"evaluate", "tip_bound"} <= {line.partition(", commit ")[0] for line in found}
    assert all("ppo-robust" in line for line in found)


def test_a_changed_law_in_code_is_found_by_its_errors(published, record, tmp_path, monkeypatch):
    evaluation = json.loads(published.EVALUATION.read_text(encoding="utf-8"))
    for row in evaluation["results"]:
        if (row["policy"], row["case"]) == ("adaptive-observer", "payload"):
            row["tip_error_max_mm"] *= 1.01
    (tmp_path / "evaluate.json").write_text(json.dumps(evaluation))
    monkeypatch.setattr(published, "EVALUATION", tmp_path / "evaluate.json")
    found = published.differences(record)
    assert "animation.gif, adaptive-observer: the policy was another one" in found
    assert all("adaptive-observer" in line for line in found)


def test_a_changed_figure_or_result_and_one_that_nobody_recorded_are_found(published, record, tmp_path, monkeypatch):
    for name in ("RESULTS", "FIGURES"):
        shutil.copytree(getattr(published, name), tmp_path / name)
        monkeypatch.setattr(published, name, tmp_path / name)
    (tmp_path / "FIGURES" / "new.png").write_bytes(b"")
    (tmp_path / "FIGURES" / "arm.png").write_bytes(b"")
    (tmp_path / "RESULTS" / "margins.json").unlink()
    record["results"]["bench"]["sha256"] = "0" * 64
    assert sorted(published.differences(record)) == [
        "arm.png is not the file of the record",
        "bench is not the file of the record",
        "margins is not the file of the record",
        "new.png is not in the record",
        "throughput.png shows an older bench.json",
    ]


def test_rows_belong_to_the_commit_they_name_or_else_to_that_of_the_result(published):
    document = {
        "commit": "a",
        "command": "fuzzyarm evaluate --policy fuzzy-1",
        "rows": [{"policy": "fuzzy-2"}, {"policy": "fuzzy-4-tip", "commit": "b"}, {"provenance": {"commit": "c"}}],
        "errors": {"fuzzy-8, payload": 1.0},
        "shared": [{"name": "fuzzy-16", "commits": ["d", "e"]}],
    }
    found = {(commit, name) for commit, names in published._parts(document, ()) for name in names}
    expected = {("a", "fuzzy-2"), ("b", "fuzzy-4-tip"), ("a", "fuzzy-8"), ("d", "fuzzy-16"), ("e", "fuzzy-16")}
    assert found == expected


def test_files_of_a_policy_at_an_older_commit_are_those_of_its_tree(published, record):
    if published._git("rev-parse", "--is-shallow-repository") != b"false\n":
        pytest.skip("the history is not here")
    for name in ("evaluate", "soak", "tip_bound", "adaptive_margins"):
        assert published.result_record(published.RESULTS / f"{name}.json") == record["results"][name]
    (commit,) = record["results"]["evaluate"]["policies"]
    stored = json.loads(published.EVALUATION.read_text(encoding="utf-8"))
    files = {name: entry.get("files", {}) for name, entry in record["results"]["evaluate"]["policies"][commit].items()}
    assert files == stored["policy_files"]


def test_a_result_that_names_no_commit_is_refused(published, tmp_path):
    (tmp_path / "new.json").write_text(json.dumps({"commit": None, "rows": [{"policy": "fuzzy-4"}]}))
    with pytest.raises(ValueError, match=r"new\.json names no commit"):
        published.result_record(tmp_path / "new.json")
