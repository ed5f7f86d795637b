"""A policy or plant as an FMI 2.0 co-simulation FMU: the exported C and the functions of FMI, as source and compiled.

A communication step of a controller is its control period: the law acts on the inputs at its beginning, and its torques
are held. A step of a plant is a whole number of control periods. A host that steps the controller, passes the torques
on and then steps the plant reproduces the environment's loop, bit for bit.
"""

import io
import re
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

from fuzzyarm import __version__
from fuzzyarm.common.files import write_once
from fuzzyarm.envs.arguments import observation_space
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of
from fuzzyarm.envs.physics.parameters import LARGEST, ArmParameters
from fuzzyarm.export._c_text import MODEL, Recorded
from fuzzyarm.export._plant import Plant
from fuzzyarm.export.c_files import FLAGS, UNITS, c_name, compilers, sources_of
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["PLANT", "export_controller_fmu", "export_plant_fmu"]

_IDLE = {
    "fmi2SetDebugLogging": "fmi2Boolean on, size_t n, const fmi2String categories[]",
    "fmi2SetupExperiment": "fmi2Boolean bounded, fmi2Real tolerance, fmi2Real start, fmi2Boolean ends, fmi2Real stop",
    "fmi2EnterInitializationMode": "",
    "fmi2Terminate": "",
}
"""Functions with nothing to do, with their arguments: only errors are logged, and no law depends on the time."""

_KINDS, _PORTS = ("Integer", "Boolean", "String"), "const fmi2ValueReference vr[], size_t nvr, "
_EXCUSED = {
    **{f"fmi2Get{kind}": f"{_PORTS}fmi2{kind} value[]" for kind in _KINDS},
    **{f"fmi2Set{kind}": f"{_PORTS}const fmi2{kind} value[]" for kind in _KINDS},
    "fmi2GetDirectionalDerivative": "const fmi2ValueReference unknown[], size_t nUnknown, "
    "const fmi2ValueReference known[], size_t nKnown, const fmi2Real seed[], fmi2Real value[]",
    "fmi2SetRealInputDerivatives": f"{_PORTS}const fmi2Integer order[], const fmi2Real value[]",
    "fmi2GetRealOutputDerivatives": f"{_PORTS}const fmi2Integer order[], fmi2Real value[]",
    "fmi2CancelStep": "",
    "fmi2GetStatus": "fmi2StatusKind kind, fmi2Status *value",
    **{f"fmi2Get{kind}Status": f"fmi2StatusKind kind, fmi2{kind} *value" for kind in ("Real", *_KINDS)},
}
"""Functions of capabilities that these FMUs do not declare, with their arguments."""

_TEMPLATE = Path(__file__).with_name("fmu.c")  # with @marks@ for what differs between models


def _fmu_source(name: str, numbers: Mapping[str, str]) -> str:
    """Return the C source of an FMU: the template ``fmu.c``, with a text in place of each mark.

    `name` is the model's name. `numbers` has code or numbers in C for the marks guid, given, shown, results, period,
    include, ranges, show, started and single, and for the mark allowed the permitted step sizes in words.
    """
    text = _TEMPLATE.read_text(encoding="utf-8")
    for function, arguments in (_IDLE | _EXCUSED).items():
        words = ["c", *re.findall(r"(\w+)(?:\[\])?(?:,|$)", arguments)]
        unused = "".join(f"    (void){word};\n" for word in words[function in _EXCUSED :])
        answer = "fmi2OK" if function in _IDLE else f'refused((Instance *)c, "@name@ has no {function}")'
        given = ", ".join(["fmi2Component c", *([arguments] if arguments else [])])
        text += f"\nOPEN fmi2Status NAMED({function})({given})\n{{\n{unused}    return {answer};\n}}\n"
    text = re.sub(r"^(OPEN [^;{]*?\))\n\{", r"\1;\n\1\n{", text, flags=re.MULTILINE)  # adds declarations
    return re.sub(r"@(\w+)@", lambda mark: {**numbers, "name": name}[mark[1]], text)


