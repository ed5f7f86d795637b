"""The elastic arm between two samples as a hybrid automaton for verification tools, in SpaceEx's format.

Let σ_j be the direction of motor j, or 0 if it sticks (Filippov). With u held for a period, location (σ_1, σ_2) has

    I θ̈ = u - Γ_t - f_v θ̇ - σ F(|θ̇|), or θ̇ = 0 in stick,    M(q) q̈ + C(q, q̇) q̇ + g(q) = Γ_t,

with motor torques u, joint torques Γ_t, viscous friction f_v and dry friction F; a motor sticks while
|u - Γ_t| <= F(0). At each sample the clock is reset, and u becomes the output of the law, which is in a separate file.
The equations are what the package's plant functions return for texts in place of numbers.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from fuzzyarm.common.files import write_once
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics import dynamics
from fuzzyarm.envs.physics.friction import dry_friction_of, stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, State
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.export.c_files import c_name
from fuzzyarm.export.onnx_file import export_onnx
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.proof.tip.laps import StartBox
from fuzzyarm.proof.tip.tube import Problem

__all__ = ["export_automaton"]

_STATES = [f"{name}{j}" for name in ("th", "q", "dth", "dq") for j in (1, 2)]
_HELD = [*_STATES, "s", "u1", "u2"]
_MODES = {-1: "back", 0: "stick", 1: "forth"}
_FACTORS = {
    **{"mass": ("mass", "inertia"), "dry_friction": ("static_friction", "coulomb_friction")},
    **{name: (name,) for name in ("motor_inertia", "stiffness", "damping", "viscous_friction")},
}
"""For each field of a set of plants, the parameters of the arm that the field scales."""


class _Text:
    """A number that is the text of an expression; arithmetic with it gives longer texts."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __neg__(self) -> _Text:
        return _Text(f"(-{self.text})")


def _operation(form: str) -> Callable[..., _Text]:
    def operate(self: _Text, *other: Any) -> _Text:
        texts = (one.text if isinstance(one, _Text) else repr(float(one)) for one in (self, *other))
        return _Text(form.format(*texts))

    return operate


for _name, _sign in {"add": "+", "sub": "-", "mul": "*", "truediv": "/"}.items():
    setattr(_Text, f"__{_name}__", _operation(f"({{0}} {_sign} {{1}})"))
    setattr(_Text, f"__r{_name}__", _operation(f"({{1}} {_sign} {{0}})"))
for _name in ("sin", "cos", "exp"):
    setattr(_Text, _name, _operation(f"{_name}({{0}})"))


def export_automaton(label: str, policy: Policy, problem: Problem, folder: Path) -> list[Path]:
    """Write the problem of a bound on the tip error as NAME.xml, NAME.cfg, NAME.csv and NAME.onnx; return the files.

    NAME is the C identifier for `label`. The automaton has the states `th`, `q` [rad], `dth`, `dq` [rad/s] of motors
    and links, the clock `s` [s], the held torques `u` [N m], the law's output `law` at a sample, and as constants the
    factors and the payload [kg] of the set of plants. NAME.cfg contains the box of initial states and the ranges of the
    constants, NAME.csv the reference at every sample, NAME.onnx the law as written by `export_onnx`.

    ValueError if the problem has a robot other than a two-joint arm, a disturbance, encoder errors, delayed torques,
    arbitrary friction, an additional tip force, or a shield with a guest, or if `export_onnx` refuses the policy;
    OSError if a file exists or cannot be written.
    """
    plants = problem.plants
    odd = {
        "a robot other than a two-joint arm": not isinstance(problem.parameters, ArmParameters),
        "the load of a case": problem.schedule.disturbance != Disturbance(),
        "friction that varies arbitrarily": plants.friction == "any",
        "encoder errors": any(plants.noise),
        "delayed torques": plants.late,
        "an additional tip force": plants.force_course,
        "a guest": any(problem.guest),
    }
    if unknown := [words for words, found in odd.items() if found]:
        raise ValueError(f"an automaton cannot model {' or '.join(unknown)}; choose another set, arm, case or policy")
    ranges = {f"{field}{j + 1}": plants.of_joint(field, j) for field in _FACTORS for j in range(JOINTS)}
    ranges["payload"] = plants.payload
    head = "time," + ",".join(f"{name}_d{j}" for name in ("q", "dq", "ddq") for j in (1, 2))
    rows = [[k * problem.period, *row] for k, row in enumerate(problem.schedule.references.tolist())]
    texts = {
        "xml": _xml(problem, list(ranges)),
        "cfg": _configuration(problem.start, problem.box or StartBox(), ranges),
        "csv": "\n".join([head, *(",".join(map(repr, row)) for row in rows)]) + "\n",
    }
    name, law = c_name(label), export_onnx(label, policy, folder)
    return [*write_once(folder, {f"{name}.{ending}": text for ending, text in texts.items()}), law]


