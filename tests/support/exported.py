"""Exported laws: compiled, and run beside their policies on observations at random."""

import numpy as np
import pytest

from fuzzyarm.export.c_files import _CompiledLaw as CompiledLaw
from fuzzyarm.export.c_files import _random_observations as random_observations
from fuzzyarm.export.c_files import compilers, export_c
from support.policies import answers

COMPILERS = compilers()
needs_compiler = pytest.mark.skipif(not COMPILERS, reason="no C compiler (gcc, clang) on this machine")


def bits(array):
    return np.asarray(array, dtype=np.float64).view(np.int64)


def assert_same_bits(policy, folder, lanes, calls, compiler=None):
    """Compare the compiled law with its policy over episodes of two lengths; return the torques."""
    seen = np.stack([random_observations(policy, calls, seed) for seed in range(lanes)], axis=1)
    starts = np.zeros(seen.shape[:2], dtype=bool)
    starts[0] = starts[calls // 3, ::2] = True
    torque, memory = answers(policy, seen, starts)
    _, source, _ = export_c("law", policy, folder)
    law = CompiledLaw(source, policy.joints, policy.memory_size, "double", compiler or COMPILERS[0])
    own_torque, own_memory = law.run(seen, starts)
    np.testing.assert_array_equal(bits(own_torque), bits(torque))
    # A filter may diverge here, and IEEE 754 leaves the sign of NaN open.
    np.testing.assert_array_equal(np.isnan(own_memory), np.isnan(memory))
    known = ~np.isnan(memory)
    np.testing.assert_array_equal(bits(own_memory)[known], bits(memory)[known])
    return torque
