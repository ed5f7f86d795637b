"""Compilation of the step by torch, for the arm in tensors."""

from __future__ import annotations

import contextlib
import re
import sys
import threading
import types
import warnings
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import torch

__all__ = ["COMPILER_OPTIONS", "announced_compilation", "compile_step"]

Outcome = TypeVar("Outcome")

# One kernel for the whole step: by default the compiler cuts it after 64 operations, and the arm's state goes through
# memory at each cut.
COMPILER_OPTIONS: dict[str, str | int | bool | Callable[..., Any]] = {
    "max_fusion_size": 1_000_000,
    "guard_filter_fn": torch.compiler.skip_all_guards_unsafe,
}


def compile_step(function: Callable[..., Outcome]) -> Callable[..., Outcome]:
    """Return the function compiled as one graph for the arguments it will be called with.

    Raises (the compiled function, at its first call):
        RuntimeError: no compiler was found.
    """
    # torch counts the compiled versions of each code object and gives up after eight: every batch has its own.
    own = types.FunctionType(function.__code__.replace(), function.__globals__)
    graph = torch.compile(own, fullgraph=True, dynamic=False, options={**COMPILER_OPTIONS})

    def call(*arguments: Any) -> Outcome:
        try:
            outcome: Outcome = graph(*arguments)
        except RuntimeError as error:
            found = re.search(r"[^\n]*\bC(\+\+)? compiler\b[^\n]*", str(error))
            if found is None:
                raise
            message = "compiled=True needs a C++ compiler and found none: install g++ (apt install g++), name yours in "
            message += f"the environment variable CXX, or use TorchFuzzyArm(..., compiled=False) [{found[0]}]"
            raise RuntimeError(message) from None
        return outcome

    return call


@contextlib.contextmanager
def announced_compilation() -> Iterator[None]:
    """Say on a terminal what is being waited for, if the call within takes more than a second."""
    message = "TorchFuzzyArm: compiling the step (up to a minute; a tenth of it once torch has it on disk) ..."
    timer = threading.Timer(1.0, lambda: print(message, file=sys.stderr, flush=True))
    if sys.stderr.isatty():
        timer.start()
    try:
        with warnings.catch_warnings():  # the compiler looks at the gradient of whatever comes in
            warnings.filterwarnings("ignore", r"The \.grad attribute of a Tensor that is not a leaf", UserWarning)
            yield
    finally:
        timer.cancel()
