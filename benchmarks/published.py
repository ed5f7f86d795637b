"""What each stored result and each figure was made with, and whether the shipped policies are still those.

`published.json` beside this file holds the digest of every result and every figure, and of every shipped policy in it
what the policy was then:

- the SHA-256 of its files, as `PolicySpec.files` has them. Of a result they are those of the commits that its rows
  name, read from the history; of a figure those that it was drawn with.
- of a law in the package's code, which has no file, the tip errors that `results/evaluate.json` has for it: in each
  case the root mean square and the largest [mm]. Another test keeps them equal to those of today's code.

`differences` compares the record with today's files; `python benchmarks/readme.py` writes it.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
import re
import shutil
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from figures import Picture

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.policies import NAMES, Kind, resolve

__all__ = ["RECORD", "content_digest", "differences", "figure_record", "identity", "publish", "result_record"]

ROOT = Path(__file__).resolve().parents[1]
RESULTS, FIGURES = ROOT / "benchmarks" / "results", ROOT / "docs" / "figures"
RECORD = ROOT / "benchmarks" / "published.json"
# Where trained policies lie, and where they lay when some results were measured.
MOVED = ("fuzzyarm/fuzzy_policy/laws/learned/", "fuzzyarm/learned_policy/")
EVALUATION, CONTROLLERS = RESULTS / "evaluate.json", ROOT / "fuzzyarm" / "fuzzy_policy" / "controllers"
SAME = 1e-3
"""Relative difference up to which the tip errors of a law are the same."""
ADAPTIVE = "adaptive-observer"
SHOWN: dict[str, tuple[str, ...]] = {
    "accuracy": ("computed-torque",),
    "adaptive_margins": (ADAPTIVE,),
    "estimate_front": ("elastic-observer", ADAPTIVE, "learned-observer"),
    "own_arms": (),
}
"""Shipped policies in results that do not name them; those of `own_arms` are named alike, but tuned for other arms."""


def content_digest(content: bytes) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(content).hexdigest()


def identity(name: str) -> dict[str, Any]:
    """Return what a shipped policy is today: the digests of its files, or the errors of its law."""
    if resolve(name).kind is Kind.LAW:
        return _law(name, json.loads(EVALUATION.read_text(encoding="utf-8")))
    return {"files": resolve(name).files()}


def result_record(path: Path) -> dict[str, Any]:
    """Return the digest of a stored result, and the policies by commit; ValueError if it names no commit."""
    content, made = path.read_bytes(), dict[str, set[str]]()
    document = json.loads(content)
    for commit, names in _parts(document, ()):
        made.setdefault(commit, set()).update(names)
    if not made:
        raise ValueError(f"{path.name} names no commit, so that its policies are unknown; measure it in a checkout")
    if path.stem in SHOWN:
        made = {commit: set(SHOWN[path.stem]) for commit in made}
    policies = {
        commit: {name: _identity_at(_in_history(commit, path), name) for name in sorted(names)}
        for commit, names in made.items()
    }
    return {"sha256": content_digest(content), "policies": policies}


def figure_record(content: bytes, results: Iterable[str], policies: Iterable[str]) -> dict[str, Any]:
    """Return the record of a figure that was drawn from results, and from runs of policies, as they are now."""
    return {
        "sha256": content_digest(content),
        "results": {name: content_digest((RESULTS / f"{name}.json").read_bytes()) for name in results},
        "policies": {name: identity(name) for name in policies},
    }


def publish(pictures: Mapping[str, Picture]) -> None:
    """Draw all figures but those of finished studies, and write them and the record.

    Raises:
        ValueError: a figure is not as in the record and cannot be drawn again: it is of a finished study, or shows a
            page, and Chromium is not installed.
    """
    before = json.loads(RECORD.read_text(encoding="utf-8"))["figures"] if RECORD.exists() else {}
    figures = {}
    for name, picture in pictures.items():
        path = FIGURES / name
        browser = shutil.which("chromium") or shutil.which("chromium-browser")
        kept = picture.draw is None or (picture.browser and not browser)
        content = picture.draw() if picture.draw and not kept else path.read_bytes()
        figures[name] = figure_record(content, picture.results, picture.policies)
        if kept and figures[name] != before.get(name):
            how = "install Chromium" if picture.draw else "its study is finished: remove the figure or repeat the study"
            raise ValueError(f"{name} is older than what it shows; {how}")
        write_atomically(path, content)
        print(f"docs/figures/{name}", flush=True)
    results = {path.stem: result_record(path) for path in sorted(RESULTS.glob("*.json"))}
    write_atomically(RECORD, json.dumps({"results": results, "figures": figures}, indent=1) + "\n")


def differences(record: Mapping[str, Any]) -> list[str]:
    """Return a line for each file that is not that of the record, and each policy that is not what it was then."""
    found = []
    for kind, folder, ending in (("results", RESULTS, ".json"), ("figures", FIGURES, "")):
        files = {path.name.removesuffix(ending) if ending else path.name: path for path in folder.iterdir()}
        found += [f"{name} is not in the record" for name in sorted(files.keys() - record[kind].keys())]
        for name, entry in record[kind].items():
            if name not in files or content_digest(files[name].read_bytes()) != entry["sha256"]:
                found.append(f"{name} is not the file of the record")
    for name, entry in record["results"].items():
        for commit, policies in entry["policies"].items():
            found += [f"{name}, commit {commit[:10]}, {line}" for line in _changed(policies)]
    for name, entry in record["figures"].items():
        found += [f"{name}, {line}" for line in _changed(entry["policies"])]
        found += [
            f"{name} shows an older {result}.json"
            for result, then in entry["results"].items()
            if record["results"].get(result, {}).get("sha256") != then
        ]
    return found


def _changed(policies: Mapping[str, Mapping[str, Any]]) -> list[str]:
    return [f"{name}: the policy was another one" for name, then in policies.items() if not _same(identity(name), then)]


def _same(now: Mapping[str, Any], then: Mapping[str, Any]) -> bool:
    if "tip_errors_mm" in now and "tip_errors_mm" in then:
        pairs = zip(now["tip_errors_mm"], then["tip_errors_mm"], strict=True)
        return all(math.isclose(one, other, rel_tol=SAME) for one, other in pairs)
    return now == then


def _law(name: str, evaluation: Mapping[str, Any]) -> dict[str, Any]:
    """Return the errors of a law in a stored evaluation; KeyError if it lacks the law."""
    rows = {(row["policy"], row["case"]): row for row in evaluation["results"]}
    keys = ("tip_error_rms_mm", "tip_error_max_mm")
    return {"tip_errors_mm": [float(f"{rows[name, case][key]:.4g}") for case in PAPER_CASES for key in keys]}


def _parts(part: Any, commits: Sequence[str]) -> Iterator[tuple[str, set[str]]]:
    """Yield names of policies in a part of a result, with each commit that the part names, or else that above it."""
    if isinstance(part, Mapping):
        made = part.get("provenance", part)
        if isinstance(made.get("commit"), str):
            commits = [made["commit"]]
        commits = part.get("commits", commits)
        for key, value in part.items():
            if key not in ("command", "versions"):
                yield from ((commit, _named(key)) for commit in commits)
                yield from _parts(value, commits)
    elif isinstance(part, list):
        for value in part:
            yield from _parts(value, commits)
    elif isinstance(part, str):
        yield from ((commit, _named(part)) for commit in commits)


def _named(text: str) -> set[str]:
    return set(re.findall(r"[\w-]+", text)) & set(NAMES)


def _in_history(commit: str, path: Path) -> str:
    """Return a commit without what was changed beside it; if the history lacks it, the one that stored the result."""
    clean = commit.partition("+")[0]
    if _git("cat-file", "-e", f"{clean}^{{commit}}") is not None:
        return clean
    return (_git("log", "-1", "--format=%H", "--", str(path)) or b"").decode().strip()


@functools.cache
def _identity_at(commit: str, name: str) -> dict[str, Any]:
    """Return what a policy was at a commit; of a law by the evaluation of then, or the first after it."""
    if resolve(name).kind is Kind.LAW:
        evaluation = EVALUATION.relative_to(ROOT).as_posix()
        later = _git("log", "--reverse", "--format=%H", f"{commit}..HEAD", "--", evaluation) or b""
        for one in (commit, *later.decode().split()):
            try:
                return _law(name, json.loads(_git("show", f"{one}:{evaluation}") or b'{"results": []}'))
            except KeyError:
                continue
    return {"files": {file: _digest_at(commit, place) for file, place in _places(name).items()}}


def _places(name: str) -> dict[str, str]:
    """Return where in the repository the files of a shipped policy lie, by their names."""
    own, places = resolve(name).path, {}
    assert own is not None
    for file in resolve(name).files():
        path = own / file if (own / file).is_file() else CONTROLLERS / file
        places[file] = path.relative_to(ROOT).as_posix()
    return places


def _digest_at(commit: str, place: str) -> str | None:
    content = _git("show", f"{commit}:{place}") or _git("show", f"{commit}:{place.replace(*MOVED)}")
    return None if content is None else content_digest(content)


@functools.cache
def _git(*arguments: str) -> bytes | None:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, timeout=60)
    return done.stdout if done.returncode == 0 else None
