"""Files that never end or explode, given to each command that reads one: one line, and little time and memory."""

import json
import subprocess
import sys

import pytest

READERS = {
    "verify": ["verify", "{file}"],
    "robot of an evaluation": ["evaluate", "--robot", "{file}", "--out", "{folder}/out"],
    "robot of a design": ["design", "--robot", "{file}", "--out", "{folder}/out.json"],
    "controller": ["evaluate", "--policy", "{file}", "--out", "{folder}/out"],
    "check": ["evaluate", "--check", "{file}"],
    "leaderboard": ["leaderboard", "{file}"],
    "report": ["report", "{folder}/results"],
    "sweep": ["sweep", "--resume", "--out", "{folder}/sweep"],
    "description": ["evaluate", "--policy", "{folder}/described", "--out", "{folder}/out"],
    "weights": ["evaluate", "--policy", "{folder}/weighted", "--out", "{folder}/out"],
}
FILES = {
    "pipe": "os.mkfifo(path)",
    "endless": "os.symlink('/dev/zero', path)",
    "random": "os.symlink('/dev/urandom', path)",
    "terminal": "os.symlink('/dev/tty', path)",
    "itself": "os.symlink(path, path)",
    "folder": "os.mkdir(path)",
    "sparse": "open(path, 'wb').truncate(10**12)",
    "brackets": "open(path, 'w').write('[' * 60_000_000)",
    "empty lists": "open(path, 'w').write('[' + '[],' * 5_000_000 + '[]]')",
    "deep": "open(path, 'w').write('[' * 100_000 + ']' * 100_000)",
    "deep mappings": "open(path, 'w').write('{\"a\":' * 50_000)",
    "deep table": "open(path, 'w').write('mass = ' + '[' * 100_000)",
    "dotted": "open(path, 'w').write('.'.join('a' * 60_000) + ' = 1')",
    "same key": "open(path, 'w').write('{\"schema\": 1, \"schema\": 2}')",
    "many keys": "open(path, 'w').write('{' + ','.join('\"%d\":1' % k for k in range(200_000)) + ',\"199999\":1}')",
    "long number": "open(path, 'w').write('{\"a\": ' + '9' * 10_000_000 + '}')",
    "surrogate": "open(path, 'w').write('{\"\\\\ud800\": \"\\\\udfff\"}')",
    "no text": "open(path, 'wb').write(b'\\xff\\xfe' * 1000)",
}
HARNESS = """
import contextlib, io, json, os, resource, shutil, sys, time
from pathlib import Path
from fuzzyarm.cli.application import main
from fuzzyarm.learned_policy.policy import LearnedPolicy
from fuzzyarm.policies.registry import POLICIES

folder, commands = Path({folder!r}), json.loads({commands!r})
path = folder / "hostile.json"
{make}
for name, file in (("results", "results.json"), ("sweep", "run.json"), ("described", "policy.json")):
    (folder / name).mkdir()
    os.symlink(path, folder / name / file)
shutil.copytree(POLICIES["ppo-nominal"].path, folder / "weighted")
(folder / "weighted" / "weights.safetensors").unlink()
os.symlink(path, folder / "weighted" / "weights.safetensors")
shutil.copy(POLICIES["ppo-nominal"].path / "weights.safetensors", folder / "described")
for name, words in commands.items():
    words = [word.format(file=path, folder=folder) for word in words]
    begun, error = time.process_time(), io.StringIO()
    with contextlib.redirect_stderr(error), contextlib.redirect_stdout(io.StringIO()):
        code = main(words)
    print(json.dumps([name, code, error.getvalue(), time.process_time() - begun]))
print(json.dumps(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss))
"""
MOST_MEMORY = 400_000  # KiB of the whole process, of which the interpreter and its libraries take 200,000
BASE = 'open(path, "w").write("")'


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.timeout(300)
def test_a_file_that_never_ends_or_explodes_is_refused_by_every_command(tmp_path, kind):
    script = HARNESS.format(folder=str(tmp_path), commands=json.dumps(READERS), make=FILES[kind])
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=250, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    *lines, memory = map(json.loads, done.stdout.splitlines())
    assert len(lines) == len(READERS)
    for name, code, error, seconds in lines:
        assert code == 2, (name, error)
        assert error.count("\n") == 1 and "Traceback" not in error and len(error) < 1500, (name, error)
        assert seconds < 10.0, name  # of processor time, the imports of the command included
    assert memory < MOST_MEMORY
