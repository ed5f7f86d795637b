"""References of robots along a path of the tip or a spline of the joints, and the kinematics of the last link."""

import dataclasses
import functools
import itertools
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slow_twins import slow_but
from support.differences import central_difference

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import frames, gravity
from fuzzyarm.envs.physics.robot import Robot, robot_named, shipped_robots
from fuzzyarm.envs.scenario import kinematics
from fuzzyarm.envs.scenario.kinematics import angle_ranges, freedom, home_posture, jacobian, reach
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line, Placed, Spline
from fuzzyarm.envs.scenario.reference import JointReference, quintic_time_law
from fuzzyarm.envs.scenario.robot_reference import SplineReference, TipReference

ROBOTS = {name: robot_named(name) for name in ("planar-3r", "ur5", "panda")}
DURATION = 4.0
T = np.linspace(0.0, DURATION, 201)


def start_of(robot):
    """Where the tip is in the home posture."""
    return frames(robot, np.array(home_posture(robot))).tip


def paths(robot):
    """Paths about the home posture, in the x-y plane of a planar robot and elsewhere in space."""
    place = start_of(robot)
    planar = robot.name.startswith("planar")
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)) if planar else ((0.0, 1.0, 0.0), (0.0, 0.6, 0.8))
    first, second = (axes[0], axes[1]) if planar else ((0.0, 0.6, 0.8), (1.0, 0.0, 0.0))
    waypoints = place + np.array([[0, 0], [0.05, 0.03], [0.02, 0.1], [-0.04, 0.05]]) @ np.array([first, second])
    return {
        "circle": Placed(Circle(center=(0.08, 0.0), radius=0.08), tuple(place), first, second),
        "lemniscate": Placed(Lemniscate((0.0, 0.0), 0.1, angle=0.4), tuple(place), first, second),
        "line": Line(tuple(place), tuple(place + 0.1 * np.array(first) - 0.03 * np.array(second))),
        "spline": Spline(waypoints),
    }


KINDS = ("circle", "lemniscate", "line", "spline", "circle, free")
# Each robot with the orientation kept, the redundant ones also with it free, and every kind of path.
FAST = [
    *((name, "circle") for name in ROBOTS),
    *((name, "circle, free") for name in ("planar-3r", "panda")),
    *(("ur5", "line"), ("ur5", "spline"), ("planar-3r", "lemniscate")),
]


@functools.cache
def reference_of(name, kind):
    """The reference of a robot along a kind of path, where it says so with a free orientation."""
    orientation = "free" if kind.endswith("free") else "constant"
    return TipReference(paths(ROBOTS[name])[kind.split(",")[0]], DURATION, ROBOTS[name], orientation=orientation)


@pytest.fixture(params=slow_but(FAST, itertools.product(ROBOTS, KINDS)), ids=", ".join)
def reference(request):
    return reference_of(*request.param)


def test_the_tip_is_on_the_path_at_every_time_and_at_rest_outside(reference):
    q = reference.sample(T).q
    expected = reference.path.points(quintic_time_law(T, DURATION)[0])[0]
    np.testing.assert_allclose(frames(reference.robot, q).tip, expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(reference.tip(T).position, expected, rtol=0, atol=1e-15)
    normals = reference.normals(T)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-14)
    np.testing.assert_allclose(np.sum(normals * reference.tip(T).velocity, axis=-1), 0.0, atol=1e-14)
    rest = reference.sample([-1.0, 0.0, DURATION, DURATION + 1.0])
    np.testing.assert_array_equal(rest.q[[0, 3]], rest.q[[1, 2]])
    assert not rest.dq.any() and not rest.ddq.any()
    if isinstance(reference.path, Placed):  # a closed path brings every joint back, also the redundant ones
        np.testing.assert_allclose(rest.q[0], rest.q[3], rtol=0, atol=1e-13)
    corners = reference.corners()
    inner = quintic_time_law(corners[1:-1], DURATION)[0]
    np.testing.assert_allclose(inner, getattr(reference.path, "corners", ()), atol=1e-14)
    if isinstance(getattr(reference.path, "path", None), Circle):
        center, radius = reference.circle
        distance = np.linalg.norm(reference.tip(T).position - center, axis=-1)
        np.testing.assert_allclose(distance, radius, rtol=1e-14)
    else:
        assert reference.circle is None


def test_velocities_and_accelerations_are_consistent(reference):
    t = np.random.default_rng(0).uniform(0.01, DURATION - 0.01, 50)
    q, dq, ddq = reference.sample(t)
    np.testing.assert_allclose(central_difference(lambda x: reference.sample(x).q, t), dq, rtol=0, atol=1e-8)
    np.testing.assert_allclose(central_difference(lambda x: reference.sample(x).dq, t), ddq, rtol=0, atol=2e-7)
    rate = np.einsum("kij,kj->ki", jacobian(frames(reference.robot, q)), dq)
    np.testing.assert_allclose(rate[:, :3], reference.tip(t).velocity, rtol=0, atol=1e-13)


