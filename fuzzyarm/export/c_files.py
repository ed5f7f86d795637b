"""The files of an exported policy: header, source and test vectors; and the exported law compiled, for comparison."""

import ctypes
import hashlib
import json
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm import __version__
from fuzzyarm.common.checks import choice, instance, path_of
from fuzzyarm.common.files import write_once
from fuzzyarm.envs.observation import PARTS, Observation, starts
from fuzzyarm.envs.physics.equations import bounds_of
from fuzzyarm.export._c_text import LARGEST, Recorded, Unsupported, program_of
from fuzzyarm.export.sheet import certified_numbers, default_certificate
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.guest import ShieldedPolicy
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = [
    "COSTS", "FLAGS", "UNITS", "c_name", "certificate_lines", "compilers", "digest_of", "export_c", "sources_of",
]  # fmt: skip


def _random_observations(policy: Policy, calls: int, seed: int) -> np.ndarray:
    """Return observations (calls, 5 n) [rad, rad/s, rad/s²] of consecutive calls.

    The first 80 % follow a sine in every joint, measured with errors of sizes from 1e-8 to 0.3 of the limits; the
    others are random states and references anywhere within the limits.
    """
    rng, joints, bounds = np.random.default_rng(seed), policy.joints, bounds_of(policy.parameters)
    at, seen = starts(joints), np.empty((calls, PARTS * joints))
    middle, half = 0.5 * (bounds.low + bounds.high), 0.5 * (bounds.high - bounds.low)
    frequency, begin = rng.uniform(2.0, 10.0, joints), rng.uniform(0.0, 2.0 * np.pi, joints)  # rad/s, rad
    phase = begin + frequency * policy.control_period * np.arange(calls)[:, np.newaxis]
    radius = 0.3 * half
    sine = middle + radius * np.sin(phase), radius * frequency * np.cos(phase), -radius * frequency**2 * np.sin(phase)
    size = 10.0 ** rng.uniform(-8.0, -0.5, (calls, 1))
    error = size * rng.uniform(-1.0, 1.0, (calls, 2 * joints)) * np.concatenate([half, bounds.velocity])
    seen[:, at.q_reference :] = np.concatenate(sine, axis=1)
    seen[:, : at.q_reference] = seen[:, at.q_reference : at.ddq_reference] + error
    last = seen[round(0.8 * calls) :]  # the random states
    for part, scale in zip(at, (half, bounds.velocity, half, bounds.velocity, np.full(joints, 50.0)), strict=True):
        last[:, part : part + joints] = scale * rng.uniform(-1.0, 1.0, (len(last), joints))
    return seen


FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off", "-O2")
"""Compiler options with which an exported law compiles without a warning and gives the same bits as its policy."""

_LOOP = """#include <string.h>
#include "{name}.h"
void run(long lanes, long calls, const unsigned char *starts, const {real} *seen, {real} *torque, {real} *memory);
void run(long lanes, long calls, const unsigned char *starts, const {real} *seen, {real} *torque, {real} *memory)
{{
    long lane, call;
    for (lane = 0; lane < lanes; lane++) {{
        {name}_state state;
        {name}_init(&state);
        memcpy(state.memory, memory + lane * {size}, sizeof state.memory);
        for (call = 0; call < calls; call++) {{
            const long at = call * lanes + lane;
            if (starts[at]) {{
                {name}_init(&state);
            }}
            (void){name}_step(&state, seen + at * {inputs}, torque + at * {joints});
        }}
        memcpy(memory + lane * {size}, state.memory, sizeof state.memory);
    }}
}}
"""


def compilers() -> list[str]:
    """Return which of the C compilers gcc and clang this machine has, by name."""
    return [name for name in ("gcc", "clang") if shutil.which(name)]


