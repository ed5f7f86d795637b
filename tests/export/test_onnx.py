"""ONNX of a law with its memory: the numbers of the policy to the last digit, lane by lane.

The operator Where of onnxruntime returns 0 for -0, and the signs of zeros are not compared.
"""

import itertools

import numpy as np
import onnxruntime as ort
import pytest
from slow_twins import slow_but
from support.exported import random_observations
from test_c import FUNCTIONS, recorded

from fuzzyarm import load_policy
from fuzzyarm.export.onnx_file import _Graph as Graph
from fuzzyarm.export.onnx_file import export_onnx


def session(file):
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1  # operations are short
    return ort.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])


def first_memory(model, lanes):
    return np.zeros((lanes, model.get_inputs()[1].shape[1]))


SIZES = {"fuzzy-4": (64, 50), "fuzzy-4-tip": (1000, 1000), "elastic-observer": (1000, 1000), "ppo-nominal": (64, 50)}
SIZES |= dict.fromkeys(("ppo-robust", "learned-observer", "adaptive-observer"), (3, 50))


@pytest.mark.parametrize("name", slow_but(["fuzzy-4"], [*SIZES]))
def test_onnxruntime_gives_the_numbers_of_the_policy(name, tmp_path):
    (lanes, calls), policy, state = SIZES[name], load_policy(name), None
    model = session(export_onnx(name, policy, tmp_path))
    seen = np.stack([random_observations(policy, calls, seed) for seed in range(lanes)], axis=1)
    memory = first_memory(model, lanes)
    for call, observation in enumerate(seen):
        start = np.arange(lanes) % 3 == 0 if call == calls // 2 else np.full(lanes, call == 0)
        memory[start] = 0.0
        expected, state = policy.predict(observation, state, start)
        torque, memory, status = model.run(None, {"observation": observation, "memory": memory})
        np.testing.assert_array_equal(torque, expected)
        np.testing.assert_array_equal(memory, np.hstack([state, expected]))
        assert not status.any()


@pytest.mark.parametrize(("function", "tables"), FUNCTIONS)
def test_branches_loops_and_tables_are_those_of_python(function, tables, tmp_path):
    """The graph of a function that is not a law, written as one, whose lanes decide differently."""
    (tmp_path / "own.onnx").write_bytes(Graph().model("own", load_policy("fuzzy-1"), recorded(function, tables)))
    pairs = np.array([*itertools.product((-2.0, -0.5, -0.0, 0.5, 1.0, 1.5, 3.0, 1e5), (-1.0, -0.0, 1.0, 2.5))])
    model = session(tmp_path / "own.onnx")
    torque, _, _ = model.run(None, {"observation": pairs, "memory": first_memory(model, len(pairs))})
    np.testing.assert_array_equal(torque[:, 0], [function(*pair, *tables) for pair in pairs.tolist()])
