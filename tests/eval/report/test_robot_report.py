"""The report of a robot: its chain and camera in the page are those of the package, and it is a page like any other."""

import dataclasses

import numpy as np
import pytest
from support.altered_evaluations import with_runs, write
from support.rollouts import made_rollout

from fuzzyarm import EvaluationConfig, robot_named
from fuzzyarm.cli import main
from fuzzyarm.envs.perspective import looking_at, poses_of
from fuzzyarm.envs.physics.rigid_body import frames
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.eval.evaluation.results_file import read_evaluation
from fuzzyarm.eval.report._payload import replay_data

ROBOT = robot_named("ur5")
REFERENCE = default_reference(ROBOT)
CASES = ("nominal", "machining", "payload")
POLICIES = ("computed-torque", "elastic-observer")


def rollout(case, policy, offset):
    """A run of the reference with the joints off by `offset` [rad], and bent; nothing is simulated."""
    time = 1e-3 * np.arange(1, round(1e3 * REFERENCE.duration) + 1)
    asked = REFERENCE.tip(time).position
    q = REFERENCE.sample(time).q + offset * np.sin(3.0 * time)[:, np.newaxis]
    tip = frames(ROBOT, q).tip
    return made_rollout(
        time,
        joints=len(ROBOT),
        policy=policy,
        case=case,
        tip=tip,
        tip_reference=asked,
        tip_error=np.linalg.norm(tip - asked, axis=1),
        q_motor=q + 1e-3,
        q_link=q,
        external_force=30.0 * (case == "machining") * np.ones((len(time), 3)) * [1.0, 0.0, -1.0],
    )


@pytest.fixture(scope="module")
def robot_folder(evaluation, tmp_path_factory):
    runs = [rollout(case, policy, 1e-3 * (1 + k)) for case in CASES for k, policy in enumerate(POLICIES)]
    config = EvaluationConfig(policies=POLICIES, cases=CASES, robot=ROBOT)
    made = dataclasses.replace(with_runs(evaluation, runs), config=config)
    folder = write(made, tmp_path_factory.mktemp("robot"))
    assert main(["report", str(folder)]) == 0
    return folder


@pytest.fixture
def page(chromium, robot_folder):
    path = robot_folder / "report.html"
    chromium.open(path, width=1400, height=900)
    yield chromium
    assert chromium.problems == [] and chromium.requests == [path.as_uri()]


def test_the_data_are_those_of_the_robot_and_its_loads(robot_folder):
    data = replay_data(read_evaluation(robot_folder))
    assert "length" not in data and len(data["robot"]["joints"]) == 6
    assert [case["title"] for case in data["cases"]][-1] == "Case 3: 2 kg payload"
    assert [case["payload"] for case in data["cases"]] == [0.0, 0.0, 2.0]
    text = (robot_folder / "report.html").read_text()
    assert "2 kg payload" in text and "5 kg payload" not in text and f"digest {ROBOT.digest}" in text


def test_the_page_moves_the_robot_as_the_package_does(page):
    """Places of the joints, and where the camera sees them: scaled, (right, down) of `Camera` is [down, right] here."""
    distance, axes, eye = (np.array(page.run(f"report.robot.{name}")) for name in ("distance", "axes", "eye"))
    camera = looking_at(ROBOT, REFERENCE.tip(np.linspace(0.0, 1.0, 500)).position)._replace(axes=axes, eye=eye)
    for q in np.random.default_rng(0).uniform(-3.0, 3.0, (5, 6)):
        points = poses_of(ROBOT, q).points
        np.testing.assert_allclose(page.run(f"space.points({q.tolist()})"), points, atol=1e-12)
        seen = np.array(page.run(f"space.points({q.tolist()}).map(space.seen)"))
        np.testing.assert_allclose(seen[:, ::-1], distance * camera.pixels(points), atol=1e-9)
