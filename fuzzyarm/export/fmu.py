"""A policy or a plant as an FMI 2.0 co-simulation FMU with source: the exported C, and what a host needs around it.

A communication step of a controller is its control period: the law acts on the inputs at the beginning of the step, and
its torques hold during it. A step of a plant is a whole number of control periods. A host that steps the controller,
passes the torques on and then steps the plant does what the environment's loop does, to the bit.
"""

from __future__ import annotations

import io
import re
import sys
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from fuzzyarm import __version__
from fuzzyarm.common.files import write_once
from fuzzyarm.envs.arguments import observation_space
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of
from fuzzyarm.envs.physics.parameters import LARGEST, ArmParameters
from fuzzyarm.export.c_files import UNITS, c_name, header_text, sources_of
from fuzzyarm.export.c_text import MODEL, Recorded, source_text
from fuzzyarm.export.plant import Plant
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["PLANT", "export_controller_fmu", "export_plant_fmu"]

_IDLE = {
    "fmi2SetDebugLogging": "fmi2Boolean on, size_t n, const fmi2String categories[]",
    "fmi2SetupExperiment": "fmi2Boolean bounded, fmi2Real tolerance, fmi2Real start, fmi2Boolean ends, fmi2Real stop",
    "fmi2EnterInitializationMode": "",
    "fmi2Terminate": "",
}
"""Functions that have nothing to do, with their arguments: only errors are logged, no law depends on the time."""

_KINDS, _PORTS = ("Integer", "Boolean", "String"), "const fmi2ValueReference vr[], size_t nvr, "
_EXCUSED = {
    **{f"fmi2Get{kind}": f"{_PORTS}fmi2{kind} value[]" for kind in _KINDS},
    **{f"fmi2Set{kind}": f"{_PORTS}const fmi2{kind} value[]" for kind in _KINDS},
    "fmi2GetFMUstate": "fmi2FMUstate *state",
    "fmi2SetFMUstate": "fmi2FMUstate state",
    "fmi2FreeFMUstate": "fmi2FMUstate *state",
    "fmi2SerializedFMUstateSize": "fmi2FMUstate state, size_t *size",
    "fmi2SerializeFMUstate": "fmi2FMUstate state, fmi2Byte bytes[], size_t size",
    "fmi2DeSerializeFMUstate": "const fmi2Byte bytes[], size_t size, fmi2FMUstate *state",
    "fmi2GetDirectionalDerivative": "const fmi2ValueReference unknown[], size_t nUnknown, "
    "const fmi2ValueReference known[], size_t nKnown, const fmi2Real seed[], fmi2Real value[]",
    "fmi2SetRealInputDerivatives": f"{_PORTS}const fmi2Integer order[], const fmi2Real value[]",
    "fmi2GetRealOutputDerivatives": f"{_PORTS}const fmi2Integer order[], fmi2Real value[]",
    "fmi2CancelStep": "",
    "fmi2GetStatus": "fmi2StatusKind kind, fmi2Status *value",
    **{f"fmi2Get{kind}Status": f"fmi2StatusKind kind, fmi2{kind} *value" for kind in ("Real", *_KINDS)},
}
"""Functions of the standard that this FMU declares no ability for, with their arguments."""

_TYPES = """
/* The types of FMI 2.0 (fmi2TypesPlatform.h, fmi2FunctionTypes.h), written down here so that no header is needed. */
typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

#if defined(FMI2_FUNCTION_PREFIX)
#define JOINED_(a, b) a##b
#define JOINED(a, b) JOINED_(a, b)
#define NAMED(name) JOINED(FMI2_FUNCTION_PREFIX, name)
#define OPEN
#else
#define NAMED(name) name
#if defined(_WIN32)
#define OPEN __declspec(dllexport)
#else
#define OPEN
#endif
#endif
"""

