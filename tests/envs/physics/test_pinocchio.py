"""The recursive algorithms, the measure of all equations, against pinocchio, which shares no code with them.

It takes `pip install -c constraints.txt pin` (455 MB), which the test extra does not have: these tests are skipped
without it.
"""

import numpy as np
import pytest
from support.robots import ROBOTS

from fuzzyarm.envs.physics.rigid_body import frames, inverse_dynamics, mass_matrix, tip_jacobian

pinocchio = pytest.importorskip("pinocchio", reason="pinocchio is not installed: pip install -c constraints.txt pin")
pytestmark = pytest.mark.slow


def model_of(robot):
    model, parent = pinocchio.Model(), 0
    model.gravity.linear = np.array(robot.gravity)
    for joint in robot.joints:
        placement = pinocchio.SE3(np.array(joint.rotation), np.array(joint.position))
        revolute = pinocchio.JointModelRevoluteUnaligned(np.array(joint.axis))
        parent = model.addJoint(parent, revolute, placement, joint.name)
        link = joint.link
        body = pinocchio.Inertia(link.mass, np.array(link.center), np.array(link.inertia))
        model.appendBodyToJoint(parent, body, pinocchio.SE3.Identity())
    at_tip = pinocchio.SE3(np.eye(3), np.array(robot.tip))
    tip = model.addFrame(pinocchio.Frame("tip", parent, at_tip, pinocchio.FrameType.OP_FRAME))
    return model, model.createData(), tip


@pytest.mark.parametrize("name", ROBOTS)
def test_rigid_body_dynamics_are_pinocchios(name):
    robot = ROBOTS[name]
    model, data, tip = model_of(robot)
    for q, dq, ddq in np.random.default_rng(0).uniform(-3.0, 3.0, (20, 3, len(robot))):
        torque = pinocchio.rnea(model, data, q, dq, ddq)
        inertia = np.triu(pinocchio.crba(model, data, q))
        inertia = inertia + np.triu(inertia, 1).T
        scale = np.abs(torque).max()
        np.testing.assert_allclose(inverse_dynamics(robot, q, dq, ddq), torque, rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(mass_matrix(robot, q), inertia, rtol=0, atol=1e-10 * np.abs(inertia).max())
        pinocchio.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(frames(robot, q).tip, data.oMf[tip].translation, rtol=0, atol=1e-10)
        world = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pinocchio.computeFrameJacobian(model, data, q, tip, world)[:3]
        np.testing.assert_allclose(tip_jacobian(robot, q), jacobian, rtol=0, atol=1e-10)