PLANT = "plant"  # the name of the FMU of the plant
_PARTS = (("q_motor", "rad"), ("q_link", "rad"), ("dq_motor", "rad/s"), ("dq_link", "rad/s"))  # in the order of `State`
_UNITS = {
    "rad": 'rad="1"',
    "rad/s": 's="-1" rad="1"',
    "rad/s^2": 's="-2" rad="1"',
    "N": 'kg="1" m="1" s="-2"',
    "N.m": 'kg="1" m="2" s="-2"',
    "m": 'm="1"',
    "kg": 'kg="1"',
}
_PLATFORMS = {"linux": ("linux64", ".so"), "darwin": ("darwin64", ".dylib"), "win32": ("win64", ".dll")}
_TIME = (1980, 1, 1, 0, 0, 0)  # of the files in the archive; fixed, so that the same export gives the same bytes


class _Variable(NamedTuple):
    """A real variable of a model; `causality` is "input", "output" or "parameter", `start` the initial value or None.

    A host may set inputs and parameters between `low` and `high`, by default to any finite number.
    """

    name: str
    unit: str
    causality: str
    start: float | None
    low: float = -sys.float_info.max
    high: float = sys.float_info.max


def export_controller_fmu(label: str, policy: Policy, folder: Path) -> Path:
    """Write a policy as an FMU, named after its label, into a folder, which must exist; return the file.

    Inputs are the entries of an observation, q_motor1, ..., ddq_reference1, ... [rad, rad/s, rad/s²], outputs the
    torques [N m], and parameters their limits, which can be lowered. ValueError if the policy's source has something
    that cannot be written in C, or the folder has another FMU of this name; OSError if the file cannot be written.
    """
    joints, name, box = range(1, policy.joints + 1), c_name(label), observation_space([policy.parameters])
    names = [(f"{part}{k}", unit) for part, unit in zip(Observation._fields, UNITS, strict=True) for k in joints]
    variables = [
        _Variable(*named, "input", min(max(0.0, low), high), low, high)
        for named, low, high in zip(names, box.low.tolist(), box.high.tolist(), strict=True)
    ]
    lines = [f"    own->now.given[{k}] = {one.start!r};" for k, one in enumerate(variables) if one.start]
    limits = [float(limit) for limit in policy.torque_limit]
    lines += [f"    own->now.state.memory[{k}] = {limit!r};" for k, limit in enumerate(limits)]
    variables += [
        _Variable(f"torque_limit{joint}", "N.m", "parameter", limit, 0.0, limit)
        for joint, limit in zip(joints, limits, strict=True)
    ]
    variables += [_Variable(f"torque{joint}", "N.m", "output", 0.0) for joint in joints]
    code = {
        **{"show": "    (void)own;", "shown": str(len(limits)), "given": str(len(names)), "results": str(len(joints))},
        **{"include": "", "started": "\n".join(lines), "single": " || (steps != 1)"},
        **{"period": repr(policy.control_period), "allowed": f"the control period, {policy.control_period!r} s"},
    }
    return _write(name, sources_of(label, policy, "double", limits_given=True), variables, code, folder)


