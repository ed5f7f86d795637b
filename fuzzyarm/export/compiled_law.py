"""An exported law, compiled on this machine: for the comparison with its policy, bit by bit, and for its time."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np

from fuzzyarm.envs.observation import PARTS

__all__ = ["FLAGS", "CompiledLaw", "compilers"]

FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off", "-O2")
"""Options of the compiler with which an exported law has no warning, and the bits of its policy."""

_LOOP = """#include <string.h>
#include "{name}.h"
void run(long lanes, long calls, const unsigned char *starts, const {real} *seen, {real} *torque, {real} *memory);
void run(long lanes, long calls, const unsigned char *starts, const {real} *seen, {real} *torque, {real} *memory)
{{
    long lane, call;
    for (lane = 0; lane < lanes; lane++) {{
        {name}_state state;
        memcpy(state.memory, memory + lane * {size}, sizeof state.memory);
        for (call = 0; call < calls; call++) {{
            const long at = call * lanes + lane;
            if (starts[at]) {{
                {name}_init(&state);
            }}
            {name}_step(&state, seen + at * {inputs}, torque + at * {joints});
        }}
        memcpy(memory + lane * {size}, state.memory, sizeof state.memory);
    }}
}}
"""


def compilers() -> list[str]:
    """Return the names of the C compilers of this machine, of gcc and clang."""
    return [name for name in ("gcc", "clang") if shutil.which(name)]


class CompiledLaw:
    """The functions of an exported law as machine code.

    Attributes:
        number: the NumPy type of its numbers.
        joints: n.
        memory_size: numbers that it remembers.
    """

    def __init__(self, source: Path, joints: int, memory_size: int, number: str, compiler: str) -> None:
        """Compile the source file of an exported law, beside which its header lies; `number` is "double" or "float".

        Raises:
            subprocess.CalledProcessError: the compiler has an error or a warning.
        """
        self.number = np.dtype({"double": np.float64, "float": np.float32}[number])
        self.joints, self.memory_size, name = joints, memory_size, source.stem
        loop, library = source.with_name(f"{name}_loop.c"), source.with_name(f"{name}_{compiler}_{number}.so")
        sizes = {"size": memory_size, "inputs": PARTS * joints, "joints": joints}
        loop.write_text(_LOOP.format(name=name, real=number, **sizes), encoding="utf-8")
        words = [compiler, *FLAGS, "-shared", "-fPIC", str(loop), str(source), "-o", str(library)]
        subprocess.run(words, check=True, capture_output=True, text=True)
        self._run = ctypes.CDLL(str(library)).run

    def run(
        self, observations: np.ndarray, starts: np.ndarray, memory: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return torques (calls, lanes, n) [N m] and memories (lanes, memory_size) after them.

        Args:
            observations: (calls, lanes, 5 n).
            starts: (calls, lanes), whether an episode begins with this call.
            memory: (lanes, memory_size) before the first call; default: zeros.
        """
        calls, lanes, _ = observations.shape
        seen = np.ascontiguousarray(observations, dtype=self.number)
        begins = np.ascontiguousarray(starts, dtype=np.uint8)
        torque = np.empty((calls, lanes, self.joints), dtype=self.number)
        kept = np.zeros((lanes, self.memory_size), dtype=self.number)
        if memory is not None:
            kept[:] = memory
        arrays = [array.ctypes.data_as(ctypes.c_void_p) for array in (begins, seen, torque, kept)]
        self._run(ctypes.c_long(lanes), ctypes.c_long(calls), *arrays)
        return torque, kept

    def predict(
        self,
        observation: np.ndarray,
        state: np.ndarray | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return torques (n,) [N m] and the next state for an observation (5 n,): the protocol of all policies."""
        begins = np.array([[state is None]])
        torque, memory = self.run(observation[np.newaxis, np.newaxis], begins, state)
        return torque[0, 0].astype(np.float64), memory