class _CompiledLaw:
    """An exported law as machine code, for n joints."""

    def __init__(self, source: Path, joints: int, memory_size: int, number: str, compiler: str) -> None:
        """Compile the C source of a law in its folder, where the header must be; `number` is "double" or "float"."""
        self.number = np.dtype({"double": np.float64, "float": np.float32}[number])
        self.joints, self.memory_size, name = joints, memory_size, source.stem
        loop, library = source.with_name(f"{name}_loop.c"), source.with_name(f"{name}_{compiler}_{number}.so")
        text = _LOOP.format(name=name, real=number, size=memory_size, inputs=PARTS * joints, joints=joints)
        loop.write_text(text, encoding="utf-8")
        words = [compiler, *FLAGS, "-shared", "-fPIC", str(loop), str(source), "-o", str(library)]
        subprocess.run(words, check=True, capture_output=True, text=True)
        self._run = ctypes.CDLL(str(library)).run

    def run(
        self, observations: np.ndarray, starts: np.ndarray, memory: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return torques (calls, lanes, n) [N m] and the memories (lanes, memory_size) after the last call.

        Observations are (calls, lanes, 5 n); `starts` (calls, lanes) says whether an episode begins at a call; `memory`
        (lanes, memory_size) is the memory before the first call, by default zeros.
        """
        calls, lanes, _ = observations.shape
        seen, begins = np.ascontiguousarray(observations, self.number), np.ascontiguousarray(starts, np.uint8)
        torque = np.empty((calls, lanes, self.joints), self.number)
        kept = np.zeros((lanes, self.memory_size), self.number)
        kept[:] = 0.0 if memory is None else memory
        arrays = [array.ctypes.data_as(ctypes.c_void_p) for array in (begins, seen, torque, kept)]
        self._run(ctypes.c_long(lanes), ctypes.c_long(calls), *arrays)
        return torque, kept

    def predict(
        self,
        observation: np.ndarray,
        state: np.ndarray | None = None,
        episode_start: Any = None,
        deterministic: Any = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return torques (n,) [N m] and the next state for an observation (5 n,): the protocol of all policies."""
        torque, memory = self.run(observation[np.newaxis, np.newaxis], np.array([[state is None]]), state)
        return torque[0, 0].astype(np.float64), memory


UNITS = ("rad", "rad/s", "rad", "rad/s", "rad/s^2")  # of the parts of an observation


def export_c(label: str, policy: Policy, folder: str | Path, number: str = "double") -> list[Path]:
    """Write a policy as C99 into a folder, which must exist; return the files.

    The files are NAME.h, NAME.c and NAME_vectors.csv. The torques [N m] of the test vectors are those of the policy in
    Python, or for float those of the compiled C; without a compiler there are then no test vectors. The label of the
    policy names files and functions; `number`, "double" or "float", is the type of all numbers.

    Raises:
        ValueError: the policy's source has something that cannot be written in C, the law is not accurate in float, or
            the folder contains another export of the same name.
        OSError: a file cannot be written.
    """
    choice("number", number, ("double", "float"))
    folder, _ = path_of("folder", folder), instance("policy", policy, Policy)  # type: ignore[type-abstract]
    inside = policy.guest if isinstance(policy, ShieldedPolicy) else policy
    if number == "float" and isinstance(inside, AdaptiveObserverPolicy | LearnedObserverPolicy):
        raise Unsupported(
            f'{label} needs number = "double" (--number double): with "float", the covariance in its observer loses '
            "precision, and the tip error reaches centimetres"
        )
    name = c_name(instance("label", label, str))
    texts = sources_of(label, policy, number)
    if number == "double":
        texts[f"{name}_vectors.csv"] = _vectors(policy, policy)
    elif found := compilers():
        with tempfile.TemporaryDirectory() as aside:
            source = write_once(Path(aside), texts)[1]
            law = _CompiledLaw(source, policy.joints, policy.memory_size, number, found[0])
            texts[f"{name}_vectors.csv"] = _vectors(policy, law)
    return write_once(Path(folder), texts)


def sources_of(label: str, policy: Policy, number: str, *, limits_given: bool = False) -> dict[str, str]:
    """Return the texts of a policy's C header and source by file name; arguments and errors as for `export_c`.

    With `limits_given`, the memory in C begins with the torque limits [N m], which the caller sets after ``_init``.
    """
    name = c_name(label)
    try:
        program = program_of(policy, limits_given=limits_given)
        source = program.source_text(name, number)
    except Unsupported as error:
        raise ValueError(f"{label} cannot be written in C: {error}; see docs/controllers/export.md") from None
    about = [*_about_policy(name, label, policy, program), _cost_line(label, number, digest_of(source, name))]
    return {f"{name}.h": program.header_text(name, about, number), f"{name}.c": source}


def c_name(label: str) -> str:
    """Return the C identifier for a policy with this label."""
    name = re.sub(r"\W+", "_", label, flags=re.ASCII).strip("_").lower()
    return name if name and name[0].isalpha() else f"law_{name}".rstrip("_")


def _about_policy(name: str, label: str, policy: Policy, program: Recorded) -> list[str]:
    """Return the paragraphs of the comment in a policy's header: use, units, limits and certificate."""
    parts = ", ".join(f"{part} [{unit}]" for part, unit in zip(Observation._fields, UNITS, strict=True))
    limits = ", ".join(f"{limit:g}" for limit in per_joint_of(policy.parameters, "torque_limit"))
    lines = [
        f"Policy {label} of {policy.joints} joints as C99, written by fuzzyarm {__version__} from its Python source.",
        f"Call {name}_init when an episode begins, then {name}_step every {policy.control_period!r} s, and hold the "
        "torques in between. The first call after _init starts from the state that is measured then.",
        f"{name}_step returns 0; or 1 if a number of the observation is not finite or beyond +-{LARGEST:g} (a sensor "
        "drops out): the last torques are held, 0 at first, and the memory is kept; or 2 if the torques would not be "
        "finite: the last ones are held, and the memory is reset. Decide after how many of these in a row the arm has "
        "to stop.",
        "A missed call has the effect of a call that returns 1; the law does not compensate for it. A sensor jump "
        "within that range is treated like a motion, with torques within the limits.",
        f"observation: {parts}; {policy.joints} numbers each, in this order, measurements and reference of the same "
        "instant.",
        f"torque [N m], within the limits ({limits}). The observation and the torques are different arrays.",
        *certificate_lines(policy),
        f"Made from: {program.source}.",
    ]
    # No text may end the comment or contain characters beyond ASCII.
    return [line.replace("*/", "* /").encode("ascii", "replace").decode() for line in lines]


COSTS = Path(__file__).with_name("cortex_m.json")
"""The costs of shipped laws on microcontrollers, written by benchmarks/exported_c.py."""


def digest_of(source: str, name: str) -> str:
    """Return the SHA-256 digest of the C source of a law; it does not depend on the law's name."""
    return hashlib.sha256(source.replace(name, "law").encode()).hexdigest()


def _cost_line(label: str, number: str, digest: str) -> str:
    """Return a sentence on the memory and instructions that a law needs, or a sentence that they were not measured.

    `label` is the law's name, `number` its type of numbers, `digest` that of its source.
    """
    found = json.loads(COSTS.read_text(encoding="utf-8"))
    rows = {core: row for core, row in found["laws"].get(label, {}).items() if row["sha256"] == digest}
    if not rows:
        return "Cost: not measured; benchmarks/exported_c.py of the repository measures it on Cortex-M."
    costs = [
        "{core}: {flash} bytes of flash, {stack} of stack, {state} of state, {mean} instructions a call on average and "
        "{largest} at most in {calls} calls".format(core=core.removesuffix(f" {number}"), **row)
        for core, row in rows.items()
    ]
    return (
        f"Cost, measured with {found['made']}: {'; '.join(costs)}. Library routines of the compiler are not in flash."
    )


def certificate_lines(policy: Policy) -> list[str]:
    """Return sentences on what is proven about a policy."""
    certificate = default_certificate(policy)
    if certificate is None:
        return ["Certificate: none."]
    numbers = ", ".join(f"{key} = {value}" for key, value in certified_numbers(certificate).items())
    scope = "The certificate is of the law in exact arithmetic; rounding is not covered."
    return [f"Certificate: {numbers}.", certificate.text, scope]


def _vectors(policy: Policy, law: Policy | _CompiledLaw) -> str:
    """Return random observations of `policy` and the torques of `law` in consecutive calls as CSV, with all digits."""
    joints, state = range(1, policy.joints + 1), None
    names = [f"{part}{joint}" for part in (*Observation._fields, "torque") for joint in joints]
    rows: list[list[Any]] = [["call", *names]]
    for call, seen in enumerate(_random_observations(policy, calls=200, seed=2022)):
        observation = seen.astype(getattr(law, "number", np.float64))
        torque, state = law.predict(observation, state)
        rows.append([call, *observation.tolist(), *torque.tolist()])
    return "".join(",".join(map(str, row)) + "\n" for row in rows)