def export_plant_fmu(arm: AnyArm, folder: Path, control_period: float = 1e-3) -> Path:
    """Write an arm as an FMU into a folder, which must exist; return the file.

    Inputs are the motor torques [N m] and a force on the tip [N]; outputs are the 4 n entries of the state [rad, rad/s]
    and the position of the tip [m]; the mass of a payload at the tip [kg] is a parameter. The initial state is the
    environment's, or the hanging arm if the default motion is out of reach; a host may set another. ValueError: the
    control period [s] is out of range, or the folder has another FMU of this name; OSError: the file cannot be written.
    """
    plant, start = Plant(arm, control_period), _start(arm)
    joints, axes = range(1, plant.joints + 1), "xyz"[: plant.axes]
    inputs = [_Variable(f"torque{joint}", "N.m", "input", 0.0) for joint in joints]
    inputs += [_Variable(f"force_{axis}", "N", "input", 0.0, -LARGEST, LARGEST) for axis in axes]
    states = [(f"{part}{joint}", unit) for part, unit in _PARTS for joint in joints]
    low, high, speed, _ = bounds_of(arm)
    ends = zip((*low, *low, *-speed, *-speed), (*high, *high, *speed, *speed), strict=True)
    shown = [
        _Variable(*named, "output", value, float(least), float(most))
        for named, value, (least, most) in zip(states, start, ends, strict=True)
    ]
    shown.append(_Variable("payload", "kg", "parameter", 0.0, 0.0, LARGEST))
    results = [_Variable(f"tip_{axis}", "m", "output", None) for axis in axes]
    sources: dict[str, str] = {}
    for name, what, function, names, memory in (
        (PLANT, "Arm", plant.step, [one.name for one in inputs], plant.memory),
        ("tip", "Place of the tip of an arm", plant.place, [f"q_link{joint}" for joint in joints], ()),
    ):
        made_from, given = f"export._plant.Plant.{function.__name__}", (names, (0.0,) * len(names))
        program = Recorded(function, given, memory, plant.axes, MODEL, made_from)
        about = [
            f"{what} as C99, written by fuzzyarm {__version__} from the functions that its environment steps.",
            f"{name}_step is a control period of {control_period!r} s.",
            f"Made from: {made_from}.",
        ]
        sources[f"{name}.h"] = program.header_text(name, about, "double")
        sources[f"{name}.c"] = program.source_text(name, "double")
    lines = [f"    own->now.state.memory[{k}] = {value!r};" for k, value in enumerate(start)]
    code = {
        "show": "    tip_state none;\n    tip_init(&none);\n"
        f"    (void)tip_step(&none, &own->now.state.memory[{plant.joints}], own->now.result);",
        **{"given": str(len(inputs)), "shown": str(len(shown)), "results": str(len(results))},
        **{"include": '#include "tip.h"', "started": "\n".join(lines), "single": ""},
        **{"period": repr(control_period), "allowed": f"a whole number of control periods of {control_period!r} s"},
    }
    return _write(PLANT, sources, [*inputs, *shown, *results], code, folder)


def _start(arm: AnyArm) -> list[float]:
    """Return the initial state (4 n) [rad, rad/s], see `export_plant_fmu`."""
    try:
        env = FuzzyArmEnv(parameters=arm) if isinstance(arm, ArmParameters) else FuzzyArmEnv(robot=arm)
    except ValueError:  # the default motion is out of reach
        return [0.0] * (len(_PARTS) * Plant(arm).joints)
    _, info = env.reset(seed=0)
    return [float(number) for part, _ in _PARTS for number in info[part]]


