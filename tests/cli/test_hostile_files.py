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
import contextlib, io, json, os, shutil, time
from pathlib import Path
from fuzzyarm.cli.application import main
from fuzzyarm.policies.registry import POLICIES

learned, commands, files = POLICIES["ppo-nominal"].path, json.loads({commands!r}), json.loads({files!r})
for kind, make in files.items():
    folder = Path({folder!r}) / kind
    folder.mkdir()
    path = folder / "hostile.json"
    exec(make)
    for name, file in (("results", "results.json"), ("sweep", "run.json"), ("described", "policy.json")):
        (folder / name).mkdir()
        os.symlink(path, folder / name / file)
    shutil.copytree(learned, folder / "weighted")
    (folder / "weighted" / "weights.safetensors").unlink()
    os.symlink(path, folder / "weighted" / "weights.safetensors")
    shutil.copy(learned / "weights.safetensors", folder / "described")
    for name, words in commands.items():
        words = [word.format(file=path, folder=folder) for word in words]
        begun, error = time.process_time(), io.StringIO()
        with contextlib.redirect_stderr(error), contextlib.redirect_stdout(io.StringIO()):
            code = main(words)
        seconds = time.process_time() - begun
        # The largest memory of this program; `resource` would count that of the process that began it.
        status = Path("/proc/self/status").read_text() if os.path.exists("/proc/self/status") else "VmHWM: 0"
        memory = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
        print(json.dumps([kind, name, code, error.getvalue(), seconds, memory]), flush=True)
"""
MOST_MEMORY = 400_000  # KiB of the whole process, of which the interpreter and its libraries take 200,000


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """What came of every command with every file, one after the other in one process."""
    folder = str(tmp_path_factory.mktemp("hostile"))
    script = HARNESS.format(folder=folder, commands=json.dumps(READERS), files=json.dumps(FILES))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    return [json.loads(line) for line in done.stdout.splitlines()], done.stderr


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", FILES)
def test_a_file_that_never_ends_or_explodes_is_refused_by_every_command(outcomes, kind):
    lines, errors = outcomes
    found = [line for line in lines if line[0] == kind]
    assert [line[1] for line in found] == list(READERS), errors[-3000:]
    for _, name, code, error, seconds, memory in found:
        assert code == 2, (name, error)
        assert error.count("\n") == 1 and "Traceback" not in error and len(error) < 1500, (name, error)
        assert seconds < 10.0, name  # of processor time, the imports of the command included
        assert memory < MOST_MEMORY, name
