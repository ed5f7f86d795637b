"""What an exported law does at the start, after a missed call, and when a sensor drops out or jumps."""

import ctypes

import numpy as np
import onnxruntime as ort
import pytest
from support.exported import needs_compiler, random_observations
from test_c import compiled

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.export._c_text import LAW, Recorded
from fuzzyarm.export.c_files import export_c
from fuzzyarm.export.onnx_file import _Graph as Graph
from fuzzyarm.export.onnx_file import export_onnx

BAD = (np.nan, np.inf, -np.inf, 1.1e6)


class InC:
    """An exported law as a function of an observation, which returns torques and status."""

    def __init__(self, source, inputs=10, joints=2):
        self.library = ctypes.CDLL(str(compiled(source, "-shared", "-fPIC")))
        self.state = ctypes.create_string_buffer(b"\xff" * 4096, 4096)
        self.joints, self.begin = joints, lambda: self.library.law_init(self.state)
        self.begin()

    def __call__(self, observation):
        torque = (ctypes.c_double * self.joints)(*[np.nan] * self.joints)
        status = self.library.law_step(self.state, (ctypes.c_double * len(observation))(*observation), torque)
        return [*torque], status


class InOnnx:
    """The same by onnxruntime."""

    def __init__(self, file):
        self.session = ort.InferenceSession(str(file))
        self.begin()

    def begin(self):
        self.memory = np.zeros((1, self.session.get_inputs()[1].shape[1]))

    def __call__(self, observation):
        given = {"observation": np.array([observation]), "memory": self.memory}
        torque, self.memory, status = self.session.run(None, given)
        return torque[0].tolist(), status[0, 0]


def exported(policy, folder):
    return [InC(export_c("law", policy, folder)[1]), InOnnx(export_onnx("law", policy, folder))]


@needs_compiler
def test_a_sensor_that_drops_out_holds_the_torques_and_is_a_call_that_was_missed(tmp_path):
    policy = load_policy("fuzzy-4-tip")
    seen = random_observations(policy, 30, 0)
    for law in exported(policy, tmp_path):
        for bad in BAD:
            law.begin()
            assert law([bad] * 10) == ([0.0, 0.0], 1)  # nothing to hold yet
            expected, state = [], None
            for k, observation in enumerate(seen):
                torque, state = policy.predict(observation, state)
                expected.append((torque.tolist(), 0))
                assert law(observation) == expected[-1], (k, bad)  # the memory has stayed
                broken = observation.copy()
                broken[k % 10] = bad
                assert law(broken) == (expected[-1][0], 1)


@needs_compiler
def test_a_result_that_is_not_finite_is_not_applied_and_the_memory_begins_again(tmp_path):
    def counting(given, memory):
        return (memory[0] + 1.0,), (memory[0] + given[0] / given[1],)

    program = Recorded(counting, (["x", "y"], (0.0, 0.0)), (0.0,), 1, LAW, "own.law")
    (tmp_path / "law.h").write_text(program.header_text("law", [], "double"), encoding="utf-8")
    (tmp_path / "law.c").write_text(program.source_text("law", "double"), encoding="utf-8")
    (tmp_path / "law.onnx").write_bytes(Graph().model("law", load_policy("fuzzy-1"), program))
    for law in (InC(tmp_path / "law.c", 2, 1), InOnnx(tmp_path / "law.onnx")):
        calls = ([4.0, 2.0], [4.0, 2.0], [1.0, 0.0], [0.0, 0.0], [5.0, 1.0])
        assert [law(np.array(one)) for one in calls] == [([2.0], 0), ([3.0], 0), ([3.0], 2), ([3.0], 2), ([5.0], 0)]


def largest_errors(name, fault):
    """Return the largest tip error [mm] of the nominal case with a fault, in all and over the last half second.

    `fault` returns what the policy sees at a call, or None where the call is missed.
    """
    env, policy, state = FuzzyArmEnv("nominal"), load_policy(name), None
    seen, info = env.reset(seed=0)
    torque, errors, done = np.zeros(2), [], False
    while not done:
        given = fault(len(errors), seen.copy())
        if given is not None:
            torque, state = policy.predict(given, state)
            assert (np.abs(torque) <= [500.0, 250.0]).all()
        seen, _, terminated, done, info = env.step(torque)
        assert not terminated
        errors.append(1e3 * np.linalg.norm(info["tip"] - info["tip_reference"]))
    return max(errors), max(errors[-500:])


def jumped(call, seen):
    seen[0] += 0.01 * (call == 300)  # rad, of the first encoder at one call
    return seen


MOST = {"fuzzy-4": (4.0, 4.5), "fuzzy-4-tip": (0.02, 0.8), "elastic-observer": (3.5, 0.8)}  # mm, missed and jump


@pytest.mark.parametrize("name", MOST)
def test_the_arm_stays_on_its_path_when_calls_are_missed_and_a_sensor_jumps(name):
    _, end = largest_errors(name, lambda _, seen: seen)
    missing, _ = largest_errors(name, lambda call, seen: None if call % 50 == 49 else seen)
    jump, after = largest_errors(name, jumped)
    assert missing < MOST[name][0] and jump < MOST[name][1] and after < end + 0.01