def _binary(name: str, sources: Mapping[str, str]) -> dict[str, bytes]:
    """Return the compiled library for this machine by its name in the archive; empty if there is no C compiler."""
    place, found = _PLATFORMS.get(sys.platform), compilers()
    if not (place and found and sys.maxsize > 2**32):
        return {}
    with tempfile.TemporaryDirectory() as aside:
        files = [Path(aside) / Path(file).name for file in sources]
        for file, text in zip(files, sources.values(), strict=True):
            file.write_text(text, encoding="utf-8")
        library, units = Path(aside) / "library", [str(file) for file in files if file.suffix == ".c"]
        words = [found[0], *FLAGS, "-shared", "-fPIC", *units, "-o", str(library)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode:
            raise ValueError(f"{found[0]} failed to compile the FMU {name}: {' '.join(done.stderr.split())[-200:]}")
        return {f"binaries/{place[0]}/{name}{place[1]}": library.read_bytes()}


def _write(
    name: str, sources: dict[str, str], variables: Sequence[_Variable], code: dict[str, str], folder: Path
) -> Path:
    """Write an FMU of `sources` (C by file name) and `code` (see `_fmu_source`) into `folder`; return the file.

    Its GUID is a hash of its content.
    """
    settable = variables[: int(code["given"]) + int(code["shown"])]
    ranges = [f'    {{"{one.name} [{one.unit}]", {one.low!r}, {one.high!r}}}' for one in settable]
    code = {**code, "ranges": ",\n".join(ranges)}
    whole = "\n".join([*sources.values(), *map(repr, variables), *code.values()])
    guid = "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, whole)) + "}"
    files: dict[str, Any] = {f"sources/{file}": text for file, text in sources.items()}
    files["sources/fmu.c"] = _fmu_source(name, {**code, "guid": guid})
    compiled = [file.removeprefix("sources/") for file in files if file.endswith(".c")]
    files |= _binary(name, files)
    files["modelDescription.xml"] = _description(name, guid, variables, compiled, code["period"], bool(code["single"]))
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(files):
            archive.writestr(zipfile.ZipInfo(file, _TIME), files[file], zipfile.ZIP_DEFLATED)
    return write_once(folder, {f"{name}.fmu": content.getvalue()})[0]


def _description(
    name: str, guid: str, variables: Sequence[_Variable], files: Sequence[str], period: str, fixed: bool
) -> str:
    """Return the text of modelDescription.xml; `files` are C sources; if `fixed`, a step must be one `period` [s]."""
    used = {variable.unit for variable in variables}
    units = [f'    <Unit name="{unit}"><BaseUnit {base}/></Unit>' for unit, base in _UNITS.items() if unit in used]
    outputs = [(k, one) for k, one in enumerate(variables, start=1) if one.causality == "output"]
    unknown = [f'      <Unknown index="{k}"/>' for k, one in outputs if one.start is None]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(name)} guid="{guid}" '
        f'generationTool="fuzzyarm {__version__}" variableNamingConvention="flat" numberOfEventIndicators="0">',
        f'  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="{str(not fixed).lower()}" '
        'canGetAndSetFMUstate="true" canSerializeFMUstate="true">',
        "    <SourceFiles>",
        *(f'      <File name="{file}"/>' for file in files),
        "    </SourceFiles>",
        "  </CoSimulation>",
        "  <UnitDefinitions>",
        *units,
        "  </UnitDefinitions>",
        f'  <DefaultExperiment startTime="0" stepSize="{period}"/>',
        "  <ModelVariables>",
        *(_variable(k, variable) for k, variable in enumerate(variables)),
        "  </ModelVariables>",
        "  <ModelStructure>",
        "    <Outputs>",
        *(f'      <Unknown index="{k}"/>' for k, _ in outputs),
        "    </Outputs>",
        *(["    <InitialUnknowns>", *unknown, "    </InitialUnknowns>"] if unknown else []),
        "  </ModelStructure>",
        "</fmiModelDescription>",
    ]
    return "\n".join(lines) + "\n"


def _variable(reference: int, one: _Variable) -> str:
    start = "" if one.start is None else f' start="{one.start!r}"'
    if one.causality != "output" and one.high < sys.float_info.max:  # an output may leave its initial range
        start = f' min="{one.low!r}" max="{one.high!r}"{start}'
    initial = {"input": "", "output": "exact" if start else "calculated", "parameter": "exact"}[one.causality]
    kind = f' initial="{initial}"' if initial else ""
    held = one.causality == "output" and one.unit == "N.m"
    variability = "fixed" if one.causality == "parameter" else "discrete" if held else "continuous"
    return (
        f'    <ScalarVariable name="{one.name}" valueReference="{reference}" causality="{one.causality}" '
        f'variability="{variability}"{kind}><Real unit="{one.unit}"{start}/></ScalarVariable>'
    )