_BODY = """
enum { GIVEN = @given@, SHOWN = @shown@, RESULTS = @results@, NAME = 256 };

static const double period = @period@; /* s, of a control step */

/* What may be set, in the order of its value references: the name, and the ends of its range in its unit. */
static const struct {
    const char *name;
    double low;
    double high;
} range[GIVEN + SHOWN] = {
@ranges@
};

typedef struct {
    @name@_state state;
    double given[GIVEN];
    double result[RESULTS];
    int running;
    char name[NAME];
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void (*release)(void *);
    fmi2ComponentEnvironment environment;
} Instance;

static fmi2Status refused(const Instance *own, fmi2String text)
{
    if (own->logger != NULL) {
        own->logger(own->environment, own->name, fmi2Error, "logStatusError", "%s", text);
    }
    return fmi2Error;
}

/* Whether a number may be set; otherwise its range is logged. */
static int within(const Instance *own, fmi2ValueReference vr, double value)
{
    const int inside = (value >= range[vr].low) && (value <= range[vr].high);
    if ((inside == 0) && (own->logger != NULL)) {
        own->logger(own->environment, own->name, fmi2Error, "logStatusError",
            "%s = %.9g is out of range; allowed: %.9g to %.9g", range[vr].name, value, range[vr].low, range[vr].high);
    }
    return inside;
}

/* What a value reference stands for: what is given, then what of the memory is shown, then the results. */
static double *place(Instance *own, fmi2ValueReference vr)
{
    double *found = NULL;
    if (vr < (fmi2ValueReference)GIVEN) {
        found = &own->given[vr];
    } else if (vr < (fmi2ValueReference)(GIVEN + SHOWN)) {
        found = &own->state.memory[vr - GIVEN];
    } else if (vr < (fmi2ValueReference)(GIVEN + SHOWN + RESULTS)) {
        found = &own->result[vr - GIVEN - SHOWN];
    } else {
        found = NULL;
    }
    return found;
}

static void show(Instance *own)
{
@show@
}

static void begin(Instance *own)
{
    int k;
    @name@_init(&own->state);
    for (k = 0; k < GIVEN; k++) {
        own->given[k] = 0.0;
    }
    for (k = 0; k < RESULTS; k++) {
        own->result[k] = 0.0;
    }
@started@
    show(own);
    own->running = 0;
}

OPEN const char *NAMED(fmi2GetTypesPlatform)(void)
{
    return "default";
}

OPEN const char *NAMED(fmi2GetVersion)(void)
{
    return "2.0";
}

OPEN fmi2Component NAMED(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    Instance *own = NULL;
    Instance first;
    (void)resources;
    (void)visible;
    (void)logging;
    if ((functions == NULL) || (functions->allocateMemory == NULL) || (functions->freeMemory == NULL)) {
        return NULL; /* no FMI 2.0 host calls so, and there is nobody to tell */
    }
    memset(&first, 0, sizeof first);
    (void)strncpy(first.name, (name != NULL) ? name : "@name@", (size_t)NAME - 1U); /* the host may reuse its text */
    first.logger = functions->logger;
    first.release = functions->freeMemory;
    first.environment = functions->componentEnvironment;
    if (type != fmi2CoSimulation) {
        (void)refused(&first, "@name@ is an FMI 2.0 FMU for co-simulation: choose co-simulation in the host");
    } else if ((guid == NULL) || (strcmp(guid, "@guid@") != 0)) {
        (void)refused(&first, "the GUID is not that of @name@: the host read the description of another version; "
            "export the FMU again");
    } else {
        own = (Instance *)functions->allocateMemory(1, sizeof first);
        if (own == NULL) {
            (void)refused(&first, "the host has no memory for an instance of @name@");
        } else {
            *own = first;
            begin(own);
        }
    }
    return own;
}

OPEN void NAMED(fmi2FreeInstance)(fmi2Component c)
{
    if (c != NULL) {
        ((Instance *)c)->release(c);
    }
}

OPEN fmi2Status NAMED(fmi2ExitInitializationMode)(fmi2Component c)
{
    show((Instance *)c);
    ((Instance *)c)->running = 1;
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2Reset)(fmi2Component c)
{
    begin((Instance *)c);
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2GetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    Instance *own = (Instance *)c;
    size_t k;
    if (own->running == 0) {
        show(own);
    }
    for (k = 0; k < nvr; k++) {
        const double *from = place(own, vr[k]);
        if (from == NULL) {
            return refused(own, "fmi2GetReal of a value reference that @name@ does not have");
        }
        value[k] = *from;
    }
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2SetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    Instance *own = (Instance *)c;
    const fmi2ValueReference open = (fmi2ValueReference)((own->running != 0) ? GIVEN : (GIVEN + SHOWN));
    size_t k;
    for (k = 0; k < nvr; k++) {
        if (vr[k] >= open) {
            return refused(own, "fmi2SetReal of an output, or of a start value or parameter after the initialization");
        }
        if (within(own, vr[k], value[k]) == 0) {
            return fmi2Error;
        }
        *place(own, vr[k]) = value[k];
    }
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2DoStep)(fmi2Component c, fmi2Real now, fmi2Real size, fmi2Boolean keeps)
{
    Instance *own = (Instance *)c;
    const double count = size / period;
    const long steps = ((count > 0.5) && (count < 1e9)) ? (long)(count + 0.5) : 0;
    const double rest = (((double)steps) * period) - size;
    /* Two instants that the host subtracts are rounded: 2^-51 of a late one is more than a millionth of a period. */
    const double late = ((now < 0.0) ? -now : now) * 4.44e-16;
    const double slack = (late < (0.25 * period)) ? (late + (1e-6 * period)) : (0.25 * period);
    long step;
    int k;
    (void)keeps;
    if ((steps < 1) || (rest > slack) || (rest < -slack)@single@) {
        return refused(own, "the communication step size of @name@ must be @allowed@");
    }
    for (step = 0; step < steps; step++) {
        @name@_step(&own->state, own->given, own->result);
    }
    for (k = 0; k < RESULTS; k++) {
        if ((own->result[k] - own->result[k]) != 0.0) {
            return refused(own, "an output of @name@ is not finite any more");
        }
    }
    return fmi2OK;
}
"""


