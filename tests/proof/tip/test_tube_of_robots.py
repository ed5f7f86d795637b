"""The tube of robots with more than two joints, whose equations are recursive: against floats and episodes."""

import dataclasses
import json

import numpy as np
import pytest
from flint import arb
from support.command_line import one_line_error
from support.tip_errors import tip_errors

from fuzzyarm.cli import main
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.policies.spec import load_policy
from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.policies.tip_files import check_bound, save_bound
from fuzzyarm.proof import second
from fuzzyarm.proof.tip._defects import link_torque
from fuzzyarm.proof.tip.enclosures import Jet, NoBound
from fuzzyarm.proof.tip.laps import StartBox
from fuzzyarm.proof.tip.plant import BallPlant, PlantSet
from fuzzyarm.proof.tip.transition import Linear
from fuzzyarm.proof.tip.tube import _units, tip_bound
from fuzzyarm.proof.tip.zonotope import Zonotope

ROBOT = robot_named("planar-3r")
STEPS = 40
RNG = np.random.default_rng(0)


pytestmark = pytest.mark.usefixtures("precision")


def equations_and_constants(robot):
    physics = equations_of(robot)
    return physics, physics.constants(physics.plant_of(robot), 0.0, 0.0, 0.0)


@pytest.mark.parametrize("robot", [ArmParameters(), ROBOT], ids=["two joints", "three joints"])
def test_the_torques_of_the_links_enclose_those_of_the_environment_and_have_their_slopes(robot):
    physics, floats = equations_and_constants(robot)
    n, plant = physics.joints, BallPlant.of(robot, Disturbance(), PlantSet())
    x, force = RNG.normal(size=(3, n)), (3.0, -2.0, 0.0)[: physics.axes]

    def torque(x):
        angles, *rest = (physics.PerJoint(*part) for part in x.tolist())
        load = physics.tip_load(angles, physics.Point(*force), floats)
        return np.array(physics.inverse_dynamics(angles, *rest, floats)) - np.array(load)

    jets = [[Jet.variable(arb(v), n * k + i) for i, v in enumerate(part)] for k, part in enumerate(x.tolist())]
    found = link_torque(physics, jets, tuple(map(arb, force)), plant.exact)
    assert [float(t.value.mid()) for t in found] == pytest.approx(torque(x), rel=1e-13)
    for i, step in enumerate(1e-6 * np.eye(3 * n).reshape(3 * n, 3, n)):
        slope = (torque(x + step) - torque(x - step)) / 2e-6
        assert [float(t.slope(i).mid()) for t in found] == pytest.approx(slope, abs=1e-7)


def test_every_direction_in_space_is_close_to_one_of_those_that_are_looked_at():
    units, corner = _units(3)
    any_way = RNG.normal(size=(20_000, 3))
    nearest = np.abs(any_way @ units.T).max(axis=1) / np.linalg.norm(any_way, axis=1)
    assert np.linalg.norm(units, axis=1) == pytest.approx(np.ones(len(units)))
    assert 1.0 / corner <= nearest.min() < 1.0 / corner + 3e-3


def test_the_tip_of_a_zonotope_in_space_is_within_its_bound_and_not_far_below():
    ur5 = robot_named("ur5")
    physics, floats = equations_and_constants(ur5)
    state, deviations = np.zeros(24), Zonotope(24, 0)
    state[6:12] = RNG.uniform(-1.0, 1.0, 6)
    deviations.add(np.vstack([np.zeros((6, 9)), 2e-4 * RNG.normal(size=(6, 9)), np.zeros((12, 9))]), 0)
    here = np.array(physics.tip(physics.PerJoint(*state[6:12]), floats))
    aim = here + np.array([2e-4, -1e-4, 1e-4])
    bound, _ = tip_bound(state, deviations, BallPlant.of(ur5, Disturbance(), PlantSet()), aim.tolist())
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 9)).reshape(9, -1)
    angles = state[6:12, np.newaxis] + deviations.columns[6:12] @ corners
    tips = np.array(physics.tip(physics.PerJoint(*angles), floats))
    errors = np.linalg.norm(tips - aim[:, np.newaxis], axis=0)
    assert 0.98 * bound < errors.max() <= bound


