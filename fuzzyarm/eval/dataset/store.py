"""Data sets of episodes: recorded in batches, and stored by Minari, numbers in HDF5 and metadata as text.

A folder of data sets is Minari's root: with ``MINARI_DATASETS_PATH=FOLDER``, `minari.load_dataset` finds them.
"""

import contextlib
import dataclasses
import json
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import instance, shown
from fuzzyarm.common.documents import DocumentError, open_regular, parse_json, read_json
from fuzzyarm.envs.observation import ACTION_SCALE
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.dataset.config import CONDITIONS, VERSION, Condition, DatasetConfig
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.score import ANCHORS, closeness
from fuzzyarm.fuzzy_policy.policy import Predictor
from fuzzyarm.policies import load_policy
from fuzzyarm.policies.spec import resolve

__all__ = ["check_installed", "open_dataset", "provenance_of", "record", "score_of", "write_dataset"]

_SCHEMA, _KEY, _DATA = f"fuzzyarm-dataset/{VERSION}", "fuzzyarm", "data"
_LANES = 64  # episodes that are recorded simultaneously


@dataclasses.dataclass(frozen=True, eq=False)
class _Episode:
    """One recorded episode of T control steps."""

    seed: int  # of the environment's reset
    observations: np.ndarray  # (T + 1, 10), the last one after the last step
    actions: np.ndarray  # (T, 2) torques of the steps, with noise, float32 as the action space declares [N m]
    intended: np.ndarray  # (T, 2) torques of the policy without noise, within the limits [N m]
    rewards: np.ndarray  # (T,)
    tip_errors: np.ndarray  # (T,) after each step [m]
    completed: bool  # whether the reference was followed to its end


def record(policy: Predictor, condition: Condition, count: int, seed: int, noise: float = 0.0) -> Iterator[_Episode]:
    """Yield `count` episodes of a policy at 1 kHz; episode i is reset with seed + i.

    The torques carry Gaussian noise, whose standard deviation is `noise` times their limits.
    """
    for first in range(0, count, _LANES):
        yield from _batch(policy, condition, min(_LANES, count - first), seed + first, noise)


def _batch(policy: Predictor, condition: Condition, lanes: int, seed: int, noise: float) -> Iterator[_Episode]:
    """Yield one episode per lane; lane i is reset with seed + i.

    The torques carry Gaussian noise, whose standard deviation is `noise` times their limits.
    """
    envs, generator = FuzzyArmVectorEnv(lanes, **CONDITIONS[condition], threads=1), np.random.default_rng([seed, lanes])
    intended, actions = list[np.ndarray](), list[np.ndarray]()

    def actuate(torque: np.ndarray) -> np.ndarray:
        intended.append(np.clip(torque, -ACTION_SCALE, ACTION_SCALE))
        noisy = (
            intended[-1] + noise * ACTION_SCALE * generator.normal(size=torque.shape) if noise > 0.0 else intended[-1]
        )
        actions.append(np.clip(noisy, -ACTION_SCALE, ACTION_SCALE).astype(np.float32))
        return actions[-1]

    start = envs.reset(seed=seed)
    steps = list(episodes(envs, policy, start, actuate=actuate))
    envs.close()
    rewards, errors = [step.reward for step in steps], [step.info["tip_error"] for step in steps]
    rows = [np.stack(part, axis=1) for part in (actions, intended, rewards, errors)]
    seen = np.stack([start[0], *(step.observation for step in steps)], axis=1)
    completed = np.any([step.completed for step in steps], axis=0).tolist()
    lengths = np.sum([step.running for step in steps], axis=0).tolist()
    for lane, length in enumerate(lengths):
        done, wanted, earned, error = (row[lane, :length] for row in rows)
        yield _Episode(seed + lane, seen[lane, : length + 1], done, wanted, earned, error, completed[lane])


def score_of(recorded: Sequence[_Episode], condition: Condition) -> tuple[float, dict[str, float]]:
    """Return the score N of episodes with successive seeds, and the mean returns of `ANCHORS` in the same episodes.

    N = 100 (S - S_c)/(S_o - S_c) with the mean S of `fuzzyarm.eval.score`, S_c for computed-torque and S_o for
    learned-observer, without noise on the same arms, loads and paths, because episodes differ in difficulty.
    """
    seed, count = recorded[0].seed, len(recorded)
    anchors = {name: list(record(load_policy(name), condition, count, seed)) for name in ANCHORS}
    runs = [recorded, *anchors.values()]
    steps = [max(len(one.rewards) for one in same) for same in zip(*runs, strict=True)]  # of the longest of these runs
    own, low, high = (
        np.mean([closeness(one.tip_errors).sum() / count for one, count in zip(run, steps, strict=True)])
        for run in runs
    )
    returns = {name: float(np.mean([one.rewards.sum() for one in run])) for name, run in anchors.items()}
    return float(100.0 * (own - low) / (high - low)), returns


def check_installed() -> None:
    """Raise ValueError, with the install command, if Minari or its storage library is missing."""
    try:
        import h5py  # noqa: F401
        import minari  # noqa: F401
    except ModuleNotFoundError as error:
        raise ValueError(
            f"{error.name} is not installed; to use data sets, run in the repository: "
            'pip install -c constraints.txt -e ".[datasets]"'
        ) from None