def _fmu_source(name: str, numbers: Mapping[str, str]) -> str:
    """Return the C source of the FMU of a program.

    `numbers` are texts for the marks of the source: guid, given, shown, results, period; code for ranges, show, started
    and single; and allowed, the step sizes in words.
    """
    text = f'#include "{name}.h"\n@include@\n#include <stddef.h>\n#include <string.h>\n{_TYPES}{_BODY}'
    for function, arguments in (_IDLE | _EXCUSED).items():
        words = ["c", *re.findall(r"(\w+)(?:\[\])?(?:,|$)", arguments)]
        unused = "".join(f"    (void){word};\n" for word in words[function in _EXCUSED :])
        answer = "fmi2OK" if function in _IDLE else f'refused((Instance *)c, "@name@ has no {function}")'
        given = ", ".join(["fmi2Component c", *([arguments] if arguments else [])])
        text += f"\nOPEN fmi2Status NAMED({function})({given})\n{{\n{unused}    return {answer};\n}}\n"
    text = re.sub(r"^(OPEN [^;{]*?\))\n\{", r"\1;\n\1\n{", text, flags=re.MULTILINE)  # a declaration before each
    return re.sub(r"@(\w+)@", lambda mark: {**numbers, "name": name}[mark[1]], text)


PLANT = "plant"  # what the plant is called beside the names of policies
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
_TIME = (1980, 1, 1, 0, 0, 0)  # of the files in the archive: the same export gives the same bytes


class _Variable(NamedTuple):
    """A real number of a model: name, unit, "input", "output" or "parameter", its value at the start or None.

    What a host may set has the range `low` to `high` of the environment, any finite number if nothing else is said.
    """

    name: str
    unit: str
    causality: str
    start: float | None
    low: float = -sys.float_info.max
    high: float = sys.float_info.max


def export_controller_fmu(label: str, policy: Policy, folder: Path) -> Path:
    """Write a policy as an FMU, named after its label, into a folder, which must exist; return the file.

    Inputs are the numbers of an observation, q_motor1, ..., ddq_reference1, ... [rad, rad/s, rad/s²], outputs the
    torques [N m]. ValueError if the policy's source has something that cannot be written in C, or the folder holds
    another FMU of this name; OSError if the file cannot be written.
    """
    joints, name, box = range(1, policy.joints + 1), c_name(label), observation_space([policy.parameters])
    names = [(f"{part}{k}", unit) for part, unit in zip(Observation._fields, UNITS, strict=True) for k in joints]
    variables = [
        _Variable(*named, "input", min(max(0.0, low), high), low, high)
        for named, low, high in zip(names, box.low.tolist(), box.high.tolist(), strict=True)
    ]
    lines = [f"    own->given[{k}] = {one.start!r};" for k, one in enumerate(variables) if one.start]
    variables += [_Variable(f"torque{joint}", "N.m", "output", 0.0) for joint in joints]
    code = {
        **{"show": "    (void)own;", "shown": "0", "given": str(len(names)), "results": str(len(joints))},
        **{"include": "", "started": "\n".join(lines), "single": " || (steps != 1)"},
        **{"period": repr(policy.control_period), "allowed": f"the control period, {policy.control_period!r} s"},
    }
    return _write(name, sources_of(label, policy, "double"), variables, code, folder)


