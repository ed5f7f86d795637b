"""Whether results of environments are the same, to the bit."""

import numpy as np


def identical(first, second):
    """Whether two results are of the same types, shapes and bits, whatever they are made of."""
    if isinstance(first, dict):
        same_keys = isinstance(second, dict) and first.keys() == second.keys()
        return same_keys and all(identical(first[key], second[key]) for key in first)
    if isinstance(first, tuple | list):
        same_length = isinstance(second, tuple | list) and len(first) == len(second)
        return same_length and all(map(identical, first, second))
    if isinstance(first, np.ndarray):
        if not (isinstance(second, np.ndarray) and (first.dtype, first.shape) == (second.dtype, second.shape)):
            return False
        return all(map(identical, first, second)) if first.dtype == object else first.tobytes() == second.tobytes()
    return type(first) is type(second) and first == second


def assert_identical(first, second, step=None):
    """The same, and name what differs."""
    for name, one, other in zip(("observation", "reward", "terminated", "truncated"), first, second, strict=False):
        assert identical(one, other), f"{name} differs, step {step}"
    info, expected = first[-1], second[-1]
    assert info.keys() == expected.keys(), step
    assert [key for key in info if not identical(info[key], expected[key])] == [], f"info differs, step {step}"
