"""The equations of motion against MuJoCo and against their own structure: Jacobians, Christoffel symbols, energy."""

import mujoco
import numpy as np
import pytest
from support.two_joints import state_of

from fuzzyarm.envs.physics.dynamics import (
    Payload,
    arm_constants,
    coriolis_torque,
    gravity_torque,
    joint_torque,
    mass_matrix,
    rigid_inverse_dynamics,
    solve_mass_matrix,
    tip_force_torque,
    tip_jacobian,
    tip_position,
)
from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.parameters import ArmParameters

SEEDS = range(6)
STATES = 20


def random_arm(rng):
    length = rng.uniform(0.2, 1.5, 2)
    return ArmParameters(
        length=tuple(length.tolist()),
        mass=tuple(rng.uniform(0.5, 20.0, 2).tolist()),
        inertia=tuple(rng.uniform(0.01, 1.0, 2).tolist()),
        mass_center=tuple((length * rng.uniform(0.1, 1.6, 2)).tolist()),  # of fits some lie beyond the link
        gravity=float(rng.uniform(1.0, 20.0)),
    )


def random_motion(rng):
    return rng.uniform(-np.pi, np.pi, 2), rng.uniform(-10.0, 10.0, 2), rng.uniform(-50.0, 50.0, 2)


def mujoco_model(arm, payload):
    """Two hinges about z, x down; the payload is a third, rigidly attached, all but point-sized body."""
    at = arm.length[1] if payload.at == "tip" else arm.mass_center[1]
    carried = (
        f'<body pos="{at!r} 0 0"><inertial pos="0 0 0" mass="{payload.mass!r}" diaginertia="1e-13 1e-13 1e-13"/></body>'
        if payload.mass
        else ""
    )
    inertials = [
        f'<inertial pos="{arm.mass_center[j]!r} 0 0" mass="{arm.mass[j]!r}" diaginertia="{" ".join([repr(i)] * 3)}"/>'
        for j, i in enumerate(arm.inertia)
    ]
    return mujoco.MjModel.from_xml_string(f"""<mujoco>
      <compiler angle="radian"/> <option gravity="{arm.gravity!r} 0 0"/>
      <worldbody><body><joint axis="0 0 1"/>{inertials[0]}
        <body pos="{arm.length[0]!r} 0 0"><joint axis="0 0 1"/>{inertials[1]}
          <site name="tip" pos="{arm.length[1]!r} 0 0"/>{carried}
      </body></body></worldbody></mujoco>""")


def mujoco_at(model, q, dq, ddq=(0.0, 0.0)):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
    mujoco.mj_inverse(model, data)
    return data


def full_mass_matrix(q2, constants):
    m11, m12, m22 = mass_matrix(np.cos(q2), constants)
    return np.array([[m11, m12], [m12, m22]])


def gravity(q, constants):
    return np.array(gravity_torque(np.sin(q[0]), np.sin(q[0] + q[1]), constants))


@pytest.mark.parametrize("seed", SEEDS)
def test_the_equations_of_motion_and_the_tip_are_mujocos(seed):
    rng = np.random.default_rng(seed)
    payload = Payload(float(rng.uniform(0.5, 8.0)), "tip" if seed % 2 else "link") if seed >= 2 else Payload()
    arm = random_arm(rng)
    model, constants = mujoco_model(arm, payload), arm_constants(arm, payload)
    for _ in range(STATES):
        q, dq, ddq = random_motion(rng)
        data, mass, jacobian = mujoco_at(model, q, dq, ddq), np.zeros((2, 2)), np.zeros((3, 2))
        mujoco.mj_fullM(model, data, mass)
        np.testing.assert_allclose(full_mass_matrix(q[1], constants), mass, rtol=1e-10, atol=1e-11)
        at_rest = mujoco_at(model, q, np.zeros(2)).qfrc_bias
        bias = coriolis_torque(np.sin(q[1]), dq[0], dq[1], constants) + gravity(q, constants)
        torque = rigid_inverse_dynamics(q, dq, ddq, constants)
        for found, expected in ((bias, data.qfrc_bias), (gravity(q, constants), at_rest), (torque, data.qfrc_inverse)):
            np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
        mujoco.mj_jacSite(model, data, jacobian, None, 0)
        np.testing.assert_allclose(tip_position(q, arm.length), data.site_xpos[0, :2], rtol=0, atol=1e-12)
        np.testing.assert_allclose(tip_jacobian(q, arm.length), jacobian[:2], rtol=0, atol=1e-12)
        force, q12 = rng.uniform(-200.0, 200.0, 2), q.sum()
        pulled = tip_force_torque(np.sin(q[0]), np.cos(q[0]), np.sin(q12), np.cos(q12), *force, constants)
        np.testing.assert_allclose(pulled, jacobian[:2].T @ force, rtol=0, atol=1e-10)
        acceleration = solve_mass_matrix(np.cos(q[1]), *force, constants)
        np.testing.assert_allclose(mass @ acceleration, force, rtol=1e-9, atol=1e-9)


def test_joint_torque_is_a_spring_and_a_damper():
    arm = ArmParameters()
    state = state_of([0.3, -0.2, 0.1, 0.5, 1.0, 2.0, -3.0, 4.0])
    expected = (6.4e4 * (0.3 - 0.1) + 20.4 * (1.0 + 3.0), 1.2e4 * (-0.2 - 0.5) + 3.8 * (2.0 - 4.0))
    np.testing.assert_allclose(joint_torque(state, arm_constants(arm)), expected, rtol=1e-15)


def test_inverse_dynamics_and_mass_matrix_elementwise_are_those_of_arrays():
    rng = np.random.default_rng(8)
    arm = arm_constants(ArmParameters(), Payload(2.0))
    q, dq, ddq = random_motion(rng)
    physics = two_joints()
    parts = (physics.PerJoint(*part.T) for part in (q, dq, ddq))
    expected = rigid_inverse_dynamics(q, dq, ddq, arm)
    np.testing.assert_allclose(np.stack(physics.inverse_dynamics(*parts, arm), axis=-1), expected, rtol=0.0, atol=1e-9)
    (m11, m12), (m21, m22) = physics.mass_matrix(physics.PerJoint(*q.T), arm)
    for column, unit in enumerate(np.eye(2)):
        torque = rigid_inverse_dynamics(q, np.zeros_like(q), unit, arm)
        column_of = np.stack([(m11, m12)[column], (m21, m22)[column]], axis=-1)
        weight = np.stack(physics.gravity(physics.PerJoint(*q.T), arm), axis=-1)
        np.testing.assert_allclose(column_of, torque - weight, rtol=0.0, atol=1e-9)
