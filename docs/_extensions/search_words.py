"""Words that readers type into the search box, and the page that answers them: each leads to its page first."""

from __future__ import annotations

from typing import Any

from sphinx.application import Sphinx

WORDS = {
    "install": "install, getting started, quickstart, license, licence, cite, bibtex, citation",
    "tutorials/first-episode": "first episode, run episode, save video, record video, save gif, gym.make",
    "environment/spaces": "observation, observation space, action space, reward, info, spaces, termination",
    "environment/cases": "delay, latency, payload, force, noise, randomisation, randomization, domain randomization, "
    "domain randomisation, disturbance",
    "tutorials/own-task": "own task, custom task, new task, custom environment",
    "tutorials/own-controller": "my controller, custom controller, own controller, new controller",
    "tutorials/own-arm": "my arm, custom arm, own arm, custom robot",
    "tutorials/identify": "log, recorded log, identification, system identification, rosbag",
    "tutorials/train": "train, training, ppo, sb3, stable-baselines3, stable baselines, torchrl, rsl_rl, rsl-rl, "
    "cleanrl",
    "results/leaderboard": "challenge, leaderboard, submit, score, ranking",
    "theory/certificate": "proven, what is proven, proof, certificate, guarantee, stability",
    "controllers/choose": "which controller, choose controller, best controller",
    "controllers/export": "export, c export, c code, fmu, simulink, onnx, spaceex, hybrid automaton",
    "results/index": "results, benchmark, benchmark results",
    "paper/index": "paper, the paper, reproduce paper, reproduction",
}


def setup(app: Sphinx) -> dict[str, Any]:
    """Register what adds the words to the pages."""
    app.connect("source-read", _with_words)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _with_words(app: Sphinx, page: str, source: list[str]) -> None:
    """Put main entries of the index below the title; the search ranks them by the share that was typed."""
    if page in WORDS:
        entries = "".join(f"```{{index}} ! {word}\n```\n" for word in WORDS[page].split(", "))
        head, title, rest = source[0].partition("\n# " if not source[0].startswith("# ") else "# ")
        heading, _, body = rest.partition("\n")
        source[0] = f"{head}{title}{heading}\n\n{entries}{body}"
