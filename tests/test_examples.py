"""The examples of training: they run without warnings, leave no files, and learn what their docstrings state."""

import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from fuzzyarm.policies import resolve

EXAMPLES = Path(__file__).parent.parent / "examples"
SCRIPTS = sorted(path.name for path in EXAMPLES.glob("train_*.py"))


@pytest.fixture
def run(monkeypatch, tmp_path, capsys):
    """Run a script with arguments in an empty folder, on the CPU; return the tip errors [mm] it prints."""
    threads = torch.get_num_threads()
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)  # else the step is compiled, for minutes
    monkeypatch.chdir(tmp_path)

    def call(script, *arguments):
        monkeypatch.setattr(sys, "argv", [script, *arguments])
        runpy.run_path(str(EXAMPLES / script), run_name="__main__")
        return [float(number) for number in re.findall(r"mean tip error (\S+) mm", capsys.readouterr().out)]

    yield call
    torch.set_num_threads(threads)


@pytest.mark.parametrize("script", SCRIPTS)
def test_wrong_numbers_of_steps_are_refused(script, run, capsys):
    for wrong in ("-5", "1.5"):
        with pytest.raises(SystemExit) as stopped:
            run(script, wrong)
        message = capsys.readouterr().err
        assert stopped.value.code == 2 and "steps" in message and wrong in message
        assert "allowed: 1, 2, 3, ..." in message or "int value" in message


@pytest.mark.parametrize("script", ["clone_policy.py", "offline_td3_bc.py"])
def test_a_data_set_that_does_not_fit_is_refused_in_one_line(script, run, monkeypatch, tmp_path, capsys):
    monkeypatch.syspath_prepend(EXAMPLES)  # as if it were run by its path: one imports the other
    for words, installed, message in (
        ([], True, "is not a data set; fuzzyarm dataset --out DIR writes one"),
        (["--seconds", "0"], True, "seconds = 0.0 is out of range; allowed: more than 0"),
        ([], False, 'pip install -c constraints.txt -e ".[datasets]"'),
    ):
        for name in ("h5py", "minari"):
            if installed:
                pytest.importorskip(name)
            else:
                monkeypatch.setitem(sys.modules, name, None)
        with pytest.raises(SystemExit) as stopped:
            run(script, str(tmp_path), *words)
        error = capsys.readouterr().err
        assert stopped.value.code == 2
        assert error.startswith(f"{script}: ") and error.endswith(f"{message}\n") and error.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "words", "first", "last"),
    [
        ("train_torch.py", (), 500.0, 30.0),
        ("train_gradients.py", ("12000", "--eager"), 100.0, 50.0),
    ],
)
def test_they_learn(script, words, first, last, run, tmp_path):
    """Several times the worst of three seeds: another machine rounds otherwise, and so learns otherwise."""
    errors = run(script, *words)
    assert errors[0] > first and errors[-1] < last
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("script", "words", "name"),
    [
        ("train_sb3.py", ("2048", "--out"), "sb3:model.zip"),
        ("ppo_one_file.py", ("--minutes", "0.01", "--out"), "model"),
        ("sb3_tuned.py", ("--minutes", "0.01", "--out"), "model"),
    ],
)
def test_what_the_learning_examples_write_is_a_policy(script, words, name, run, tmp_path):
    run(script, *words, str(tmp_path / name))
    spec = resolve(f"sb3:{tmp_path / name}" if name.endswith(".zip") else str(tmp_path / name), run_code=True)
    torque, _ = spec.load().predict(np.zeros((3, 10)))
    assert torque.shape == (3, 2) and np.isfinite(torque).all()