@pytest.fixture(scope="module")
def bound():
    return find_bound(TipClaim("computed-torque-tip", steps=STEPS, arm=ROBOT, duration=1.9))


def test_an_episode_of_the_environment_is_within_the_bound_and_close_to_it(bound):
    """Sub-steps of a 64th of the control period: the environment's own error, of second order, is below 1 % of it."""
    env = FuzzyArmEnv("nominal", robot=ROBOT, substep=1e-3 / 64)
    errors = tip_errors(env, load_policy("computed-torque-tip", robot=ROBOT), np.zeros((STEPS, 3)))
    assert (errors <= 1.01 * bound.tip + 1e-8).all() and errors.max() > 0.9 * bound.tip.max()


def test_the_file_says_which_robot_and_checks_its_numbers(bound, tmp_path):
    path = tmp_path / "bound.json"
    save_bound(bound, path)
    found = check_bound(path)
    assert found.proven and found.claim.arm == ROBOT and "(elastic arm, the robot planar-3r;" in found.sentence
    assert not second.check(path).proven  # the second checker knows the arm of Table 1 alone
    content = json.loads(path.read_text())
    content["arm"]["joints"][2]["drive"]["stiffness"] *= 1.001
    path.write_text(json.dumps(content))
    forged = check_bound(path)
    assert not forged.proven and "planar-3r" not in forged.sentence
    assert "a robot of 3 joints, numbers" in forged.sentence


def test_uncertain_constants_and_a_box_of_starts_widen_the_bound_of_a_robot(bound):
    near = {"set_name": "", "plants": PlantSet(mass=(0.999, 1.001), stiffness=(0.99, 1.01))}
    alone, wide, begun = (
        find_bound(dataclasses.replace(bound.claim, steps=5, **change)).tip.max()
        for change in ({}, near, {"start": StartBox(angle=1e-5)})
    )
    assert wide > 3.0 * alone and begun > 3.0 * alone


def test_what_a_robot_has_no_bound_for_is_said(bound, capsys):
    words = ["prove", "--robot", "planar-3r", "--policy", "computed-torque-tip", "--steps", "2"]
    for more, why in (
        (["--start", "[1]", "0", "0", "0", "0"], "start: could not convert"),
        (["--cells", "mass", "2"], "--cells must be payload or force for a robot with 3 joints"),
    ):
        assert main([*words, *more]) == 2
        assert why in one_line_error(capsys)
    claim, by_joint = dataclasses.replace(bound.claim, steps=2), PlantSet(mass=((1.0, 1.0), (0.9, 1.1)))
    with pytest.raises(NoBound, match="ranges for 2 joints, but the arm has 3; give one range"):
        find_bound(dataclasses.replace(claim, set_name="", plants=by_joint))
    with pytest.raises(ValueError, match="angle has 2 numbers; needed: one for each of the 3 joints"):
        find_bound(dataclasses.replace(claim, start=StartBox(angle=(1e-4, 2e-4))))


def test_an_arm_whose_series_is_cut_too_early_has_no_bound():
    """With a motor a thousand times lighter, 24 terms of exp(A T) are wrong by far more than the allowance."""
    arm, none, free = arm_constants(ArmParameters()), np.zeros((2, 2)), [False] * 2
    rest = (np.array([[5.8, 1.5], [1.5, 0.75]]), none, none), np.eye(2), np.zeros(2), free, free, np.zeros((0, 6))
    Linear.of(arm, *rest).over(1e-3)
    with pytest.raises(NoBound, match="too stiff or damped too strongly"):
        Linear.of(arm._replace(motor_inertia2=1e-3 * arm.motor_inertia2), *rest).over(1e-3)
