"""The files of an exported policy: header, source, and test vectors; and the law compiled, to be compared with it."""

from __future__ import annotations

import csv
import ctypes
import io
import re
import shutil
import subprocess
import tempfile
import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fuzzyarm import __version__
from fuzzyarm.common.checks import choice, instance, path_of
from fuzzyarm.common.files import write_once
from fuzzyarm.envs.observation import PARTS, Observation, starts
from fuzzyarm.envs.physics.equations import bounds_of
from fuzzyarm.export.c_text import Recorded, Unsupported, arguments_text, program_of, source_text
from fuzzyarm.export.sheet import certified_numbers, default_certificate
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = [
    "CALLS", "FLAGS", "NUMBERS", "UNITS", "CompiledLaw", "c_name", "compilers", "export_c", "header_text",
    "random_observations", "sources_of",
]  # fmt: skip

CALLS = 200  # consecutive calls in a file of test vectors
SHARE = 0.2  # of the calls, the last ones, that see any state
FREQUENCIES = (2.0, 10.0)  # rad/s
SMALLEST, LARGEST = -8.0, -0.5  # errors, powers of ten of the limits


def random_observations(policy: Policy, calls: int, seed: int) -> np.ndarray:
    """Return observations (calls, 5 n) [rad, rad/s, rad/s²] of consecutive calls.

    First a sine in every joint, measured with errors of sizes from 1e-8 to 0.3 of the limits; then states, and wanted
    ones, anywhere within the limits.
    """
    rng, joints, bounds = np.random.default_rng(seed), policy.joints, bounds_of(policy.parameters)
    at, seen = starts(joints), np.empty((calls, PARTS * joints))
    middle, half = 0.5 * (bounds.low + bounds.high), 0.5 * (bounds.high - bounds.low)
    frequency, begin = rng.uniform(*FREQUENCIES, joints), rng.uniform(0.0, 2.0 * np.pi, joints)
    phase = begin + frequency * policy.control_period * np.arange(calls)[:, np.newaxis]
    radius = 0.3 * half
    motion = [
        middle + radius * np.sin(phase),
        radius * frequency * np.cos(phase),
        -radius * frequency**2 * np.sin(phase),
    ]
    size = 10.0 ** rng.uniform(SMALLEST, LARGEST, (calls, 1))
    error = size * rng.uniform(-1.0, 1.0, (calls, 2 * joints)) * np.concatenate([half, bounds.velocity])
    seen[:, at.q_reference :] = np.concatenate(motion, axis=1)
    seen[:, : at.q_reference] = seen[:, at.q_reference : at.ddq_reference] + error
    last = slice(round((1.0 - SHARE) * calls), calls)
    scales = (half, bounds.velocity, half, bounds.velocity, np.full(joints, 50.0))
    for part, scale in zip(at, scales, strict=True):
        seen[last, part : part + joints] = scale * rng.uniform(-1.0, 1.0, (len(seen[last]), joints))
    return seen


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
    """The functions of an exported law as machine code; n joints."""

    def __init__(self, source: Path, joints: int, memory_size: int, number: str, compiler: str) -> None:
        """Compile the source of an exported law, beside its header; `number` is "double" or "float"."""
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

        Observations are (calls, lanes, 5 n), `starts` (calls, lanes) say whether an episode begins with a call, and the
        memory (lanes, memory_size) is that before the first call, by default zeros.
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


NUMBERS = ("double", "float")  # number types of the C source
UNITS = ("rad", "rad/s", "rad", "rad/s", "rad/s^2")  # of the parts of an observation
_WIDTH = 110
SEED = 2022  # of the test vectors


def export_c(label: str, policy: Policy, folder: str | Path, number: str = "double") -> list[Path]:
    """Write a policy as C99 into a folder, which must exist; return the files.

    They are NAME.h, NAME.c and NAME_vectors.csv, whose torques [N m] are those of the policy in Python; of float those
    of the C itself, and only where there is a compiler. Files of these names are not replaced by those of another law.

    The label of the policy gives files and functions their name, and `number` is a type of `NUMBERS`.

    Raises:
        ValueError: the policy's source has something that cannot be written in C, the law is of no use in float, or
            the folder holds another export of the same name.
        OSError: a file cannot be written.
    """
    choice("number", number, NUMBERS)
    folder, _ = path_of("folder", folder), instance("policy", policy, Policy)  # type: ignore[type-abstract]
    if number == "float" and isinstance(policy, AdaptiveObserverPolicy | LearnedObserverPolicy):
        raise Unsupported(
            f"{label} needs double: in float its covariance loses its digits, and the tip errs by centimetres; "
            'choose number "double"'
        )
    name = c_name(instance("label", label, str))
    texts = sources_of(label, policy, number)
    if number == "double":
        texts[f"{name}_vectors.csv"] = _vectors(policy, policy)
    elif found := compilers():
        with tempfile.TemporaryDirectory() as aside:
            source = write_once(Path(aside), texts)[1]
            law = CompiledLaw(source, policy.joints, policy.memory_size, number, found[0])
            texts[f"{name}_vectors.csv"] = _vectors(policy, law)
    return write_once(Path(folder), texts)


