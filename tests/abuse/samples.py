"""Good files of every format, made once in a process, and a place for changed copies."""

from __future__ import annotations

import atexit
import dataclasses
import functools
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from scipy.io import savemat
from support.bags import write_bag
from support.trainings import SMALL_TRAINING

import fuzzyarm
from fuzzyarm import ArmParameters, EvaluationConfig, SweepConfig, robot_named
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.eval.dataset import store
from fuzzyarm.eval.dataset.config import DatasetConfig
from fuzzyarm.eval.episodes.rollout_file import write_rollouts
from fuzzyarm.eval.sweep._distributions import plant_record
from fuzzyarm.eval.sweep._episodes import SweepResults
from fuzzyarm.eval.sweep.summary import summarise
from fuzzyarm.eval.tuning import _finding as finding
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights
from fuzzyarm.fuzzy_policy.scheduled_controller import Premise, ScheduledController
from fuzzyarm.fuzzy_policy.signed_files import _digest_of as digest_of
from fuzzyarm.identification.excitation import _Excitation as Excitation
from fuzzyarm.identification.excitation import rehearsed
from fuzzyarm.identification.log import Log
from fuzzyarm.policies.registry import COMPUTED_TORQUE, LAWS
from fuzzyarm.policies.tip_cells import bounds_of_cells
from fuzzyarm.policies.tip_files import save_cells
from fuzzyarm.policies.tuned import NAME, SCHEMA, TunedLaws
from fuzzyarm.proof.tip.plant import PlantSet
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig
from fuzzyarm.rl_baselines.training import Training
from fuzzyarm.synthesis import ScheduledSpecification, _scheduled_design, design_scheduled

__all__ = ["CANARY", "CONTROLLERS", "no_code_ran", "of_robot", "room", "scratch", "signed"]

PACKAGE = Path(fuzzyarm.__file__).parent
CONTROLLERS, BUNDLES = (PACKAGE / "fuzzy_policy" / folder for folder in ("controllers", "laws/learned/policies"))
ROOM = Path(tempfile.mkdtemp(prefix="abuse-"))
CANARY = ROOM / "canary"
_MODULE = "import os\nos.mkdir({!r})\n\ndef make():\n    return None\n"


@atexit.register
def _clear() -> None:
    shutil.rmtree(ROOM, ignore_errors=True)


def room() -> Path:
    """A folder for files of a process, with a module that leaves the canary if it is ever imported; on `sys.path`."""
    module = ROOM / "abuse_canary.py"
    if not module.exists():
        module.write_text(_MODULE.format(str(CANARY)))
        sys.path.append(str(ROOM))
    return ROOM


def no_code_ran() -> None:
    """Check that nothing that a file named or held was executed."""
    ran = CANARY.exists() or "abuse_canary" in sys.modules
    CANARY.exists() and CANARY.rmdir()
    assert not ran, "code from a file was run"


def scratch() -> Path:
    """An empty folder for one try."""
    return Path(tempfile.mkdtemp(dir=room()))


