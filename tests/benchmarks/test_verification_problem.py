"""The loop written for verification tools is that of the environment and of the policy."""

import importlib.util
import re
from math import cos, exp, sin
from pathlib import Path

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.dynamics import arm_constants, dry_frictions, rigid_inverse_dynamics
from fuzzyarm.envs.physics.friction import DryFriction, stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.policies.tip_bound import TipClaim, problem_of
from fuzzyarm.proof.tip.plant import PlantSet

PATH = Path(__file__).parents[2] / "benchmarks" / "verification_problem.py"
SPEC = importlib.util.spec_from_file_location(PATH.stem, PATH)
problem = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(problem)
POLICY = problem.POLICY


@pytest.fixture(scope="module")
def written():
    return problem.files()


def function(text, *outputs):
    """Return a MATLAB function of these files as one of Python."""
    body = re.sub(r"\.\.\.\n", "", "\n".join(text.splitlines()[1:]))
    body = re.sub(r"%[^\n]*", "", body).replace("^", "**")
    body = re.sub(r"\b(x|xi|r|u)\((\d)\)", lambda m: f"{m[1]}[{int(m[2]) - 1}]", body)
    body = re.sub(r"= \[(.*)\];", lambda m: f"= [{m[1].replace(';', ',')}]", body)
    body = "\n".join(line.strip() for part in body.splitlines() for line in [part] if line.strip())

    def call(**values):
        names = {"sin": sin, "cos": cos, "exp": exp, "sign": np.sign, **values}
        exec(body, names)
        return [np.array(names[name]) for name in outputs]

    return call


def test_the_plant_is_the_one_of_the_environment(written):
    plant, arm, rng = function(written["dynamics.m"], "dx"), arm_constants(ArmParameters()), np.random.default_rng(0)
    for _ in range(20):
        x, u = rng.normal(size=8) * [1, 1, 1, 1, 2, 2, 2, 2], rng.normal(size=2) * 50.0
        (dx,) = plant(x=x, u=u)
        np.testing.assert_array_equal(dx[:4], x[4:])
        joint = np.array([arm.stiffness1, arm.stiffness2]) * (x[:2] - x[2:4])
        joint = joint + np.array([arm.damping1, arm.damping2]) * (x[4:6] - x[6:])
        np.testing.assert_allclose(rigid_inverse_dynamics(x[2:4], x[6:], dx[6:], arm), joint, rtol=1e-9)
        dry = DryFriction(*np.array(dry_frictions(arm)).T)
        friction = stribeck_magnitude(x[4:6], dry) * np.sign(x[4:6])
        net = u - joint - np.array([arm.viscous1, arm.viscous2]) * x[4:6] - friction
        np.testing.assert_allclose(dx[4:6] * [arm.motor_inertia1, arm.motor_inertia2], net, rtol=1e-9, atol=1e-9)


def test_the_controller_is_the_policy(written):
    law, policy, rng = function(written["controller.m"], "u", "xi"), load_policy(POLICY), np.random.default_rng(1)
    rows = np.array([list(map(float, line.split(","))) for line in written["reference.csv"].splitlines()])
    assert len(rows) == 1500
    references = problem_of(TipClaim(POLICY, "nominal", "table-1", PlantSet(), steps=30)).schedule.references
    xi, memory = [0.0, 0.0], None
    for k in range(30):
        measured = rows[k, :4] + 1e-3 * rng.normal(size=4)
        x = np.concatenate([measured[:2], [0.0, 0.0], measured[2:], [0.0, 0.0]])
        action, memory = policy.predict(np.concatenate([measured, references[k]]), memory)
        u, xi = law(x=x, xi=xi, r=rows[k])
        np.testing.assert_allclose(u, action, rtol=1e-9, atol=1e-8)


def test_the_specification_says_what_is_proven(written):
    assert re.search(r"X = 0\.0018\d+ mm", written["README.md"])