def sources_of(label: str, policy: Policy, number: str) -> dict[str, str]:
    """Return header and source of a policy by the names of their files; arguments and errors as for `export_c`."""
    name = c_name(label)
    try:
        program = program_of(policy)
        source = source_text(program, name, number)
    except Unsupported as error:
        raise ValueError(f"{label} cannot be written in C: {error}; the documentation says which can") from None
    about = _about_policy(name, label, policy, program)
    return {f"{name}.h": header_text(name, about, program, number), f"{name}.c": source}


def c_name(label: str) -> str:
    """Return the name in C of a policy called `label`."""
    name = re.sub(r"\W+", "_", label, flags=re.ASCII).strip("_").lower()
    return name if name and name[0].isalpha() else f"law_{name}".rstrip("_")


def header_text(name: str, about: Sequence[str], program: Recorded, number: str) -> str:
    """Return the C header of a program; its first lines are the paragraphs `about`. The others as for `source_text`."""
    form = textwrap.TextWrapper(_WIDTH, initial_indent=" * ", subsequent_indent=" *   ", break_on_hyphens=False)
    comment, guard = "\n".join(map(form.fill, about)), f"{name.upper()}_H"
    return f"""/*
{comment}
 */
#ifndef {guard}
#define {guard}

#include <float.h>

#if FLT_EVAL_METHOD != 0
#error "numbers must be rounded to their type: on x86 compile with -msse2 -mfpmath=sse"
#endif

#ifdef __cplusplus
extern "C" {{
#endif

typedef struct {{
    {number} memory[{max(program.ports[0], 1)}];
}} {name}_state;

void {name}_init({name}_state *state);

void {name}_step({arguments_text(program, name, number)});

#ifdef __cplusplus
}}
#endif

#endif
"""


def _about_policy(name: str, label: str, policy: Policy, program: Recorded) -> list[str]:
    """Return what the header of a policy says: use, units, limits, and what is proven."""
    joints = policy.joints
    parts = ", ".join(f"{part} [{unit}]" for part, unit in zip(Observation._fields, UNITS, strict=True))
    limits = ", ".join(f"{limit:g}" for limit in per_joint_of(policy.parameters, "torque_limit"))
    certificate, proven = default_certificate(policy), ["Certificate: none."]
    if certificate is not None:
        numbers = ", ".join(f"{key} = {value}" for key, value in certified_numbers(certificate).items())
        scope = "The certificate is of the law in exact arithmetic; rounding is not covered."
        proven = [f"Certificate: {numbers}.", _plain(certificate.text), scope]
    return [
        f"Policy {_plain(label)} of {joints} joints as C99, written by fuzzyarm {__version__} from its Python source.",
        f"Call {name}_init when an episode begins, then {name}_step every {policy.control_period!r} s, and hold the "
        "torques in between.",
        f"observation: {parts}; {joints} numbers each, in this order, measured and asked for at the same instant.",
        f"torque [N m], within the limits ({limits}). The observation and the torques are different arrays.",
        "Not a number in, not a number out: check the sensors before. Angles may be up to 1e6 rad.",
        *proven,
        f"Made from: {program.source}.",
    ]


def _plain(text: str) -> str:
    """Return text that ends no comment and holds no letters beyond ASCII."""
    return text.replace("*/", "* /").encode("ascii", "replace").decode()


def _vectors(policy: Policy, law: Policy | CompiledLaw) -> str:
    """Return the observations and a law's torques of consecutive calls as CSV, with all digits."""
    text = io.StringIO()
    writer, joints = csv.writer(text, lineterminator="\n"), range(policy.joints)
    inputs = [f"{part}{joint + 1}" for part in Observation._fields for joint in joints]
    writer.writerow(["call", *inputs, *(f"torque{joint + 1}" for joint in joints)])
    state = None
    for call, seen in enumerate(random_observations(policy, CALLS, SEED)):
        observation = seen.astype(getattr(law, "number", np.float64))
        torque, state = law.predict(observation, state)
        writer.writerow([call, *map(repr, observation.tolist()), *map(repr, torque.tolist())])
    return text.getvalue()