def test_the_orientation_is_kept_where_it_is_asked_for_and_the_joints_allow_it(reference):
    rotation = frames(reference.robot, reference.sample(T).q).rotation[:, -1]
    turned = np.linalg.norm(kinematics._rotation_vector(rotation @ rotation[0].T), axis=-1).max()
    if reference.orientation == "constant":
        assert reference.keeps_orientation
        assert turned < 1e-13
    else:
        assert turned > 1e-3


def test_redundant_joints_share_as_at_the_start():
    """Nᵀ (q - q_0) = 0 with N the null space of the Jacobian at q_0."""
    reference = reference_of("panda", "circle")
    q = reference.sample(T).q
    rows = jacobian(frames(reference.robot, q[0]))
    free = np.linalg.svd(rows)[2][-1]
    np.testing.assert_allclose(rows @ free, 0.0, atol=1e-14)
    np.testing.assert_allclose((q - q[0]) @ free, 0.0, atol=1e-13)
    assert np.abs(q - q[0]).max() > 0.1


PLANE = Circle(), Lemniscate((0.4, 0.4), 0.2, angle=0.5)


@pytest.mark.parametrize("case", slow_but([(PLANE[0], 1), (PLANE[1], -1)], itertools.product(PLANE, (1, -1))))
def test_for_two_joints_it_is_the_closed_form(case):
    path, elbow_sign = case
    closed = JointReference(path, elbow_sign=elbow_sign)
    placed = Placed(path, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    posture = tuple(closed.sample(0.0).q + 0.2)
    general = TipReference(placed, closed.duration, Robot.of(ArmParameters()), posture)
    assert not general.keeps_orientation
    t = np.linspace(0.0, 1.5, 301)
    for mine, exact, error in zip(general.sample(t), closed.sample(t), (1e-13, 1e-12, 1e-10), strict=True):
        np.testing.assert_allclose(mine, exact, rtol=0, atol=error)
    np.testing.assert_allclose(general.normals(t)[:, :2], closed.normals(t), atol=1e-15)
    np.testing.assert_allclose(general.tip(t).position[:, :2], closed.tip(t).position, atol=1e-15)


def test_the_posture_chooses_the_branch():
    """Of the UR5: the elbow below the line from shoulder to wrist instead of above it."""
    robot, above = ROBOTS["ur5"], reference_of("ur5", "line")
    shoulder, elbow = (above.robot.joints[k].name for k in (1, 2))
    assert ("lift" in shoulder, "elbow" in elbow) == (True, True)
    turned = np.array(above.posture)
    turned[1] += turned[2]
    turned[3] += turned[2]
    turned[2] *= -1.0  # the sum of the three, and so the rotation of the last link, stays
    below = TipReference(above.path, DURATION, robot, tuple(turned))
    np.testing.assert_array_equal(below.tip(T).position, above.tip(T).position)
    assert above.sample(T).q[:, 2].max() < 0.0 < below.sample(T).q[:, 2].min()


def test_a_path_that_leaves_the_reach_says_where():
    robot = ROBOTS["ur5"]
    place = start_of(robot)
    outwards = place / np.linalg.norm(place)
    with pytest.raises(ValueError, match=r"t = [\d.]+ s, point \(.*\) m.*singular value") as error:
        TipReference(Line(tuple(place), tuple(place + 0.6 * outwards)), DURATION, robot)
    point = np.array([float(x) for x in re.search(r"point \((.*?)\) m", str(error.value)).group(1).split(",")])
    travelled = (point - place) @ outwards
    assert 0.02 < travelled < 0.4
    TipReference(Line(tuple(place), tuple(place + 0.5 * travelled * outwards)), DURATION, robot)


def test_a_nearly_singular_path_names_time_point_and_joint():
    """A wrist of the UR5 that comes to q5 = 0: its first and last axes are then parallel."""
    robot = ROBOTS["ur5"]
    posture = np.array([0.0, -1.5, 1.8, -1.2, 0.008, 0.0])
    place = frames(robot, posture).tip
    line = Line(tuple(place), tuple(place + np.array([0.0, 0.0, 0.05])))
    with pytest.raises(ValueError, match=r"singular posture at t = .*allowed: 0.01 or more. There wrist_\d"):
        TipReference(line, DURATION, robot, tuple(posture))


def test_joint_ranges_and_velocities_name_joint_and_excess():
    robot, reference = ROBOTS["ur5"], reference_of("ur5", "circle")
    q = reference.sample(np.linspace(0.0, DURATION, 801)).q
    number = int(np.argmax(np.ptp(q, axis=0)))
    peak = q[:, number].max()
    joints = list(robot.joints)
    joint = joints[number] = dataclasses.replace(joints[number], angle_range=(-3.0, peak - 0.01))
    narrow = dataclasses.replace(robot, joints=tuple(joints))
    with pytest.raises(ValueError, match=rf"{joint.name} leaves its range at t = .* 0\.01 rad beyond .*another `post"):
        TipReference(reference.path, DURATION, narrow, reference.posture)
    with pytest.raises(ValueError, match=r"turns at .* % beyond its velocity limit.*Raise duration") as error:
        TipReference(reference.path, 0.3, robot)
    needed = float(re.search(r"to (\S+) s or more", str(error.value)).group(1))
    TipReference(reference.path, needed, robot)
    with pytest.raises(ValueError, match="Raise duration"):
        TipReference(reference.path, needed - 0.003, robot)


UR5, PLANAR = ROBOTS["ur5"], ROBOTS["planar-3r"]
FAR = Line((2.0, 0.0, 0.0), (1.0, 0.0, 0.0))
BESIDE = Line(tuple(start_of(PLANAR)), tuple(np.add(start_of(PLANAR), (0.0, 0.1, 0.05))))
BAD = [
    ({"path": 3.0}, TypeError, r"path = 3\.0 must have a method points"),
    ({"path": Circle()}, ValueError, r"returned p of shape .* allowed: \(2001, 3\)"),
    ({"posture": (0.0,) * 5}, ValueError, r"posture = .* must be 6 real numbers"),
    ({"posture": (0.0, 0.0, 9.0, 0.0, 0.0, 0.0)}, ValueError, r"posture: elbow\w* = 9 rad is out of range"),
    ({"orientation": "fixed"}, ValueError, r"orientation = 'fixed' is unknown; choose from: constant, free"),
    ({"path": FAR}, ValueError, r"starts out of reach: point \(2, 0, 0\) m is 2\.00\d* m .* comes within 1\.\d+"),
    ({"robot": PLANAR, "path": BESIDE}, ValueError, r"planar: its tip cannot reach .* 0\.05 m off its plane"),
]


@pytest.mark.parametrize(("arguments", "error", "message"), BAD)
def test_bad_arguments_are_named(arguments, error, message):
    good = {"path": Line(tuple(start_of(UR5)), tuple(start_of(UR5) + 0.05)), "duration": DURATION, "robot": UR5}
    with pytest.raises(error, match=message):
        TipReference(**(good | arguments))


def postures(robot, count=4):
    """Postures about home, (count, n)."""
    steps = np.random.default_rng(len(robot)).uniform(-0.15, 0.15, (count, len(robot)))
    return np.array(home_posture(robot)) + steps


@pytest.fixture(params=("planar-3r", "panda"))
def spline(request):
    return SplineReference(postures(ROBOTS[request.param]), DURATION, ROBOTS[request.param])


def test_a_spline_passes_its_postures_and_rests_at_both_ends(spline):
    wanted = postures(spline.robot)
    np.testing.assert_allclose(spline.sample(spline.corners()).q, wanted, atol=1e-13)
    ends = spline.sample([-1.0, 0.0, DURATION, 9.0])
    assert not ends.dq.any() and not ends.ddq.any()
    chords = np.linalg.norm(np.diff(wanted, axis=0), axis=1).cumsum()
    s = quintic_time_law(spline.corners()[1:-1], DURATION)[0]
    np.testing.assert_allclose(s, chords[:-1] / chords[-1], atol=1e-13)


def test_derivatives_of_a_spline_match_central_differences_and_do_not_jump_at_the_postures(spline):
    t = np.random.default_rng(0).uniform(0.01, DURATION - 0.01, 100)
    _, dq, ddq = spline.sample(t)
    np.testing.assert_allclose(central_difference(lambda x: spline.sample(x).q, t), dq, rtol=0, atol=1e-8)
    np.testing.assert_allclose(central_difference(lambda x: spline.sample(x).dq, t), ddq, rtol=0, atol=1e-4)
    inner = spline.corners()[1:-1]
    for before, after in zip(spline.sample(inner - 1e-9), spline.sample(inner + 1e-9), strict=True):
        np.testing.assert_allclose(before, after, atol=1e-7)


def test_a_spline_beyond_a_limit_names_the_joint_and_the_way_out():
    robot = ROBOTS["panda"]
    home = np.array(home_posture(robot))
    beyond = home.copy()
    beyond[3] = 0.1
    with pytest.raises(ValueError, match=r"waypoints\[1\]: \w+ = 0\.1 rad is out of .*\[-3\.0718, -0\.0698\]"):
        SplineReference((home, beyond), DURATION, robot)
    edge = np.tile(home, (4, 1))
    edge[:, 3] = (-1.5, -0.08, -0.3, -2.0)
    edge[:, 0] = (0.0, 0.1, 0.2, 0.3)
    with pytest.raises(ValueError, match=r"joint4 leaves its range at t = .* 0\.\d+ rad beyond .*Add waypoints"):
        SplineReference(edge, DURATION, robot)
    with pytest.raises(ValueError, match=r"turns at .* beyond its velocity limit.*Raise duration") as error:
        SplineReference((home, home - 0.5), 0.2, robot)
    needed = float(re.search(r"to (\S+) s or more", str(error.value)).group(1))
    SplineReference((home, home - 0.5), needed, robot)


@pytest.mark.parametrize(
    ("waypoints", "error", "message"),
    [
        (3.0, TypeError, "waypoints = 3.0 must be a sequence of postures"),
        ([(0.0,) * 6], ValueError, "the number of waypoints is 1; allowed: 2 to"),
        ([(0.0,) * 6, (0.1,) * 5], ValueError, r"waypoints\[1\] = .* must be 6 real numbers"),
        ([(0.1,) * 6, (0.1,) * 6], ValueError, r"waypoints\[0\] and waypoints\[1\] are 0 rad apart"),
        ([(0.1,) * 6, ("up",) * 6], TypeError, r"waypoints\[1\]\[0\] = 'up' must be a real number"),
    ],
)
def test_bad_waypoints_are_named(waypoints, error, message):
    with pytest.raises(error, match=message):
        SplineReference(waypoints, DURATION, UR5)


every_robot = pytest.mark.parametrize("robot", [*map(robot_named, shipped_robots())], ids=shipped_robots())
STEP = 1e-6


def motions(robot, count=20):
    """Angles and velocities, (count, n) each."""
    generator = np.random.default_rng(1)
    low, high = angle_ranges(robot)
    return generator.uniform(low, high, (count, len(robot))), generator.normal(size=(count, len(robot)))


@every_robot
def test_the_last_link_turns_as_the_jacobian_says_within_reach(robot):
    q, dq = motions(robot)
    now, before, after = frames(robot, q), frames(robot, q - STEP * dq), frames(robot, q + STEP * dq)
    turned = kinematics._rotation_vector(after.rotation[:, -1] @ np.swapaxes(before.rotation[:, -1], -1, -2))
    rate = np.einsum("kij,kj->ki", jacobian(now), dq)
    np.testing.assert_allclose(turned / (2.0 * STEP), rate[:, 3:], atol=1e-8)
    np.testing.assert_allclose((after.tip - before.tip) / (2.0 * STEP), rate[:, :3], atol=1e-8)
    assert np.linalg.norm(now.tip - robot.arrays.position[0], axis=1).max() <= reach(robot)


@every_robot
def test_drift_is_the_rate_of_the_jacobian_times_the_velocity(robot):
    q, dq = motions(robot)
    rates = [np.einsum("kij,kj->ki", jacobian(frames(robot, q + sign * STEP * dq)), dq) for sign in (1, -1)]
    np.testing.assert_allclose(kinematics._drift(frames(robot, q), dq), (rates[0] - rates[1]) / (2.0 * STEP), atol=1e-7)


def test_rotation_vectors_are_those_of_scipy():
    vectors = np.random.default_rng(2).normal(size=(50, 3))
    vectors[0] = 0.0
    vectors[1] *= 1e-9
    found = kinematics._rotation_vector(Rotation.from_rotvec(vectors).as_matrix())
    np.testing.assert_allclose(found, vectors, atol=1e-12)


@pytest.mark.parametrize(("name", "moves", "turns"), [("paper", 2, 1), ("planar-3r", 2, 1), ("ur5", 3, 3)])
def test_planar_robots_are_found_out(name, moves, turns):
    can = freedom(robot_named(name))
    assert (len(can.motion), len(can.turning)) == (moves, turns)
    if moves == 2:
        np.testing.assert_array_equal(can.motion, np.eye(3)[:2])
        np.testing.assert_array_equal(can.turning, np.eye(3)[2:])


@every_robot
def test_the_home_posture_is_inside_the_ranges_and_can_be_held(robot):
    home, (low, high) = np.array(home_posture(robot)), angle_ranges(robot)
    assert ((low < home) & (home < high)).all()
    assert (np.abs(gravity(robot, home)) <= 0.5 * robot.drive("torque_limit")).all()
