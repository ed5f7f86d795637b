"""`fuzzyarm sweep` from a user's view: outputs, exit codes, one-line errors, and nothing overwritten."""

import importlib
import json
import os
import shutil
import sys
from unittest import mock

import numpy as np
import pytest
from matplotlib.figure import Figure
from support.command_line import printed, refused

from fuzzyarm.cli import main
from fuzzyarm.eval.sweep import run

QUICK = ["--policy", "fuzzy-4", "--case", "nominal", "--plants", "6", "--chunk", "3", "--jobs", "1"]


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def assert_refused(capsys, folder, arguments, expected):
    """Check that a command ends with one line and exit code 2, and changes nothing."""
    before = contents(folder)
    error = refused(capsys, "sweep", *arguments, "--out", folder)
    assert error.startswith("fuzzyarm sweep: ") and expected in error, error
    assert contents(folder) == before


def empty_pages(monkeypatch, module, draw):
    """Draw the figures and write empty ones of their names: to lay out and to render them takes most of the time."""
    drawn = getattr(importlib.import_module(module), draw)
    monkeypatch.setattr(f"{module}.{draw}", lambda *given: {name: Figure() for name in drawn(*given)})


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished") / "sweep"
    with mock.patch("fuzzyarm.eval.sweep._figures.write_sweep_figures", return_value=[]):
        assert main(["sweep", *QUICK, "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def folder(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "sweep")


def test_a_sweep_prints_a_table_and_writes_everything(tmp_path, capsys, monkeypatch):
    empty_pages(monkeypatch, "fuzzyarm.eval.sweep._figures", "_draw_sweep")
    out = tmp_path / "new" / "sweep"
    text = printed(capsys, "sweep", *QUICK, "--bound", "5", "--worst", "2", "--out", out)
    assert "Case 1: nominal" in text and "success, below 5 mm [%]" in text and "\x1b" not in text
    figures = {f"{name}.{kind}" for name in ("spread", "map-fuzzy-4") for kind in ("png", "svg")}
    assert {path.name for path in out.iterdir()} == {"run.json", "chunks", "sweep.json", "episodes.npz"} | figures
    document = json.loads((out / "sweep.json").read_text())
    assert document["command"].startswith("fuzzyarm sweep --policy fuzzy-4") and document["versions"]["numpy"]
    (row,) = document["rows"]
    episodes = np.load(out / "episodes.npz", allow_pickle=False)
    assert row["success"]["value"] == np.mean(episodes["max_mm"][0, 0] < 5.0)
    assert len(row["worst"]) == 2 and row["worst"][0]["max_mm"] == episodes["max_mm"].max()


def test_json_is_the_summary_file_and_looking_at_a_sweep_anew_runs_nothing(folder, capsys, monkeypatch, undrawn):
    monkeypatch.setattr("fuzzyarm.eval.sweep.run._run_chunk", lambda *_: pytest.fail("all chunks are there"))
    before = contents(folder / "chunks")
    words = ["sweep", "--resume", "--bound", "6.5", "--worst", "1", "--json", "--out"]
    document = json.loads(printed(capsys, *words, folder))
    assert document == json.loads((folder / "sweep.json").read_text())
    assert document["config"]["bound"] == 6.5 and len(document["rows"][0]["worst"]) == 1
    assert contents(folder / "chunks") == before


def test_a_replay_gives_the_number_of_the_sweep(folder, capsys, monkeypatch):
    monkeypatch.setattr("fuzzyarm.eval.evaluation.figures._time_figures", lambda joints: {})  # the overview is enough
    empty_pages(monkeypatch, "fuzzyarm.eval.evaluation.figures", "draw_figures")
    worst = json.loads((folder / "sweep.json").read_text())["rows"][0]["worst"][0]
    out = printed(capsys, "sweep", "--replay", "fuzzy-4", "nominal", worst["plant"], "--out", folder)
    assert f"tip error up to {worst['max_mm']:.6g} mm" in out
    replayed = folder / f"replay-fuzzy-4-nominal-{worst['plant']}"
    episode = np.load(replayed / "episode.npz", allow_pickle=False)
    assert 1e3 * episode["tip_error"].max() == worst["max_mm"] and (replayed / "overview.png").exists()


def test_chunks_that_are_gone_are_run_and_those_of_another_sweep_are_named(folder, capsys, tmp_path, undrawn, short):
    (folder / "chunks" / "000001.npz").unlink()
    assert main(["sweep", "--resume", "--jobs", "1", "--out", str(folder)]) == 0
    other = tmp_path / "other"
    assert main(["sweep", *QUICK, "--seed", "1", "--out", str(other)]) == 0
    shutil.copy(other / "chunks" / "000000.npz", folder / "chunks")
    assert_refused(capsys, folder, ["--resume"], "belongs to a different sweep")


def run_file(old, new):
    """Return a change of the file that says what is run."""
    return lambda folder: (folder / "run.json").write_text((folder / "run.json").read_text().replace(old, new))


@pytest.mark.parametrize(
    ("change", "words", "expected"),
    [
        (lambda folder: None, QUICK, "already contains a sweep"),
        (lambda folder: None, ["--resume", "--plants", "7"], "choose another --out"),
        (lambda folder: None, ["--resume", "--policy", "fuzzy-2"], "choose another --out"),
        (lambda folder: None, ["--resume", "--robot", "cicese"], "with other settings ("),
        (lambda folder: (folder / "run.json").unlink(), QUICK, "remove this folder, or choose another --out"),
        (run_file('"plants": 6', '"plants": 5'), ["--resume"], "was changed"),
        (run_file("sweep/3", "sweep/1"), ["--resume"], "'fuzzyarm-sweep/1'; this version of fuzzyarm"),
        (lambda folder: os.truncate(folder / "chunks/000001.npz", 400), ["--resume"], "000001.npz is damaged"),
    ],
)
def test_what_does_not_belong_to_a_sweep_is_not_mixed_in(folder, capsys, change, words, expected):
    change(folder)
    assert_refused(capsys, folder, words, expected)


def test_versions_are_not_mixed(folder, capsys, monkeypatch):
    newer = run._made_with() | {"code": "another"}
    monkeypatch.setattr(run, "_made_with", lambda: newer)
    assert_refused(capsys, folder, ["--resume"], "or policy files (made_with: code ")


def test_without_ray_the_extra_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert_refused(capsys, tmp_path, [*QUICK, "--backend", "ray"], '-e ".[cluster]"')
    assert not list(tmp_path.iterdir())


# Policies that are the user's own code.
ONE_CHUNK = ["--case", "nominal", "--plants", "2", "--jobs", "1"]

LAW = """
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from {package}.gains import SHARE

class Soft(ComputedTorquePolicy):
    def predict(self, *given, **named):
        torque, state = super().predict(*given, **named)
        return SHARE * torque, state
"""
LOGGED = """
import os
with open(os.environ["IMPORTED_FROM"], "a") as file:
    file.write(__file__ + "\\n")
SHARE = {share}
"""


def package(folder, name, share=0.999):
    """Write a package of two modules with a policy, and return the policy's name."""
    (folder / name).mkdir(exist_ok=True)
    (folder / name / "__init__.py").write_text("")
    (folder / name / "law.py").write_text(LAW.format(package=name))
    (folder / name / "gains.py").write_text(LOGGED.format(share=share))
    return f"{name}.law:Soft"


@pytest.fixture
def imported(tmp_path, monkeypatch, undrawn):
    """Import from a folder of the test's; return the file that tells where the policy was imported from."""
    log = tmp_path / "imported.txt"
    log.touch()
    monkeypatch.setenv("IMPORTED_FROM", str(log))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return log


@pytest.mark.slow
def test_local_processes_run_a_policy_of_ones_own_with_the_numbers_of_one(imported, tmp_path):
    policy = package(tmp_path, "swept_locally")
    for jobs in ("1", "2"):
        words = ["--case", "nominal", "--plants", "4", "--chunk", "2", "--policy", "computed-torque", "--jobs"]
        assert main(["sweep", *words, jobs, "--policy", policy, "--out", jobs]) == 0
    found, other = (np.load(tmp_path / jobs / "episodes.npz") for jobs in ("1", "2"))
    assert all(np.array_equal(found[name], other[name]) for name in found.files)
    plain, own = found["max_mm"][:, 0]
    assert np.all(own != plain)  # each has its own numbers
    assert len(imported.read_text().splitlines()) >= 2  # by this process and by a worker
    assert main(["sweep", "--replay", policy, "nominal", "3", "--policy", policy, "--out", "1"]) == 0
    signals = np.load(tmp_path / "1" / "replay-swept_locally.law-Soft-nominal-3" / "episode.npz")
    assert 1e3 * signals["tip_error"].max() == own[3]


def test_code_that_only_the_folder_names_does_not_run(imported, tmp_path, capsys, short):
    policy = package(tmp_path, "swept_with_consent")
    assert main(["sweep", "--policy", policy, "--policy", "fuzzy-1", *ONE_CHUNK, "--out", "sweep"]) == 0
    for module in [name for name in sys.modules if name.partition(".")[0] == "swept_with_consent"]:
        del sys.modules[module]
    imported.write_text("")
    for arguments in (["--resume"], ["--replay", policy, "nominal", "0"], ["--resume", "--policy", "fuzzy-1"]):
        assert f"add --policy {policy}" in refused(capsys, "sweep", *arguments, "--out", "sweep")
    assert imported.read_text() == ""  # nothing was imported
    resumed = ["sweep", "--resume", "--out", "sweep", "--policy", policy]
    assert "contains a sweep with policies" in refused(capsys, *resumed, "--policy", "fuzzy-2")
    assert main(resumed) == main([*resumed, "--policy", "fuzzy-1"]) == 0


def test_code_that_changed_is_not_mixed_in(imported, tmp_path, capsys, short):
    policy = package(tmp_path, "swept_twice")
    assert main(["sweep", "--policy", policy, *ONE_CHUNK, "--out", "sweep"]) == 0
    package(tmp_path, "swept_twice", share=0.998)
    error = refused(capsys, "sweep", "--resume", "--policy", policy, "--out", "sweep")
    assert "or policy files (policies: swept_twice.law:Soft: swept_twice/gains.py" in error
