"""Machine code of other processors: the same bits where it runs here, and nothing that rounds once instead of twice."""

import itertools
import os
import platform
import re
import subprocess
import sys

import llvmlite.binding as llvm
import pytest

from fuzzyarm import ArmParameters, load_policy
from fuzzyarm.envs.batch._kernels import kernels_of
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.numbers import machine
from fuzzyarm.numbers._llvm_text import kernel_text
from fuzzyarm.numbers.machine import WIDE

FUSED = re.compile(r"\b(vfn?m(add|sub)|fn?m(add|sub|la|ls)\b)", re.I)
PROCESSORS = {"x86-64-v3": "x86_64-unknown-linux-gnu", "generic": "aarch64-unknown-linux-gnu"}

PROGRAM = """
import hashlib, itertools, sys
import llvmlite.binding as llvm
import numpy as np

class Plain:
    def flatten(self):
        return ""

if sys.argv[1]:
    llvm.get_host_cpu_name, llvm.get_host_cpu_features = lambda: sys.argv[1], Plain
import gymnasium as gym
import fuzzyarm
from fuzzyarm.eval.episodes.loop import episodes

envs = gym.make_vec("FuzzyArm-v0", num_envs=40, randomisation="plants", case="machining")
found = hashlib.sha256()
policy = fuzzyarm.load_policy("elastic-observer")
for step in itertools.islice(episodes(envs, policy, envs.reset(seed=0)), 300):
    for array in (step.observation, step.reward, step.info["tip"], step.info["torque"], step.memory):
        found.update(np.ascontiguousarray(array).tobytes())
print(found.hexdigest())
"""


def assembly(text, processor, triple):
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(triple).create_target_machine(cpu=processor, opt=3)
    module = llvm.parse_assembly(text)
    module.triple = triple
    builder = llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options(speed_level=3))
    builder.getModulePassManager().run(module, builder)
    return target.emit_assembly(module)


@pytest.mark.slow
@pytest.mark.parametrize("processor", PROCESSORS)
def test_no_multiplication_is_fused_with_an_addition(processor):
    """In a control step and in a law, of one arm and of many."""
    kernels = (kernels_of(equations_of(ArmParameters())).step, load_policy("elastic-observer")._command_kernel)
    for one, width in itertools.product(kernels, (1, WIDE)):
        text = kernel_text(one.program, one.layouts, width)
        assert not FUSED.search(assembly(text, processor, PROCESSORS[processor]))
    free = re.sub(r"\b(fmul|fadd|fsub) ", r"\1 contract ", text)
    assert FUSED.search(assembly(free, processor, PROCESSORS[processor]))  # which is what LLVM does where it may


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="runs the machine code of x86-64 processors")
def test_an_old_processor_gives_the_same_bits(tmp_path):
    found = []
    for processor in ("", "x86-64"):  # this one with all it has, and one of 2003
        environment, words = os.environ | {machine._CACHE: str(tmp_path)}, [sys.executable, "-c", PROGRAM, processor]
        answer = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=300)
        assert answer.returncode == 0, answer.stderr
        found.append((answer.stdout, {path.name for path in tmp_path.iterdir()}))
    assert found[0][0] == found[1][0] and len(found[0][0]) == 65
    assert len(found[1][1]) == 2 * len(found[0][1])  # each has its own machine code