def write_dataset(config: DatasetConfig, root: Path, advance: Callable[..., None] = lambda **_: None) -> Path:
    """Record a data set, write it into an existing folder of data sets, whole or not at all, and return its folder.

    `advance` is called with ``completed``, the number of episodes so far. ValueError: the name exists, Minari is not
    installed, or a policy cannot be loaded.
    """
    check_installed()
    import gymnasium as gym
    import minari

    folder = root / config.name
    if folder.exists():
        raise ValueError(f"{folder} already exists; choose another folder, or remove it")
    recorded = list[_Episode]()
    for policy, count in config.shares.items():
        for episode in record(load_policy(policy), config.condition, count, config.seed + len(recorded), config.noise):
            recorded.append(episode)
            advance(completed=len(recorded))
    score, returns = score_of(recorded, config.condition)
    provenance = {
        "schema": _SCHEMA,
        "settings": dataclasses.asdict(config),
        "policies": {name: resolve(name).files() for name in config.shares},
        "episodes": config.shares,
        "N": score,
        "reference_returns": returns,
        **current_provenance(),
    }
    low, high = returns.values()
    with tempfile.TemporaryDirectory(prefix=".dataset.", dir=root.absolute()) as work, _writing(Path(work)):
        dataset = minari.create_dataset_from_buffers(
            config.name,
            [_buffer(number, episode) for number, episode in enumerate(recorded)],
            env=gym.make("FuzzyArm-v0", **CONDITIONS[config.condition]).spec,
            algorithm_name=", ".join(config.shares),
            author="FuzzyArm",
            description=f"Torques of {', '.join(config.shares)} on FuzzyArm-v0, condition {config.condition}.",
            ref_min_score=low,
            ref_max_score=high,
            num_episodes_average_score=len(recorded),
            requirements=["fuzzyarm"],
            data_format="hdf5",
        )
        dataset.storage.update_metadata({_KEY: json.dumps(provenance)})
        folder.parent.mkdir(parents=True, exist_ok=True)
        for part in Path(work, config.name).parent.iterdir():
            if part.is_file() and not (folder.parent / part.name).exists():
                shutil.copy(part, folder.parent / part.name)  # Minari's file about the namespace
        os.rename(Path(work, config.name), folder)
    return folder


def open_dataset(folder: str | Path) -> Any:
    """Return the `minari.MinariDataset` of a folder that `write_dataset` wrote.

    The data set names the policies and the environment only as text; nothing is imported or run.

    Raises:
        DocumentError: the folder has no data set, or one that is damaged or of another version.
        ValueError: Minari is not installed.
    """
    check_installed()
    import h5py
    import minari

    path = Path(folder)
    if not (path / _DATA).is_dir():
        raise DocumentError(f"{path} is not a data set; fuzzyarm dataset --out DIR writes one")
    try:
        read_json(path / _DATA / "metadata.json")
        open_regular(path / _DATA / "main_data.hdf5").close()  # HDF5 would wait for the writer of a pipe
        dataset = minari.MinariDataset(path / _DATA)
        with h5py.File(path / _DATA / "main_data.hdf5") as file:  # Minari reads it with the first episode
            if len(file) != dataset.total_episodes:
                raise ValueError(f"it contains {len(file)} of {dataset.total_episodes} episodes")
        found = dataset.storage.metadata.get(_KEY)
    except (AssertionError, AttributeError, KeyError, OSError, RuntimeError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise DocumentError(f"{path} is damaged, or not in Minari's format ({reason}); write it again") from None
    if found is None:
        raise DocumentError(f"{path} was not written by fuzzyarm dataset; write one with fuzzyarm dataset --out DIR")
    try:
        schema = instance("metadata", parse_json(found), dict).get("schema")
    except (AttributeError, TypeError, ValueError):
        raise DocumentError(f"{path} does not state how it was made; write the data set again") from None
    if schema != _SCHEMA:
        raise DocumentError(
            f"{path} has the format {shown(schema)}; this package reads {_SCHEMA}. Write the data set again"
        )
    return dataset


def provenance_of(dataset: Any) -> dict[str, Any]:
    """Return how a data set of `open_dataset` was made: settings, policies with digests, scores and versions."""
    found: dict[str, Any] = json.loads(dataset.storage.metadata[_KEY])
    return found


def _buffer(number: int, episode: _Episode) -> Any:
    """Return an episode in Minari's form, with `number` as its id."""
    from minari.data_collector import EpisodeBuffer

    ended = [False] * (len(episode.rewards) - 1)
    return EpisodeBuffer(
        id=number,
        seed=episode.seed,
        observations=episode.observations,
        actions=episode.actions,
        rewards=episode.rewards.tolist(),
        terminations=[*ended, not episode.completed],
        truncations=[*ended, episode.completed],
        infos={"tip_error": episode.tip_errors, "intended_action": episode.intended},
    )


@contextlib.contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Context in which Minari writes to a folder, without its warnings about missing metadata, such as e-mail."""
    name = "MINARI_DATASETS_PATH"
    before = os.environ.get(name)
    os.environ[name] = str(folder)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=r".*is set to None", category=UserWarning)
            yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