def _xml(problem: Problem, constants: list[str]) -> str:
    """Return the automaton of a problem as XML text; `constants` are the names of the uncertain constants."""
    root = ET.Element("sspaceex", {"version": "0.2", "math": "SpaceEx"})
    root.set("xmlns", "http://www-verimag.imag.fr/xml-namespaces/sspaceex")
    arm, nets, static, flows = ET.SubElement(root, "component", id="arm"), *_equations(problem, constants)
    for name in (*_HELD, "law1", "law2", *constants):
        of = {"dynamics": "const" if name in constants else "any", "controlled": str(name in _HELD).lower()}
        ET.SubElement(arm, "param", {"name": name, "type": "real", "local": "false", "d1": "1", "d2": "1", **of})
    ET.SubElement(arm, "param", name="sample", type="label", local="false")
    period = repr(problem.period)

    def holds(j: int, mode: int) -> str:
        """Return the condition for motor j, at rest, to enter a mode: -1 backward, 0 stick, 1 forward."""
        sticks = f"{nets[j]} <= {static[j]} & {nets[j]} >= -{static[j]}"
        return (sticks, f"{nets[j]} >= {static[j]}", f"{nets[j]} <= -{static[j]}")[mode]

    def move(source: int, target: int, guard: str, becomes: str = "") -> None:
        made = ET.SubElement(arm, "transition", source=str(source), target=str(target))
        if becomes:
            ET.SubElement(made, "label").text = "sample"
            ET.SubElement(made, "assignment").text = becomes
        ET.SubElement(made, "guard").text = guard

    places = {modes: number for number, modes in enumerate(itertools.product(_MODES, repeat=JOINTS), 1)}
    for modes, number in places.items():
        location = ET.SubElement(arm, "location", id=str(number), name="_".join(_MODES[mode] for mode in modes))
        kept = [f"{m} * dth{j + 1} >= 0" if m else f"dth{j + 1} == 0 & {holds(j, 0)}" for j, m in enumerate(modes)]
        ET.SubElement(location, "invariant").text = " & ".join([f"s <= {period}", *kept])
        ET.SubElement(location, "flow").text = " & ".join(f"{x}' == {rate}" for x, rate in flows(modes).items())
        for j, mode in itertools.product(range(JOINTS), _MODES):
            if mode != modes[j]:
                target = places[tuple(mode if i == j else m for i, m in enumerate(modes))]
                move(number, target, f"dth{j + 1} == 0 & {holds(j, mode)}")
        move(number, number, f"s == {period}", "s := 0 & u1 := law1 & u2 := law2")
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _equations(problem: Problem, constants: list[str]) -> tuple[list[str], list[str], Any]:
    """Return as texts u - Γ_t, motor minus joint torque, and static friction F(0) of each motor, and a function.

    The function takes the motors' directions σ and returns the text of each variable's time derivative.
    `constants` are the names of the factors and of the payload.
    """
    assert isinstance(problem.parameters, ArmParameters)
    plant, factors = dynamics.plant_of(problem.parameters), {name: _Text(name) for name in constants}
    for field, names in _FACTORS.items():
        own = [factors[f"{field}{j + 1}"] for j in range(JOINTS)]
        plant = plant._replace(**{
            name: PerJoint(*(x * factor for x, factor in zip(getattr(plant, name), own, strict=True))) for name in names
        })  # fmt: skip
    arm = dynamics.loaded(dynamics.lump(plant), factors["payload"], plant.length[1], plant.gravity)
    th, q, dth, dq = (PerJoint(_Text(f"{name}1"), _Text(f"{name}2")) for name in ("th", "q", "dth", "dq"))
    joint, dry = dynamics.joint_torque(State(th, q, dth, dq), arm), [dry_friction_of(plant, j) for j in range(JOINTS)]
    nets = [_Text(f"u{j}") - torque for j, torque in enumerate(joint, 1)]
    coriolis = dynamics.coriolis_torque(q.joint2.sin(), *dq, arm)
    gravity = dynamics.gravity_torque(q.joint1.sin(), (q.joint1 + q.joint2).sin(), arm)
    right = [a - b - c for a, b, c in zip(joint, coriolis, gravity, strict=True)]
    links = dynamics.solve_mass_matrix(q.joint2.cos(), right[0], right[1], arm)

    def flows(modes: tuple[int, ...]) -> dict[str, str]:
        motors = []
        for mode, net, v, motor, its in zip(modes, nets, dth, dynamics.motors(arm, th), dry, strict=True):
            slip = net - motor.viscous * v - float(mode) * stribeck_magnitude(v, its)
            motors.append(slip * (1.0 / motor.motor_inertia))
        moving = [rate.text if mode else "0" for part in (dth, motors) for rate, mode in zip(part, modes, strict=True)]
        rates = [*moving[:2], *(v.text for v in dq), *moving[2:], *(rate.text for rate in links), "1", "0", "0"]
        return dict(zip(_HELD, rates, strict=True))

    return [net.text for net in nets], [its.static_friction.text for its in dry], flows


def _configuration(start: np.ndarray, box: StartBox, ranges: dict[str, tuple[float, float]]) -> str:
    """Return the configuration file's text: the box of initial states around `start` and the constants' ranges."""
    held = ["s == 0 & u1 == law1 & u2 == law2"]
    for j in range(JOINTS):
        n, (th, q, dth, dq) = j + 1, start[j::JOINTS].tolist()
        wide = [
            float(np.broadcast_to(getattr(box, name), JOINTS)[j])
            for name in ("angle", "bending", "velocity", "bending_velocity")
        ]
        parts = {f"th{n}": th, f"th{n} - q{n}": th - q, f"dth{n}": dth, f"dth{n} - dq{n}": dth - dq}
        held += [f"{x} >= {a - w!r} & {x} <= {a + w!r}" for (x, a), w in zip(parts.items(), wide, strict=True)]
    held += [f"{name} >= {low!r} & {name} <= {high!r}" for name, (low, high) in ranges.items()]
    return 'system = "arm"\ninitially = "' + " & ".join(held) + '"\n'
