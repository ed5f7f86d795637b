"""The automaton of the arm for other tools: its text is evaluated, and compared with the event-driven reference."""

import math
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from fuzzyarm import ArmParameters, load_policy
from fuzzyarm.cli import main
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.event_integrator import _ModePlant
from fuzzyarm.export.automaton import _STATES, export_automaton
from fuzzyarm.policies.tip_bound import TipClaim, problem_of
from fuzzyarm.proof.tip.laps import StartBox
from fuzzyarm.proof.tip.plant import PlantSet

MODES = {"back": -1, "stick": 0, "forth": 1}
FACTORS = ("mass", "motor_inertia", "stiffness", "damping", "viscous_friction", "dry_friction")
SPACE = "{http://www-verimag.imag.fr/xml-namespaces/sspaceex}"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    plants = PlantSet(mass=(0.9, 1.1), stiffness=((0.8, 1.0), (1.0, 1.3)), payload=(0.0, 2.0))
    claim = TipClaim("fuzzy-4-tip", plants=plants, start=StartBox(angle=5e-4, bending=(1e-5, 2e-5)))
    folder = tmp_path_factory.mktemp("automaton")
    return export_automaton("fuzzy-4-tip", load_policy("fuzzy-4-tip"), problem_of(claim), folder)


def true(text, values):
    return eval(text.replace("&", "and"), {"sin": math.sin, "cos": math.cos, "exp": math.exp}, values)


def drawn(rng):
    """An arm of random factors with a random payload, its event-driven plant, and the values of the automaton."""
    values = {f"{name}{j}": rng.uniform(0.5, 2.0) for name in FACTORS for j in (1, 2)}
    torque, carried = rng.uniform(-90, 90, 2), rng.uniform(0, 5)

    def scaled(field, factor):
        return tuple(x * values[f"{factor}{j}"] for j, x in enumerate(getattr(ArmParameters(), field), 1))

    parts = {name: scaled(name, name) for name in FACTORS[:-1]} | {"inertia": scaled("inertia", "mass")}
    parts |= {name: scaled(name, "dry_friction") for name in ("static_friction", "coulomb_friction")}
    plant = _ModePlant(ArmParameters(**parts), Payload(carried), torque, lambda time: (0.0, 0.0))
    return plant, values | {"payload": carried, "u1": torque[0], "u2": torque[1], "s": 5e-4}


def test_its_flows_and_modes_are_those_of_the_reference(files):
    """In each of the nine locations; at rest the motors' modes are those whose guard holds."""
    arm, rng = ET.parse(files[0]).getroot()[0], np.random.default_rng(3)
    locations = {one.get("id"): one for one in arm.iter(f"{SPACE}location")}
    assert len(locations) == 9
    for location in locations.values():
        modes, flow = [MODES[name] for name in location.get("name").split("_")], location.find(f"{SPACE}flow").text
        for _ in range(20):
            plant, values = drawn(rng)
            velocity = np.where(modes, np.abs(rng.normal(size=2)) * modes, 0.0)
            state = np.concatenate([rng.uniform(-3, 3, 2), [0, 0], velocity, rng.normal(size=2)])
            state[2:4] = state[:2] + rng.normal(size=2) * 1e-3
            values |= dict(zip(_STATES, state.tolist(), strict=True))
            rates = dict(part.split("' == ") for part in flow.split(" & "))
            found = [true(rates[name], values) for name in _STATES]
            np.testing.assert_allclose(found, plant.derivative(tuple(modes), 0.0, state), rtol=1e-9, atol=1e-9)
            assert (true(rates["s"], values), true(rates["u1"], values)) == (1, 0)
            held = true(location.find(f"{SPACE}invariant").text, values)
            assert held == all(m or plant.mode(j, state) == 0 for j, m in enumerate(modes))
            for move in arm.iter(f"{SPACE}transition"):
                if move.get("source") != location.get("id") or move.find(f"{SPACE}label") is not None:
                    continue
                other = [MODES[name] for name in locations[move.get("target")].get("name").split("_")]
                (j,) = np.flatnonzero(np.not_equal(modes, other))
                rest = np.where(np.arange(8) == 4 + j, 0.0, state)
                at = values | {f"dth{j + 1}": 0.0}
                assert true(move.find(f"{SPACE}guard").text, at) == (plant.mode(j, rest) == other[j])


def test_starts_ranges_and_samples_are_those_of_the_claim(files):
    text = files[1].read_text()
    for part in ("mass1 >= 0.9 & mass1 <= 1.1", "stiffness2 >= 1.0 & stiffness2 <= 1.3", "payload <= 2.0"):
        assert part in text
    problem, values = problem_of(TipClaim("fuzzy-4-tip")), {"s": 0, "payload": 1.0}
    values |= {f"{name}{j}": float(j) for name in ("u", "law") for j in (1, 2)}
    values |= {f"{name}{j}": 1.0 for name in FACTORS for j in (1, 2)}
    inside = text.split('"')[3]
    for shift, holds in ((0.0, True), (4e-4, True), (6e-4, False)):
        moved = problem.start + shift * np.array([1, 1, 1, 1, 0, 0, 0, 0])
        assert true(inside, values | dict(zip(_STATES, moved.tolist(), strict=True))) == holds
    table = np.loadtxt(files[2], delimiter=",", skiprows=1)
    np.testing.assert_array_equal(table[:, 1:], problem.schedule.references)
    assert files[3].name == "fuzzy_4_tip.onnx"


BAD = {
    "automaton fuzzy-4-tip --set any-friction": "an automaton cannot model friction that varies arbitrarily",
    "automaton shield:fuzzy-4-tip:any:4,2": "stands for a shield with any policy inside",
    "c fuzzy-4 --set near": "--set and --start are for the format automaton, not for c",
    "spaceex fuzzy-4": "choose from: c, fmu, onnx, automaton",
}


@pytest.mark.parametrize(("words", "message"), BAD.items(), ids=BAD)
def test_what_it_cannot_have_is_named_and_nothing_is_written(words, message, tmp_path, capsys):
    assert main(["export", *words.split(), "--out", str(tmp_path / "a")]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not any((tmp_path / "a").glob("*"))
