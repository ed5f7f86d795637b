"""A learned policy from a model saved by stable-baselines3 or sb3-contrib.

Torch reads the weights in the zip file without unpickling; of ``data`` only the strings are read, not pickled objects.
The settings that are stored only in pickled objects, the activation of the layers and the feature extractor, must
therefore be the library's defaults. The model must have been trained on ``FuzzyArmLearn-v0``.
"""

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import instance
from fuzzyarm.common.documents import read_bytes
from fuzzyarm.envs.physics.equations import AnyArm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.known_arm import joints_of
from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, ArmDefinition, learning_features
from fuzzyarm.fuzzy_policy.laws.learned.features import learning_action
from fuzzyarm.fuzzy_policy.laws.learned.network import Cell, Network
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy
from fuzzyarm.policies._onnx_model import past_seen

__all__ = ["sb3_policy"]

_LARGEST = 64 * 2**20  # bytes, for the zip file and for each part that is read
_UNREAD = ("activation_fn", "features_extractor_class", "features_extractor_kwargs", "squash_output")


def sb3_policy(
    path: Path, robot: AnyArm, control_period: float, action: ActionDefinition | None = None
) -> LearnedPolicy:
    """Return the mean action of a saved PPO, A2C, RecurrentPPO, SAC, TQC, TD3 or DDPG as a policy.

    The actions are those of ``FuzzyArmLearn-v0``, unless `action` defines others.

    The running mean and variance of the observations from VecNormalize are read from a file ``NAME.npz`` in the folder
    of ``NAME.zip``, if there is one, with the arrays ``mean``, ``var`` and ``clip``.

    Raises:
        ValueError: the file is not such a model, or the model belongs to another environment.
        OSError: the file cannot be read.
    """
    data, tensors = _read(path)
    settings = data.get("policy_kwargs", {})
    if unread := sorted(set(settings) & set(_UNREAD)):
        raise ValueError(
            f"{path}: policy_kwargs has {', '.join(unread)}, which cannot be read without unpickling; {_ROUTE}"
        )
    joints = joints_of(robot)
    low, high = (str(data.get("action_space", {}).get(end)) for end in ("low", "high"))
    if {*low.strip("[]").split()} != {"-1."} or {*high.strip("[]").split()} != {"1."}:
        raise ValueError(
            f"{path}: its actions range from {low} to {high}; train on FuzzyArmLearn-v0, where they range from -1 to 1"
        )
    weights, biases, cell, activation, output = _layers(path, tensors)
    inputs = (weights[0] if cell is None else cell.weight_x).shape[1]
    past = past_seen(path, inputs, joints)
    mean, var, clip = _normaliser(path.with_suffix(".npz"), inputs)
    named = robot_of(robot)
    arm = None if robot == ArmParameters() else ArmDefinition(named.name, named.digest)
    try:
        network = Network(mean, np.sqrt(var + 1e-8), clip, weights, biases, activation, output, cell)
        bundle = PolicyBundle(learning_features(joints, past), action or learning_action(robot), network, arm)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None
    return LearnedPolicy(bundle, control_period, robot)


_ROUTE = "export the model to ONNX, as docs/tutorials/train.md shows, and give --policy onnx:model.onnx"


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the settings in a model's zip file, with no object unpickled, and its weights as arrays by name."""
    try:
        import torch
    except ImportError:
        raise ValueError(
            f"{path}: torch, which reads its weights, is not installed; run in the repository: "
            "pip install -c constraints.txt -e '.[rl]'"
        ) from None
    content = read_bytes(path, largest=_LARGEST)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            parts = {name: archive.getinfo(name) for name in ("data", "policy.pth")}
            if any(part.file_size > _LARGEST for part in parts.values()):
                raise ValueError(f"one of its parts is larger than the allowed {_LARGEST} bytes")
            data = instance("data", json.loads(archive.read("data")), dict)
            found = torch.load(io.BytesIO(archive.read("policy.pth")), map_location="cpu", weights_only=True)
        tensors = {name: tensor.numpy().astype(np.float32) for name, tensor in found.items()}
    except Exception as error:  # torch may raise any exception
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ValueError(f"{path} cannot be read as a model saved by stable-baselines3: {reason}") from None
    return data, tensors


def _layers(path: Path, tensors: dict[str, np.ndarray]) -> tuple[Any, Any, Cell | None, str, str]:
    """Return weights, biases, LSTM cell or None, activation and output function of the network of the mean action."""
    for hidden, last, activation, output in (
        ("mlp_extractor.policy_net.", "action_net.", "tanh", "clip"),
        ("actor.latent_pi.", "actor.mu.", "relu", "tanh"),
        ("actor.mu.", "", "relu", "tanh"),
    ):
        inside = (name.removeprefix(hidden).partition(".") for name in tensors if name.startswith(hidden))
        numbers = sorted(int(number) for number, _, part in inside if part == "weight" and number.isdigit())
        names = [f"{hidden}{number}." for number in numbers] + [last] * bool(last)
        if not numbers or any(_axes(tensors, name) != (2, 1) for name in names):
            continue
        cell, memory = None, [f"lstm_actor.{part}_l0" for part in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")]
        if any(name.startswith("lstm_actor") for name in tensors):
            if "lstm_actor.weight_ih_l1" in tensors or not set(memory) <= set(tensors):
                raise ValueError(f"{path}: its LSTM must have a single layer, which is the default; {_ROUTE}")
            x, h, a, b = (tensors[name] for name in memory)
            cell = Cell(x, h, a + b)
        weights, biases = (tuple(tensors[name + part] for name in names) for part in ("weight", "bias"))
        return weights, biases, cell, activation, output
    raise ValueError(f"{path}: its layers are not those of an MlpPolicy or MlpLstmPolicy; {_ROUTE}")


def _axes(tensors: dict[str, np.ndarray], name: str) -> tuple[int, ...]:
    """Return the `ndim` of the arrays `name` + "weight" and `name` + "bias", as far as there are such arrays."""
    return tuple(tensors[name + part].ndim for part in ("weight", "bias") if name + part in tensors)


def _normaliser(path: Path, inputs: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return mean (inputs,), variance (inputs,) and clip from a file; if it is missing, values that change nothing."""
    if not path.is_file():
        return np.zeros(inputs), np.full(inputs, 1.0 - 1e-8), 1e6
    try:
        with np.load(io.BytesIO(read_bytes(path, largest=_LARGEST)), allow_pickle=False) as arrays:
            mean, var = (np.asarray(arrays[name], dtype=np.float64) for name in ("mean", "var"))
            return mean, var, float(arrays["clip"])
    except (KeyError, ValueError, OSError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} must contain mean, var and clip: {error}") from None
