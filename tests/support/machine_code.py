"""A function of numbers, run as machine code on the rows of an array."""

import numpy as np

from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program


def on_machine(function, given):
    """What ``function(*row)`` returns for each row of `given` (arms, numbers), as an array (arms, results)."""
    results = len(np.atleast_1d(function(*[0.5] * given.shape[1])))

    def recorded(row, _, __):
        answer = function(*row)
        return row, tuple(answer) if isinstance(answer, tuple | list) else (answer,)

    found = np.empty((len(given), results))
    kernel = Kernel(Program(recorded, ((0.0,) * given.shape[1], (0.0,) * results)))
    kernel((np.array(given, dtype=np.float64), found), np.empty(0))
    return found