def export_plant_fmu(arm: AnyArm, folder: Path, control_period: float = 1e-3) -> Path:
    """Write an arm as an FMU into a folder, which must exist; return the file.

    Inputs are the motor torques [N m] and a force on the tip [N], outputs the 4 n numbers of the state [rad, rad/s] and
    the place of the tip [m]; a parameter is the mass of a payload at the tip [kg]. The start is that of the
    environment, or the hanging arm where its motion is out of reach; a host may set another one. ValueError if the
    control period [s] is out of range, or the folder holds another FMU of this name; OSError if the file cannot be
    written.
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
        made_from, given = f"export.plant.Plant.{function.__name__}", (names, (0.0,) * len(names))
        program = Recorded(function, given, memory, plant.axes, MODEL, made_from)
        about = [
            f"{what} as C99, written by fuzzyarm {__version__} from the functions that its environment steps.",
            f"{name}_step is a control period of {control_period!r} s.",
            f"Made from: {made_from}.",
        ]
        sources[f"{name}.h"] = header_text(name, about, program, "double")
        sources[f"{name}.c"] = source_text(program, name, "double")
    lines = [f"    own->state.memory[{k}] = {value!r};" for k, value in enumerate(start)]
    code = {
        "show": "    tip_state none;\n    tip_init(&none);\n"
        f"    tip_step(&none, &own->state.memory[{plant.joints}], own->result);",
        **{"given": str(len(inputs)), "shown": str(len(shown)), "results": str(len(results))},
        **{"include": '#include "tip.h"', "started": "\n".join(lines), "single": ""},
        **{"period": repr(control_period), "allowed": f"a whole number of control periods of {control_period!r} s"},
    }
    return _write(PLANT, sources, [*inputs, *shown, *results], code, folder)


def _start(arm: AnyArm) -> list[float]:
    """Return the state (4 n) with which an episode begins, in the order of `State`."""
    try:
        env = FuzzyArmEnv(parameters=arm) if isinstance(arm, ArmParameters) else FuzzyArmEnv(robot=arm)
    except ValueError:  # the default motion is out of reach
        return [0.0] * (len(_PARTS) * Plant(arm).joints)
    _, info = env.reset(seed=0)
    return [float(number) for part, _ in _PARTS for number in info[part]]


def _write(
    name: str,
    sources: dict[str, str],
    variables: Sequence[_Variable],
    code: dict[str, str],
    folder: Path,
) -> Path:
    """Write the archive, whose GUID follows from its content; `code` as for `_fmu_source`."""
    settable = variables[: int(code["given"]) + int(code["shown"])]
    ranges = [f'    {{"{one.name} [{one.unit}]", {one.low!r}, {one.high!r}}}' for one in settable]
    code = {**code, "ranges": ",\n".join(ranges)}
    whole = "\n".join([*sources.values(), *map(repr, variables), *code.values()])
    guid = "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, whole)) + "}"
    files = {f"sources/{file}": text for file, text in sources.items()}
    files["sources/fmu.c"] = _fmu_source(name, {**code, "guid": guid})
    compiled = [file.removeprefix("sources/") for file in files if file.endswith(".c")]
    files["modelDescription.xml"] = _description(name, guid, variables, compiled, code["period"], bool(code["single"]))
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(files):
            archive.writestr(zipfile.ZipInfo(file, _TIME), files[file], zipfile.ZIP_DEFLATED)
    return write_once(folder, {f"{name}.fmu": content.getvalue()})[0]


def _description(
    name: str, guid: str, variables: Sequence[_Variable], files: Sequence[str], period: str, fixed: bool
) -> str:
    """Return modelDescription.xml; a step is the period [s] if it is `fixed`."""
    used = {variable.unit for variable in variables}
    units = [f'    <Unit name="{unit}"><BaseUnit {base}/></Unit>' for unit, base in _UNITS.items() if unit in used]
    outputs = [(k, one) for k, one in enumerate(variables, start=1) if one.causality == "output"]
    unknown = [f'      <Unknown index="{k}"/>' for k, one in outputs if one.start is None]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(name)} guid="{guid}" '
        f'generationTool="fuzzyarm {__version__}" variableNamingConvention="flat" numberOfEventIndicators="0">',
        f'  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="{str(not fixed).lower()}">',
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
    if one.causality != "output" and one.high < sys.float_info.max:  # an output may leave the range of its start
        start = f' min="{one.low!r}" max="{one.high!r}"{start}'
    initial = {"input": "", "output": "exact" if start else "calculated", "parameter": "exact"}[one.causality]
    kind = f' initial="{initial}"' if initial else ""
    held = one.causality == "output" and one.unit == "N.m"
    variability = "fixed" if one.causality == "parameter" else "discrete" if held else "continuous"
    return (
        f'    <ScalarVariable name="{one.name}" valueReference="{reference}" causality="{one.causality}" '
        f'variability="{variability}"{kind}><Real unit="{one.unit}"{start}/></ScalarVariable>'
    )
