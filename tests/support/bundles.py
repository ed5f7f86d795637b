"""Bundles with random weights, and folders of bundles that were changed by hand."""

import functools
import hashlib
import itertools
import json

import numpy as np
from safetensors.numpy import load, save

from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, ArmDefinition, FeatureDefinition
from fuzzyarm.fuzzy_policy.laws.learned.estimate.rnn import EstimateNetwork, shapes_of
from fuzzyarm.fuzzy_policy.laws.learned.network import Network
from fuzzyarm.numbers.functions import Cells
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program


def network(sizes=(20, 16, 8, 2), seed=0, gain=1.0):
    """A network with float32 weights."""
    rng, pairs = np.random.default_rng(seed), list(itertools.pairwise(sizes))
    mean, std = rng.normal(size=sizes[0]), rng.uniform(0.5, 2.0, sizes[0])
    weights = tuple((gain * rng.normal(size=(n, m)) / np.sqrt(m)).astype(np.float32) for m, n in pairs)
    biases = tuple((0.1 * rng.normal(size=n)).astype(np.float32) for _, n in pairs)
    return Network(mean=mean, std=std, clip=10.0, weights=weights, biases=biases)


def answering(network):
    """What a network answers: ``act(features, memory=None)`` for lanes in rows; the memory advances in place."""

    def act(features, memory, _, __, *tables):
        return features, memory, network.outputs(features, memory, *tables)

    inputs, *_, outputs = network.sizes
    ports = Cells((inputs,)), network.memory, (0.0,) * outputs
    kernel = Kernel(Program(act, ports, (), [table.shape for table in network.tables]))

    def answer(features, memory=None):
        action, held = np.empty((len(features), outputs)), np.empty((len(features), 0)) if memory is None else memory
        kernel((features, held, action), np.empty(0), network.tables)
        return action

    return answer


def bundle(action=None, seed=0, arm=None, **values):
    """A bundle with a random network that fits."""
    features, action = FeatureDefinition(**values), action or ActionDefinition()
    record = {"training": {"steps": 7}, "seed": 3, "versions": {"numpy": "2"}}
    record["curve"] = [{"steps": 7, "nominal_max_mm": 1.5}]
    sizes = features.size, 16, 8, len(action.scale)
    return PolicyBundle(features=features, action=action, network=network(sizes, seed), arm=arm, **record)


def robot_bundle(robot, name=None):
    """A bundle for a robot, or for another two-joint arm, with a random network."""
    action = ActionDefinition(scale=tuple(10.0 + k for k in range(len(robot))), period=2e-3)
    arm = ArmDefinition(name or robot.name, robot.digest)
    return bundle(action, arm=arm, joints=len(robot), past_errors=1, past_actions=2)


def estimate_network(joints=2, axes=2, seed=0):
    """A network of a learned observer in single precision; a weak one, because a strong one amplifies rounding."""
    rng = np.random.default_rng(seed)
    shapes = shapes_of(7, 3, joints, axes)
    scales = {name: 0.0015 if name in "VGD" else 0.3 for name in shapes}
    return EstimateNetwork(**{k: (scales[k] * rng.normal(size=shapes[k])).astype(np.float32) for k in shapes})


def edited(*path, **changes):
    """Change a part of the description; a key whose value is "gone" is left out."""

    def edit(folder):
        description = json.loads((folder / "policy.json").read_text())
        part = functools.reduce(lambda inner, name: inner[name], path, description)
        part.update(changes)
        (folder / "policy.json").write_text(json.dumps({k: v for k, v in description.items() if v != "gone"}))

    return edit


def resealed(content=None, **changes):
    """Other weights, with the hash that goes with them."""

    def reseal(folder):
        path = folder / "weights.safetensors"
        changed = save(load(path.read_bytes()) | changes) if content is None else content
        path.write_bytes(changed)
        edited(weights_sha256=hashlib.sha256(changed).hexdigest())(folder)

    return reseal
