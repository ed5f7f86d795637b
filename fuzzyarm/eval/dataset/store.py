"""Data sets on disk, written and read by Minari: HDF5 with numbers, and metadata as text.

A folder is what Minari calls its root: ``MINARI_DATASETS_PATH=FOLDER`` makes `minari.load_dataset` find what is in it.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import instance, shown
from fuzzyarm.common.documents import open_regular, parse_json, read_json
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.dataset.config import CONDITIONS, EXPERT, VERSION, DatasetConfig
from fuzzyarm.eval.dataset.recording import Episode, RandomTorques, mean_return, record
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.policies import load_policy
from fuzzyarm.policies.spec import resolve

__all__ = ["DatasetError", "check_installed", "open_dataset", "provenance_of", "write_dataset"]

_SCHEMA, _KEY, _DATA = f"fuzzyarm-dataset/{VERSION}", "fuzzyarm", "data"
_SCORED, _SCORED_SEED = 64, 1_000_000_000  # episodes behind a reference score, of seeds that no data set begins with


class DatasetError(ValueError):
    """A data set is missing, damaged or of another version; the message is one line that says what to do."""


def check_installed() -> None:
    """Raise ValueError with the way out if Minari, or what it stores with, is not installed."""
    try:
        import h5py  # noqa: F401
        import minari  # noqa: F401
    except ModuleNotFoundError as error:
        raise ValueError(
            f"{error.name} is not installed; for data sets, run in the repository: "
            'pip install -c constraints.txt -e ".[datasets]"'
        ) from None


def write_dataset(config: DatasetConfig, root: Path, advance: Callable[..., None] = lambda **_: None) -> Path:
    """Record a data set, write it into an existing folder of data sets, whole or not at all, and return its folder.

    `advance` is called with ``completed``, the number of episodes so far. ValueError: there is one of that name, Minari
    is not installed, or a policy cannot be loaded.
    """
    check_installed()
    import gymnasium as gym
    import minari

    folder = root / config.name
    if folder.exists():
        raise ValueError(f"{folder} is there already; choose another folder, or remove it")
    buffers, provenance = list[Any](), _provenance(config)
    for policy, count in config.shares.items():
        for episode in record(load_policy(policy), config.condition, count, config.seed + len(buffers), config.noise):
            buffers.append(_buffer(len(buffers), episode))
            advance(completed=len(buffers))
    low, high = provenance["reference_scores"].values()
    with tempfile.TemporaryDirectory(prefix=".dataset.", dir=root.absolute()) as work, _writing(Path(work)):
        dataset = minari.create_dataset_from_buffers(
            config.name,
            buffers,
            env=gym.make("FuzzyArm-v0", **CONDITIONS[config.condition]).spec,
            algorithm_name=", ".join(config.shares),
            author="FuzzyArm",
            description=f"Torques of {', '.join(config.shares)} on FuzzyArm-v0, condition {config.condition}.",
            ref_min_score=low,
            ref_max_score=high,
            num_episodes_average_score=_SCORED,
            requirements=["fuzzyarm"],
            data_format="hdf5",
        )
        dataset.storage.update_metadata({_KEY: json.dumps(provenance)})
        folder.parent.mkdir(parents=True, exist_ok=True)
        for part in Path(work, config.name).parent.iterdir():
            if part.is_file() and not (folder.parent / part.name).exists():
                shutil.copy(part, folder.parent / part.name)  # what Minari says of the name before the slash
        os.rename(Path(work, config.name), folder)
    return folder


def open_dataset(folder: str | Path) -> Any:
    """Return the `minari.MinariDataset` of a folder that `write_dataset` wrote.

    The names of policies and the environment in it are text; nothing of them is imported or run.

    Raises:
        DatasetError: there is none, it is damaged, or it is of another version.
        ValueError: Minari is not installed.
    """
    check_installed()
    import h5py
    import minari

    path = Path(folder)
    if not (path / _DATA).is_dir():
        raise DatasetError(f"{path} is no data set; fuzzyarm dataset --out DIR writes one")
    try:
        read_json(path / _DATA / "metadata.json")
        open_regular(path / _DATA / "main_data.hdf5").close()  # HDF5 would wait for the writer of a pipe
        dataset = minari.MinariDataset(path / _DATA)
        with h5py.File(path / _DATA / "main_data.hdf5") as file:  # which Minari reads with the first episode
            if len(file) != dataset.total_episodes:
                raise ValueError(f"{len(file)} of {dataset.total_episodes} episodes")
        found = dataset.storage.metadata.get(_KEY)
    except (AssertionError, AttributeError, KeyError, OSError, RuntimeError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise DatasetError(f"{path} is no data set that Minari can read ({reason}); write it again") from None
    if found is None:
        raise DatasetError(f"{path} was not written by fuzzyarm dataset")
    try:
        schema = instance("metadata", parse_json(found), dict).get("schema")
    except (AttributeError, TypeError, ValueError):
        raise DatasetError(f"{path} does not say where it comes from; write it again") from None
    if schema != _SCHEMA:
        raise DatasetError(f"{path} is of another version, {shown(schema)}; this one reads {_SCHEMA}: write it again")
    return dataset


def provenance_of(dataset: Any) -> dict[str, Any]:
    """Return what a data set of `open_dataset` says of itself: settings, policies with digests, scores, versions."""
    found: dict[str, Any] = json.loads(dataset.storage.metadata[_KEY])
    return found


def _buffer(number: int, episode: Episode) -> Any:
    """Return an episode as Minari takes it; its lists may be arrays."""
    from minari.data_collector import EpisodeBuffer

    steps = len(episode.rewards)
    ended = [False] * (steps - 1)
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


def _provenance(config: DatasetConfig) -> dict[str, Any]:
    limit = np.array(ArmParameters().torque_limit)
    scored = RandomTorques(limit, _SCORED_SEED), load_policy(EXPERT)
    random, expert = (mean_return(policy, config.condition, _SCORED, _SCORED_SEED) for policy in scored)
    return {
        "schema": _SCHEMA,
        "settings": {name: getattr(config, name) for name in ("level", "condition", "episodes", "noise", "seed")},
        "policies": {name: resolve(name).files() for name in config.shares},
        "episodes": config.shares,
        "reference_scores": {"random torques": random, EXPERT: expert},
        **current_provenance(),
    }


@contextlib.contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Let Minari write to a folder, without warnings of what is left out: address of the code, e-mail, environment."""
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
