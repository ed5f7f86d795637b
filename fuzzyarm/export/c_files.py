"""The files of an exported policy: header, source, and test vectors, in a folder."""

from __future__ import annotations

import csv
import io
import re
import tempfile
import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fuzzyarm import __version__
from fuzzyarm.common.checks import choice, instance, path_of
from fuzzyarm.common.files import write_once
from fuzzyarm.envs.observation import Observation
from fuzzyarm.export.c_program import Program, arguments_text, program_of, source_text
from fuzzyarm.export.compiled_law import CompiledLaw, compilers
from fuzzyarm.export.laws import certificate_of
from fuzzyarm.export.refusals import Unsupported
from fuzzyarm.export.sheet import certified_numbers
from fuzzyarm.export.vectors import CALLS, random_observations
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.proof.policy_certificate import PolicyCertificate
from fuzzyarm.learned_policy.estimate.policy import LearnedObserverPolicy

__all__ = ["NUMBERS", "UNITS", "about_policy", "c_name", "export_c", "header_text", "sources_of"]

NUMBERS = ("double", "float")
"""Number types of the C source."""

UNITS = ("rad", "rad/s", "rad", "rad/s", "rad/s^2")
"""Of the parts of an observation."""
_WIDTH = 110
SEED = 2022  # of the test vectors


def export_c(label: str, policy: Policy, folder: str | Path, number: str = "double") -> list[Path]:
    """Write a policy as C99 into a folder, which must exist; return the files.

    They are NAME.h, NAME.c and NAME_vectors.csv, whose torques [N m] are those of the policy in Python; of float those
    of the C itself, and only where there is a compiler. Files of these names are not replaced by those of another law.

    Args:
        label: of the policy, which gives the files and the functions their name.
        policy: the law.
        folder: where they are written.
        number: of the type in `NUMBERS`.

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
    except Unsupported as error:
        raise ValueError(f"{label} cannot be written in C: {error}; the documentation says which can") from None
    return {
        f"{name}.h": header_text(name, about_policy(name, label, policy, program), program, number),
        f"{name}.c": source_text(program, name, number),
    }


def c_name(label: str) -> str:
    """Return the name in C of a policy called `label`."""
    name = re.sub(r"\W+", "_", label, flags=re.ASCII).strip("_").lower()
    return name if name and name[0].isalpha() else f"law_{name}".rstrip("_")


def header_text(name: str, about: Sequence[str], program: Program, number: str) -> str:
    """Return the C header of a program.

    Args:
        name: what its functions and its struct begin with.
        about: paragraphs of its first lines.
        program: of a policy or a plant.
        number: of the type in `NUMBERS`.
    """
    comment, guard = "\n".join(map(_paragraph, about)), f"{name.upper()}_H"
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
    {number} memory[{max(len(program.memory), 1)}];
}} {name}_state;

void {name}_init({name}_state *state);

void {name}_step({arguments_text(program, name, number)});

#ifdef __cplusplus
}}
#endif

#endif
"""


def about_policy(name: str, label: str, policy: Policy, program: Program) -> list[str]:
    """Return what the header of a policy says: use, units, limits, and what is proven."""
    joints = policy.joints
    parts = ", ".join(f"{part} [{unit}]" for part, unit in zip(Observation._fields, UNITS, strict=True))
    limits = ", ".join(f"{limit:g}" for limit in per_joint_of(policy.parameters, "torque_limit"))
    return [
        f"Policy {_plain(label)} of {joints} joints as C99, written by fuzzyarm {__version__} from its Python source.",
        f"Call {name}_init when an episode begins, then {name}_step every {policy.control_period!r} s, and hold the "
        "torques in between.",
        f"observation: {parts}; {joints} numbers each, in this order, measured and asked for at the same instant.",
        f"torque [N m], within the limits ({limits}). The observation and the torques are different arrays.",
        "Not a number in, not a number out: check the sensors before. Angles may be up to 1e6 rad.",
        *_certificate_lines(certificate_of(policy)),
        f"Made from: {', '.join(program.sources)}.",
    ]


def _paragraph(line: str) -> str:
    return textwrap.fill(line, _WIDTH, initial_indent=" * ", subsequent_indent=" *   ", break_on_hyphens=False)


def _certificate_lines(certificate: PolicyCertificate | None) -> list[str]:
    if certificate is None:
        return ["Certificate: none."]
    numbers = ", ".join(f"{name} = {value}" for name, value in certified_numbers(certificate).items())
    scope = "The certificate is of the law in exact arithmetic; rounding is not covered."
    return [f"Certificate: {numbers}.", _plain(certificate.text), scope]


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
        writer.writerow([call, *map(_exact, observation), *map(_exact, torque)])
    return text.getvalue()


def _exact(number: np.floating) -> str:
    return repr(float(number))