def signed(document: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a controller file with the digest put right."""
    content = {name: value for name, value in document.items() if name != "digest"}
    return content | {"digest": digest_of(content)}


def _made(make: Callable[[Path], Any]) -> Callable[[], Path]:
    """A folder that is made once."""

    @functools.cache
    def folder() -> Path:
        made = scratch()
        make(made)
        return made

    return folder


@functools.cache
def of_robot() -> ScheduledController:
    """Return a controller of two rules for an arm whose second joint turns one way only: M̂ has one sign of slope."""
    robot = robot_named("planar-3r")
    joints = [dataclasses.replace(one, angle_range=(0.3, 2.5)) if k == 1 else one for k, one in enumerate(robot.joints)]
    given = ScheduledSpecification(premises=(Premise(1, "cos q"),), alpha=20.0)
    with mock.patch.object(_scheduled_design, "_SAMPLES", 600):
        return design_scheduled(given, dataclasses.replace(robot, joints=tuple(joints))).controller


controller = _made(lambda folder: shutil.copy(CONTROLLERS / "fuzzy-2.json", folder / "controller.json"))
scheduled = _made(lambda folder: of_robot().save(folder / "controller.json"))
bundle = _made(lambda folder: shutil.copytree(BUNDLES / "ppo-nominal", folder, dirs_exist_ok=True))
observer = _made(lambda folder: shutil.copytree(BUNDLES / "learned-observer", folder, dirs_exist_ok=True))
trained = _made(lambda folder: Training(PPOConfig(**SMALL_TRAINING), folder).run())


@_made
def tables(folder: Path) -> None:
    """Documents of TOML and CSV."""
    ArmParameters().write_toml(folder / "arm.toml")
    for name in ("planar-3r", "panda"):
        shutil.copy(PACKAGE / "envs" / "physics" / "robots" / f"{name}.toml", folder)
    (folder / "set.toml").write_text(
        'mass = [0.99, 1.01]\nstiffness = [[0.9, 1.1], [1.0, 1.0]]\nfriction = "any"\nlate = 1\n'
    )
    (folder / "path.toml").write_text("points = [[0.3, 0.5], [0.5, 0.3], [0.6, 0.5]]\nclosed = true\nduration = 4.0\n")
    (folder / "path.csv").write_text("x,y\n0.3,0.5\n0.5,0.3\n0.6,0.5\n0.3,0.5\n")
    angle = 0.3 * np.sin(np.arange(600)[:, np.newaxis] * [4e-3, 7e-3])
    torque, speed = 40.0 * np.cos(angle), np.gradient(angle, 2e-3, axis=0)
    (folder / "log.csv").write_text(Log(1e-3, angle, torque, 2.0 * speed).to_csv())
    parts = {"time": 2e-3 * np.arange(600), "q": angle, "tau": torque}
    np.savez(folder / "log.npz", **parts)
    np.save(folder / "log.npy", np.rec.fromarrays([parts["time"], *angle.T, *torque.T], names="time,q1,q2,tau1,tau2"))
    savemat(folder / "log.mat", parts)
    for plugin in ("MCAP", "SQLITE3"):
        write_bag(folder / plugin, plugin, angle, speed, torque)
        (bag,) = (file for file in (folder / plugin).iterdir() if file.suffix in (".mcap", ".db3"))
        shutil.copy(bag, folder / f"log{bag.suffix}")


@_made
def moved(folder: Path) -> None:
    """A log from which an arm can be identified."""
    sine, cosine = np.random.default_rng(5).normal(size=(2, 4, 2)) / np.arange(1, 5)[:, np.newaxis]
    motion = Excitation(np.array([0.0, 0.5]), 0.3 * sine, 0.3 * cosine, 0.4, 2.5, ArmParameters())
    log = rehearsed(motion, ArmParameters(), ArmParameters(), seed=1, noise=EncoderNoise(1e-8, 1e-6))
    (folder / "log.csv").write_text(log.to_csv())


@_made
def bounds(folder: Path) -> None:
    """A bound of three samples, and one by two cells."""
    claim = fuzzyarm.TipClaim("fuzzy-4-tip", set_name="own", plants=PlantSet(damping=(0.99, 1.01)), steps=3)
    fuzzyarm.save_bound(fuzzyarm.find_bound(claim), folder / "bound.json")
    cells = [cell for part in bounds_of_cells(claim, [("damping-1", 2)], 1, folder / "cells.json") for cell in part]
    save_cells(claim, cells, folder / "cells.json")


@_made
def tuned(folder: Path) -> None:
    """A folder as `fuzzyarm tune` writes it, for Table 1."""
    arm = ArmParameters()
    arm.write_toml(folder / "robot.toml")
    shutil.copy(CONTROLLERS / "fuzzy-1.json", folder)
    weights = {"observer": dataclasses.asdict(ObserverWeights()), "adaptive": dataclasses.asdict(AdaptiveWeights())}
    digest = robot_of(arm).digest
    laws = TunedLaws(SCHEMA, digest, 1e-3, ("fuzzy-1", *LAWS), bandwidth=70.0, **weights)
    (folder / NAME).write_text(laws.to_json())
    one = finding.Finding(finding.SCHEMA, digest, COMPUTED_TORQUE, {"bandwidth": 70.0}, {}, {"nominal": 0.9}, 1, "One.")
    finding.write_finding(folder, one)


@_made
def evaluated(folder: Path) -> None:
    """An evaluation without figures. Of a certified policy, a report simulates the proven loop."""
    done = fuzzyarm.evaluate(EvaluationConfig(policies=("computed-torque",), cases=("nominal",)))
    fuzzyarm.write_results(done, folder)
    write_rollouts(done.rollouts, folder)


@_made
def swept(folder: Path) -> None:
    """A sweep of two chunks, and beside it the summary of one that was never run."""
    config = SweepConfig(policies=("fuzzy-1",), cases=("nominal",), plants=4, chunk=2)
    for _ in fuzzyarm.Sweep.begin(folder, config).run(fuzzyarm.Engine(jobs=1)):
        pass
    errors, ones = np.arange(1.0, 5.0).reshape(1, 1, 4), np.ones((1, 1, 4))
    results = SweepResults(np.zeros(4, plant_record(2)), {"max_mm": errors, "rms_mm": errors}, ones, ones > 0.0)
    (folder / "sweep.json").write_text(json.dumps(summarise(config, results)), encoding="utf-8")


@_made
def recorded(folder: Path) -> None:
    os.rename(store.write_dataset(DatasetConfig(level="medium", episodes=1), folder), folder / "set")
