"""Every format of a file: its fields, its structure and its bytes, signed again where a digest guards them."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import fuzzyarm
from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.certified.frozen import freeze, gain_at, pole_rate
from fuzzyarm.eval.certified.rigid import RigidLoop
from fuzzyarm.eval.certified.verification import verify_file
from fuzzyarm.eval.evaluation.ranking import markdown, rank_policies
from fuzzyarm.eval.evaluation.recheck import recheck_results
from fuzzyarm.eval.evaluation.results_file import read_results
from fuzzyarm.eval.paper.drift import EXPECTED, load_expected
from fuzzyarm.eval.report.stored import read_evaluation
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.identity import digest_of_identity
from fuzzyarm.eval.sweep.quantities import plant_record
from fuzzyarm.eval.sweep.ranking import rank_sweeps
from fuzzyarm.eval.sweep.results import SweepResults
from fuzzyarm.eval.sweep.run import Sweep
from fuzzyarm.eval.sweep.summary import summarise
from fuzzyarm.eval.tuning.finding import read_finding, write_finding
from fuzzyarm.eval.tuning.steps import found
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.hexadecimal import digest_of
from fuzzyarm.fuzzy_policy.laws.adaptive.weights import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights
from fuzzyarm.policies.tuned import LAWS, NAME, SCHEMA, TunedLaws, read_laws
from fuzzyarm.rl_baselines.training import Training

from .arguments import driven
from .damage import copied, damaged_bytes, damaged_document, to_json
from .samples import CANARY, evaluation, recurrent_bundle, sweep, training
from .surface import Broken, Surface, Try

__all__ = ["BUNDLES", "CONTROLLERS", "SURFACES", "no_code_ran", "prepared", "read_changed", "resumed_sweep"]

CONTROLLERS = Path(fuzzyarm.__file__).parent / "fuzzy_policy" / "controllers"
BUNDLES = Path(fuzzyarm.__file__).parent / "learned_policy" / "policies"
CLAIMED = ("fuzzy-1", "fuzzy-2", "paper-1", "paper-4")  # files that are quickly proven


def prepared() -> None:
    """Make the samples, and use everything once."""
    evaluation(), sweep(), training(), read_evaluation(evaluation()), Training.resume(training()).algorithm.update()
    verify_file(CONTROLLERS / "fuzzy-1.json"), _acted(_bundle()), _acted(recurrent_bundle()), driven(FuzzyArmEnv())


def no_code_ran() -> None:
    """Check that nothing that a file named or held was executed."""
    if CANARY.exists() or "abuse_canary" in sys.modules:
        CANARY.unlink(missing_ok=True)
        raise Broken("code from a file was run")


def read_changed(source: Path, target: str, content: bytes, read: Callable[[Path], Any]) -> None:
    """Read a copy of a folder in which one file has another content; nothing in it may be run."""
    folder = copied(source, target, content)
    try:
        read(folder)
    finally:
        no_code_ran()


def _document(content: bytes) -> Any:
    return json.loads(content)


def file_of(
    name: str,
    source: Callable[[], Path],
    target: str,
    read: Callable[[Path], Any],
    sign: Callable[[Any], Any] | None,
    *,
    count: int,
    same: Callable[[Any, Any, bool], None] = lambda original, changed, signed: None,
) -> Surface:
    """A surface of a JSON document: half of the tries change values, the others bytes.

    Args:
        name: of the surface.
        source: a folder with good files; it is copied for each try.
        target: the file in it that is changed.
        read: reads the copy of the folder; returns if it was accepted.
        sign: puts the digest right; None if there is none.
        count: tries of a whole run.
        same: called with the document before and after, and whether it is signed, if it was accepted.
    """  # fmt: skip

    def attempt(rng: np.random.Generator) -> Try:
        good = (source() / target).read_bytes()
        signed = sign is not None and rng.random() < 0.7
        if rng.random() < 0.7:
            document, text = damaged_document(rng, _document(good))
            if signed and sign is not None and isinstance(document, dict):
                try:
                    document, text = sign(document), f"{text}, signed"
                except (KeyError, TypeError, ValueError, AttributeError):
                    signed = False
            content = to_json(document)
        else:
            content, text = damaged_bytes(rng, good)
            signed = False

        def run() -> None:
            read_changed(source(), target, content, read)
            same(_document(good), _document(content), signed)

        return Try(f"{target}: {text}", run)

    return Surface(name, "files", count, attempt, prepare=prepared)


@functools.cache
def _controller(name: str) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="abuse-"))
    shutil.copy(CONTROLLERS / f"{name}.json", folder / "controller.json")
    return folder


def _signed_controller(document: dict[str, Any]) -> dict[str, Any]:
    document.pop("digest", None)
    return document | {"digest": digest_of(document)}


def _verified(folder: Path) -> None:
    """Verify a controller file; what is called PROVEN has to hold on frozen loops, in floating point."""
    report = verify_file(folder / "controller.json")
    text = report.to_text() + json.dumps(report.to_dict(), allow_nan=True)
    if report.certificate.proven and "NOT PROVEN" not in text:
        _check_claim(report.controller)


def _check_claim(controller: Controller) -> None:
    """Check rates and gains of the consistent form at random states of the box: no proof, but an oracle of its own."""
    if controller.form != "consistent":
        return
    rng, limits = np.random.default_rng(0), controller.model.parameters
    q = rng.uniform(-1.0, 1.0, (400, 2)) * limits.joint_limit
    dq = rng.uniform(-1.0, 1.0, (400, 2)) * limits.velocity_limit
    F, G = freeze(RigidLoop(controller), q, dq)
    slow, gains = pole_rate(F).min(), [gain_at(F, G, np.full(400, 1j * w)).max() for w in (0.0, 1.0, 10.0, 100.0)]
    if slow < controller.alpha * (1.0 - 1e-6) or max(gains) > controller.gamma * (1.0 + 1e-6):
        claimed = f"alpha {controller.alpha:g}, gamma {controller.gamma:g}"
        raise Broken(f"PROVEN with {claimed}, but the rate is {slow:g} and the gain {max(gains):g}")
    fastest = -np.linalg.eigvals(F).real.min()
    if controller.fastest_pole is not None and fastest > controller.fastest_pole * (1.0 + 1e-6):
        raise Broken(f"PROVEN, but a pole is at {-fastest:g}, claimed above {-controller.fastest_pole:g}")


def _same_controller(original: Any, changed: Any, signed: bool) -> None:
    if not signed and original != changed:
        raise Broken("a changed file with the old digest was taken")


def _bundle() -> Path:
    return BUNDLES / "ppo-nominal"


def _acted(folder: Path) -> None:
    policy = load_policy(folder)
    observation = np.array([0.3, 0.5, 0.0, 0.0, 0.3, 0.5, 0.0, 0.0, 0.0, 0.0])
    torque, _ = policy.predict(observation)
    if not (np.abs(torque) <= ArmParameters().torque_limit).all():
        raise Broken(f"torque {torque}")


def _weights(source: Callable[[], Path], rng: np.random.Generator) -> Try:
    """Bytes of the weights, most of them with the digest put right; the header is text, which is changed more often."""
    good, signed = (source() / "weights.safetensors").read_bytes(), rng.random() < 0.8
    length = int.from_bytes(good[:8], "little")
    if rng.random() < 0.5:
        header, text = damaged_document(rng, json.loads(good[8 : 8 + length]))
        head = to_json(header)
        size = len(head) if rng.random() < 0.8 else int(rng.integers(2**63, dtype=np.int64))
        content = size.to_bytes(8, "little") + head + good[8 + length :]
    else:
        content, text = damaged_bytes(rng, good)

    def run() -> None:
        folder = copied(source(), "weights.safetensors", content)
        if signed:
            document = json.loads((folder / "policy.json").read_text())
            document["weights_sha256"] = hashlib.sha256(content).hexdigest()
            (folder / "policy.json").write_text(json.dumps(document))
        _acted(folder)
        if not signed and content != good:
            raise Broken("changed weights with the old digest were taken")

    return Try(f"weights.safetensors: {text}{', signed' if signed else ''}", run)


def _read_results(folder: Path) -> None:
    results = read_results(folder)
    rank_policies([folder])
    if (
        results.config.seeds * len(results.config.policies) * len(results.config.cases) > 1
        or results.config.control_period < 5e-4
    ):
        return
    recheck_results(results, ())


def _signed_run(document: dict[str, Any]) -> dict[str, Any]:
    """Sign a run.json as whoever forges it would: the numbers follow the configuration."""
    numbers = document["numbers"]
    document["numbers"] = {name: document["config"].get(name, value) for name, value in numbers.items()}
    then = {name: document[name] for name in ("numbers", "policies", "made_with")}
    return document | {"digest": digest_of_identity(then)}


def resumed_sweep(folder: Path) -> None:
    opened = Sweep.resume(folder)
    if opened.store.config.total <= 4 and opened.store.config.plants <= 4:
        opened.store.missing()
        opened.store.load_all()


def _expected_folder() -> Path:
    return EXPECTED.parent


@functools.cache
def _tuned() -> Path:
    """Return a folder as `fuzzyarm tune` writes it, for Table 1."""
    folder = Path(tempfile.mkdtemp(prefix="abuse-"))
    arm, weights = ArmParameters(), {"observer": ObserverWeights(), "adaptive": AdaptiveWeights()}
    arm.write_toml(folder / "robot.toml")
    shutil.copy(CONTROLLERS / "fuzzy-1.json", folder)
    laws = TunedLaws(
        SCHEMA,
        robot_of(arm).digest,
        1e-3,
        ("fuzzy-1", *LAWS),
        bandwidth=70.0,
        **{name: dataclasses.asdict(value) for name, value in weights.items()},
    )
    (folder / NAME).write_text(laws.to_json())
    write_finding(folder, found(arm, LAWS[0], {"bandwidth": 70.0}, {}, {"nominal": 0.9}, tried=1, rule="One."))
    return folder


def _read_tuned(folder: Path) -> None:
    laws = read_laws(folder, ArmParameters())
    for name in laws.policies:
        if name in LAWS:
            load_policy(folder / name)


def _read_step(folder: Path) -> None:
    read_finding(folder, LAWS[0], robot_of(ArmParameters()).digest)


@functools.cache
def _summary() -> Path:
    folder, shape = Path(tempfile.mkdtemp(prefix="abuse-")), (1, 1, 4)
    config = SweepConfig(policies=("fuzzy-1",), cases=("nominal",), plants=4)
    errors, completed = np.arange(1.0, 5.0).reshape(shape), np.ones(shape, bool)
    results = SweepResults(np.zeros(4, plant_record(2)), errors, errors, np.ones(shape), completed)
    (folder / "sweep.json").write_text(json.dumps(summarise(config, results)), encoding="utf-8")
    return folder


def _ranked(folder: Path) -> None:
    markdown(rank_sweeps([folder]))


SURFACES = (
    file_of("laws.json", _tuned, NAME, _read_tuned, None, count=400),
    file_of("steps/computed-torque.json", _tuned, "steps/computed-torque.json", _read_step, None, count=400),
    *(
        file_of(
            f"controller {name}",
            functools.partial(_controller, name),
            "controller.json",
            _verified,
            _signed_controller,
            count=500 if name.startswith("fuzzy") else 400,
            same=_same_controller,
        )
        for name in CLAIMED
    ),
    file_of("policy.json", _bundle, "policy.json", _acted, None, count=800),
    Surface("weights.safetensors", "files", 600, functools.partial(_weights, _bundle), prepare=prepared),
    file_of("recurrent policy.json", recurrent_bundle, "policy.json", _acted, None, count=400),
    Surface("recurrent weights", "files", 300, functools.partial(_weights, recurrent_bundle), prepare=prepared),
    file_of("results.json", evaluation, "results.json", _read_results, None, count=800),
    file_of("sweep.json", _summary, "sweep.json", _ranked, None, count=400),
    file_of("run.json", sweep, "run.json", resumed_sweep, _signed_run, count=600),
    file_of(
        "expected.json",
        _expected_folder,
        "expected.json",
        lambda folder: load_expected(folder / "expected.json"),
        None,
        count=400,
    ),
)
