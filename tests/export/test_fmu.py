"""FMUs of controller and plant: driven as an FMI 2.0 host drives them, they are the environment's loop, bit by bit."""

import ctypes
import subprocess
import xml.etree.ElementTree as ET
import zipfile

import numpy as np
import pytest
from support.exported import COMPILERS, needs_compiler

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.export.c_files import FLAGS

CO_SIMULATION, MODEL_EXCHANGE, OK, ERROR = 1, 0, 0, 3
PERIOD = 1e-3
LOG = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p, ctypes.c_char_p
)
ALLOCATE = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)
RELEASE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


class Callbacks(ctypes.Structure):
    _fields_ = (
        ("logger", LOG),
        ("allocate", ALLOCATE),
        ("release", RELEASE),
        ("finished", ctypes.c_void_p),
        ("environment", ctypes.c_void_p),
    )


class Host:
    """A small FMI 2.0 host: reads the description of an FMU and drives an instance; a compiler compiles the sources."""

    def __init__(self, file, compiler=None):
        folder = file.with_suffix("")
        if not folder.exists():  # a library that is loaded is not written over
            with zipfile.ZipFile(file) as archive:
                archive.extractall(folder)
        root = ET.parse(folder / "modelDescription.xml").getroot()
        variables = {one.get("name"): one for one in root.iter("ScalarVariable")}
        self.references = {name: int(one.get("valueReference")) for name, one in variables.items()}
        reals = [(name, one.find("Real")) for name, one in variables.items()]
        self.stated = [(name, one.get("min"), one.get("max")) for name, one in reals if one.get("min")]
        self.guid, self.messages, self.names = root.get("guid").encode(), [], []
        (library,) = folder.glob("binaries/*/*")
        if compiler:
            sources = [str(folder / "sources" / one.get("name")) for one in root.iter("File")]
            library = folder / "model.so"
            words = [compiler, *FLAGS, "-shared", "-fPIC", *sources, "-o", str(library)]
            done = subprocess.run(words, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr
        self.library = ctypes.CDLL(str(library))
        self.library.fmi2Instantiate.restype = ctypes.c_void_p
        c = ctypes.CDLL(None)
        c.calloc.restype = ctypes.c_void_p
        log = LOG(self._log)
        allocate = ALLOCATE(lambda n, size: c.calloc(ctypes.c_size_t(n), ctypes.c_size_t(size)))
        self.callbacks = Callbacks(log, allocate, RELEASE(lambda p: c.free(ctypes.c_void_p(p))), None, None)
        self.instance = None

    def _log(self, *words):
        self.names.append(words[1].decode())
        self.messages.append(words[-1].decode())

    def instantiate(self, kind=CO_SIMULATION, guid=None, name=b"it"):
        callbacks = ctypes.byref(self.callbacks)
        found = self.library.fmi2Instantiate(name, kind, guid or self.guid, None, callbacks, 0, 0)
        self.instance = ctypes.c_void_p(found)
        return found

    def begin(self):
        assert self.instantiate()
        assert self.library.fmi2EnterInitializationMode(self.instance) == OK
        assert self.library.fmi2ExitInitializationMode(self.instance) == OK

    def _reals(self, names, values, function):
        references = (ctypes.c_uint * len(names))(*(self.references[name] for name in names))
        numbers = (ctypes.c_double * len(names))(*values)
        status = function(self.instance, references, ctypes.c_size_t(len(names)), numbers)
        return status, np.array(numbers)

    def set(self, names, values):
        return self._reals(names, values, self.library.fmi2SetReal)[0]

    def get(self, names):
        status, numbers = self._reals(names, [0.0] * len(names), self.library.fmi2GetReal)
        assert status == OK
        return numbers

    def step(self, time, size=PERIOD):
        return self.library.fmi2DoStep(self.instance, ctypes.c_double(time), ctypes.c_double(size), 1)


def numbered(*parts, joints=2):
    return [f"{part}{k + 1}" for part in parts for k in range(joints)]


def exported(folder, name, *more):
    assert main(["export", "fmu", name, *more, "--out", str(folder)]) == 0
    return folder / f"{name.replace('-', '_')}.fmu"


STATES = ("q_motor", "q_link", "dq_motor", "dq_link")
OBSERVED = ("q_motor", "dq_motor", "q_reference", "dq_reference", "ddq_reference")


LOOPS = [("learned-observer", None, "payload", 5.0), ("elastic-observer", "ur5", "nominal", 0.0)]
LOOPS = [pytest.param(*loop, compiler, marks=pytest.mark.slow) for loop in LOOPS for compiler in COMPILERS]


@needs_compiler
@pytest.mark.parametrize(
    ("name", "robot", "case", "payload", "compiler"), [("fuzzy-4-tip", None, "nominal", 0.0, None), *LOOPS]
)
def test_controller_and_plant_are_the_loop_of_the_environment(name, robot, case, payload, compiler, tmp_path):
    env, policy, state = FuzzyArmEnv(case, robot=robot), load_policy(name, robot=robot), None
    more = ["--robot", robot] if robot else []
    controller, plant = (Host(exported(tmp_path, one, *more), compiler) for one in (name, "plant"))
    parts = (("torque",), STATES, OBSERVED, OBSERVED[:2])
    torques, states, observed, measured = (numbered(*names, joints=policy.joints) for names in parts)
    tip = [name for name in plant.references if name.startswith("tip_")]
    seen, info = env.reset(seed=0)
    assert plant.instantiate() and plant.set(["payload"], [payload]) == OK
    plant.library.fmi2ExitInitializationMode(plant.instance)
    controller.begin()
    np.testing.assert_array_equal(plant.get(tip), info["tip"])
    for k in range(1000 if compiler else 150):
        assert controller.set(observed, seen) == controller.set(measured, plant.get(measured)) == OK
        assert controller.step(k * PERIOD) == OK
        torque = controller.get(torques)
        assert plant.set(torques, torque) == plant.step(k * PERIOD) == OK
        wanted, state = policy.predict(seen, state)
        seen, _, _, _, info = env.step(wanted)
        np.testing.assert_array_equal(torque, wanted)
        np.testing.assert_array_equal(plant.get(states), np.concatenate([info[part] for part in STATES]))
        np.testing.assert_array_equal(plant.get(tip), info["tip"])


@needs_compiler
def test_a_force_on_the_tip_and_several_periods_at_once(tmp_path):
    plant = Host(exported(tmp_path, "plant"))
    states, found = numbered(*STATES), []
    for sizes in ([2, 1], [1, 1, 1]):
        plant.begin()
        assert plant.set(["torque1", "force_x", "force_y"], [200.0, 3.0, -4.0]) == OK
        assert all(plant.step(0.0, size * PERIOD) == OK for size in sizes)
        found.append(plant.get(states))
    np.testing.assert_array_equal(*found)
    plant.begin()
    plant.set(["torque1"], [200.0])
    assert plant.step(0.0, 3 * PERIOD) == OK and (plant.get(states) != found[0]).any()


@needs_compiler
def test_a_host_that_does_wrong_reads_one_line(tmp_path):
    plant, controller = Host(exported(tmp_path, "plant")), Host(exported(tmp_path, "fuzzy-1"))
    assert not plant.instantiate(MODEL_EXCHANGE) and not plant.instantiate(guid=b"{another}")
    controller.begin()
    assert controller.step(0.0, 2 * PERIOD) == ERROR and controller.set(["torque1"], [1.0]) == ERROR
    assert controller.set(["q_motor1"], [np.nan]) == ERROR
    plant.begin()
    assert plant.step(0.0, 0.4 * PERIOD) == ERROR and plant.set(["q_link1"], [0.1]) == ERROR
    for messages, parts in (
        (plant.messages, ("choose co-simulation", "GUID", "whole number of control periods", "after the init")),
        (controller.messages, ("must be the control period, 0.001 s", "output", "q_motor1 [rad]")),
    ):
        assert len(messages) == len(parts)
        assert all(part in message and "\n" not in message for part, message in zip(parts, messages, strict=True))


@needs_compiler
def test_a_saved_state_is_returned_to_in_this_instance_and_in_another(tmp_path):
    file, size, names = exported(tmp_path, "elastic-observer"), ctypes.c_size_t(), numbered(*OBSERVED)
    first, second, states = Host(file), Host(file), [ctypes.c_void_p(), ctypes.c_void_p()]
    seen = np.random.default_rng(0).uniform(-1.0, 1.0, (6, len(names)))

    def torques(host, rows):
        return [host.get(numbered("torque")) for row in rows if host.set(names, row) == host.step(0.0) == OK]

    first.begin()
    second.begin()
    torques(first, seen[:3])
    c, library = first.instance, first.library
    assert library.fmi2GetFMUstate(c, ctypes.byref(states[0])) == OK
    assert library.fmi2SerializedFMUstateSize(c, states[0], ctypes.byref(size)) == OK
    saved = ctypes.create_string_buffer(size.value)
    assert library.fmi2SerializeFMUstate(c, states[0], saved, ctypes.c_size_t(size.value - 1)) == ERROR
    assert library.fmi2SerializeFMUstate(c, states[0], saved, size) == OK
    found = torques(first, seen[3:])
    assert library.fmi2SetFMUstate(c, states[0]) == OK
    c, library = second.instance, second.library
    assert library.fmi2DeSerializeFMUstate(c, saved, ctypes.c_size_t(1), ctypes.byref(states[1])) == ERROR
    assert library.fmi2DeSerializeFMUstate(c, saved, size, ctypes.byref(states[1])) == OK
    assert library.fmi2SetFMUstate(c, states[1]) == OK
    assert len(found) == 3
    for host, state in zip((first, second), states, strict=True):
        np.testing.assert_array_equal(torques(host, seen[3:]), found)
        assert host.library.fmi2FreeFMUstate(host.instance, ctypes.byref(state)) == OK and not state.value


@needs_compiler
def test_the_torque_limits_are_parameters_that_can_be_lowered(tmp_path):
    host, names = Host(exported(tmp_path, "fuzzy-4")), numbered("torque_limit")
    assert host.instantiate() and host.get(names).tolist() == [500.0, 250.0]
    assert host.set(names, [500.1, 250.0]) == ERROR and host.set(names, [20.0, 30.0]) == OK
    host.library.fmi2ExitInitializationMode(host.instance)
    assert host.set(names, [20.0, 30.0]) == ERROR  # fixed from then on
    assert host.set(numbered("q_reference"), [1.0, -1.0]) == host.step(0.0) == OK
    assert host.get(numbered("torque")).tolist() == [20.0, -30.0]


@needs_compiler
def test_what_a_host_may_set_has_the_ranges_of_the_environment(tmp_path):
    plant, controller = Host(exported(tmp_path, "plant")), Host(exported(tmp_path, "fuzzy-1"))
    controller.begin()
    assert plant.instantiate()
    tried = [(plant, "payload", (-1e-9, 1e13, -np.inf)), (plant, "torque1", (np.nan, np.inf))]
    tried += [(plant, "force_y", (np.nan, 1e13)), (plant, "q_link2", (3.2,)), (plant, "dq_motor1", (-15.1,))]
    tried += [(controller, "q_motor1", (9.5,)), (controller, "dq_motor2", (200.0,))]
    tried += [(controller, "q_reference2", (-3.2,)), (controller, "ddq_reference1", (1e5,))]
    for host, name, values in tried:
        before = host.get([name])
        assert {host.set([name], [value]) for value in values} == {ERROR}, name
        np.testing.assert_array_equal(host.get([name]), before)
        assert host.messages[-1].startswith(f"{name} [")
    assert plant.set(["torque1", "payload", "force_x"], [1e300, 1e12, -1e12]) == OK  # torques are clipped
    assert ("payload", "0.0", "1000000000000.0") in plant.stated and not any("torque" in one[0] for one in plant.stated)
    low, high = FuzzyArmEnv().observation_space.low, FuzzyArmEnv().observation_space.high
    names = numbered(*OBSERVED)
    ends = zip(names, map(repr, low.tolist()), map(repr, high.tolist()), strict=True)
    assert controller.stated[: len(names)] == list(ends)


@needs_compiler
def test_a_robot_whose_range_leaves_out_the_angle_zero_starts_within_it(tmp_path):
    law = Host(exported(tmp_path, "computed-torque", "--robot", "panda"))
    law.begin()
    (low, high) = next((float(low), float(high)) for name, low, high in law.stated if name == "q_reference4")
    assert low < high < 0.0 and law.get(["q_reference4"]) == high


@needs_compiler
def test_a_host_may_have_any_clock_and_reuse_its_texts(tmp_path):
    """Steps that a host computes from absolute times, which are rounded, are periods; half a period more is not."""
    plant = Host(exported(tmp_path, "plant"))
    text = ctypes.create_string_buffer(b"arm of the left cell")
    assert plant.instantiate(name=text)
    plant.library.fmi2ExitInitializationMode(plant.instance)
    text.value = b"x" * 19
    for start in (0.0, 1e7, 1.7e9, -1.7e9, 1e12):
        now = start
        for k in range(20):
            after = start + (k + 1) * PERIOD
            assert plant.step(now, after - now) == OK, (start, k)
            now = after
        assert plant.step(now, 1.5 * PERIOD) == ERROR
    assert set(plant.names) == {"arm of the left cell"} and len(plant.names) == 5


@pytest.mark.slow
def test_fmpy_finds_nothing_wrong_and_has_the_numbers_of_python(tmp_path):
    """Another host, which compiles with options of its own, steps controller and plant with constant inputs."""
    fmpy = pytest.importorskip("fmpy")
    from fmpy.build import build_platform_binary
    from fmpy.validation import validate_fmu

    env, policy, state, torques, tips = FuzzyArmEnv("nominal"), load_policy("fuzzy-4"), None, [], []
    seen, _ = env.reset(seed=0)
    for _ in range(50):
        torque, state = policy.predict(seen, state)
        torques.append(torque)
        tips.append(env.step(torques[0])[-1]["tip"])
    held = dict(zip(numbered("torque"), torques[0], strict=True))
    for name, given, outputs, expected in (
        ("fuzzy-4", dict(zip(numbered(*OBSERVED), seen, strict=True)), numbered("torque"), torques),
        ("plant", held, ["tip_x", "tip_y"], tips),
    ):
        file = exported(tmp_path, name)
        assert validate_fmu(str(file)) == []
        folder, build = fmpy.extract(str(file), str(tmp_path / f"{name}-open")), tmp_path / f"{name}-build"
        build.mkdir()
        build_platform_binary(folder, build)
        times = {"stop_time": 50 * PERIOD, "step_size": PERIOD, "output_interval": PERIOD}
        found = fmpy.simulate_fmu(folder, start_values=given, output=outputs, **times)
        np.testing.assert_array_equal([list(row)[1:] for row in found[1:]], expected)
