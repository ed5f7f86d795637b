"""References of robots along paths and splines, the kinematics of the last link, and what any arm does by default."""

import dataclasses
import functools
import itertools
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slow_twins import slow_but
from support.differences import central_difference
from support.robots import with_drives

from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import frames, gravity, inverse_dynamics, tip_jacobian
from fuzzyarm.envs.physics.robot import Robot, robot_named, shipped_robots
from fuzzyarm.envs.scenario import cases
from fuzzyarm.envs.scenario.cases import Case, case_for, find_case, with_loads
from fuzzyarm.envs.scenario.default_reference import default_reference, reference_family
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.envs.scenario.kinematics import angle_ranges, freedom, home_posture, jacobian, reach, velocity_limits
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line, Placed, Spline
from fuzzyarm.envs.scenario.reference import JointReference, quintic_time_law
from fuzzyarm.envs.scenario.robot_reference import SplineReference, TipReference

ROBOTS = {name: robot_named(name) for name in ("planar-3r", "ur5", "panda")}
DURATION = 4.0
T = np.linspace(0.0, DURATION, 201)


def start_of(robot):
    return frames(robot, np.array(home_posture(robot))).tip


def paths(robot):
    """Paths about the home posture, in the x-y plane of a planar robot and elsewhere in space."""
    place = start_of(robot)
    x, y, up = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.6, 0.8)
    first, second = (x, y) if robot.name.startswith("planar") else (up, x)
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
    kind, _, orientation = kind.partition(", ")
    return TipReference(paths(ROBOTS[name])[kind], DURATION, ROBOTS[name], orientation=orientation or "constant")


@pytest.fixture(params=slow_but(FAST, itertools.product(ROBOTS, KINDS)), ids=", ".join)
def reference(request):
    return reference_of(*request.param)


def test_the_tip_is_on_the_path_at_every_time_and_at_rest_outside(reference):
    expected = reference.path.points(quintic_time_law(T, DURATION)[0])[0]
    np.testing.assert_allclose(frames(reference.robot, reference.sample(T).q).tip, expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(reference.tip(T).position, expected, rtol=0, atol=1e-15)
    normals = reference.normals(T)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-14)
    np.testing.assert_allclose(np.sum(normals * reference.tip(T).velocity, axis=-1), 0.0, atol=1e-14)
    rest = reference.sample([-1.0, 0.0, DURATION, DURATION + 1.0])
    np.testing.assert_array_equal(rest.q[[0, 3]], rest.q[[1, 2]])
    assert not rest.dq.any() and not rest.ddq.any()
    if isinstance(reference.path, Placed):  # a closed path brings every joint back, also the redundant ones
        np.testing.assert_allclose(rest.q[0], rest.q[3], rtol=0, atol=1e-13)
    inner = quintic_time_law(reference.corners()[1:-1], DURATION)[0]
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


def test_the_orientation_is_kept_where_it_is_asked_for(reference):
    rotation = frames(reference.robot, reference.sample(T).q).rotation[:, -1]
    turned = Rotation.from_matrix(rotation @ rotation[0].T).magnitude().max()
    kept = reference.orientation == "constant"
    assert reference.keeps_orientation == kept and (turned < 1e-13 if kept else turned > 1e-3)


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
    assert "lift" in robot.joints[1].name and "elbow" in robot.joints[2].name
    turned = np.array(above.posture)
    turned[1:4] += turned[2] * np.array([1.0, -2.0, 1.0])  # the sum, and so the rotation of the last link, stays
    below = TipReference(above.path, DURATION, robot, tuple(turned))
    np.testing.assert_array_equal(below.tip(T).position, above.tip(T).position)
    assert above.sample(T).q[:, 2].max() < 0.0 < below.sample(T).q[:, 2].min()


def test_a_path_that_leaves_the_reach_or_is_nearly_singular_says_where():
    robot = ROBOTS["ur5"]
    place = start_of(robot)
    outwards = place / np.linalg.norm(place)
    with pytest.raises(ValueError, match=r"t = [\d.]+ s, point \(.*\) m.*singular value") as error:
        TipReference(Line(tuple(place), tuple(place + 0.6 * outwards)), DURATION, robot)
    point = re.search(r"point \((.*?)\) m", str(error.value)).group(1).split(",")
    travelled = (np.array(point, float) - place) @ outwards
    assert 0.02 < travelled < 0.4
    TipReference(Line(tuple(place), tuple(place + 0.5 * travelled * outwards)), DURATION, robot)
    # A wrist that comes to q5 = 0: its first and last axes are then parallel.
    posture = np.array([0.0, -1.5, 1.8, -1.2, 0.008, 0.0])
    place = frames(robot, posture).tip
    with pytest.raises(ValueError, match=r"singular posture at t = .*allowed: 0.01 or more. There wrist_\d"):
        TipReference(Line(tuple(place), tuple(place + np.array([0.0, 0.0, 0.05]))), DURATION, robot, tuple(posture))


def too_fast(made):
    """The duration that helps [s]."""
    with pytest.raises(ValueError, match=r"turns at .* % beyond its velocity limit.*Raise duration") as error:
        made(0.2)
    needed = float(re.search(r"to (\S+) s or more", str(error.value)).group(1))
    made(needed)
    return needed


def test_joint_ranges_and_velocities_name_joint_and_excess():
    robot, reference = ROBOTS["ur5"], reference_of("ur5", "circle")
    q = reference.sample(np.linspace(0.0, DURATION, 801)).q
    number = int(np.argmax(np.ptp(q, axis=0)))
    joint = dataclasses.replace(robot.joints[number], angle_range=(-3.0, q[:, number].max() - 0.01))
    narrow = dataclasses.replace(robot, joints=(*robot.joints[:number], joint, *robot.joints[number + 1 :]))
    with pytest.raises(ValueError, match=rf"{joint.name} leaves its range at t = .* 0\.01 rad beyond .*another `post"):
        TipReference(reference.path, DURATION, narrow, reference.posture)
    needed = too_fast(lambda duration: TipReference(reference.path, duration, robot))
    with pytest.raises(ValueError, match="Raise duration"):
        TipReference(reference.path, needed - 0.003, robot)


UR5, PLANAR = ROBOTS["ur5"], ROBOTS["planar-3r"]
FAR = Line((2.0, 0.0, 0.0), (1.0, 0.0, 0.0))
BESIDE = Line(tuple(start_of(PLANAR)), tuple(np.add(start_of(PLANAR), (0.0, 0.1, 0.05))))
ZEROS, ONES = (0.0,) * 6, (0.1,) * 6
BAD = [  # TypeErrors and ValueErrors, of a path or of waypoints
    ({"path": 3.0}, r"path = 3\.0 must have a method points"),
    ({"path": Circle()}, r"returned p of shape .* needed: shape \(2001, 3\)"),
    ({"posture": (0.0,) * 5}, r"posture = .* must be 6 real numbers"),
    ({"posture": (0.0, 0.0, 9.0, 0.0, 0.0, 0.0)}, r"posture: elbow\w* = 9 rad is out of range"),
    ({"orientation": "fixed"}, r"orientation = 'fixed' is unknown; choose from: constant, free"),
    ({"path": FAR}, r"starts out of reach: point \(2, 0, 0\) m is 2\.00\d* m .* comes within 1\.\d+"),
    ({"robot": PLANAR, "path": BESIDE}, r"planar: its tip cannot reach .* 0\.05 m off its plane"),
    ({"waypoints": 3.0}, "waypoints = 3.0 must be a sequence of postures"),
    ({"waypoints": [ZEROS]}, "the number of waypoints is 1; allowed: 2 to"),
    ({"waypoints": [ZEROS, (0.1,) * 5]}, r"waypoints\[1\] = .* must be 6 real numbers"),
    ({"waypoints": [ONES, ONES]}, r"waypoints\[0\] and waypoints\[1\] are 0 rad apart"),
    ({"waypoints": [ONES, ("up",) * 6]}, r"waypoints\[1\]\[0\] = 'up' must be a real number"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD)
def test_bad_arguments_are_named(arguments, message):
    along = functools.partial(TipReference, path=Line(tuple(start_of(UR5)), tuple(start_of(UR5) + 0.05)))
    with pytest.raises((TypeError, ValueError), match=message):
        (SplineReference if "waypoints" in arguments else along)(**{"duration": DURATION, "robot": UR5} | arguments)


def postures(robot):
    return home_posture(robot) + np.random.default_rng(len(robot)).uniform(-0.15, 0.15, (4, len(robot)))


@pytest.fixture(params=("planar-3r", "panda"))
def spline(request):
    return SplineReference(postures(ROBOTS[request.param]), DURATION, ROBOTS[request.param])


def test_a_spline_passes_its_postures_from_rest_to_rest_with_derivatives_that_do_not_jump(spline):
    wanted = postures(spline.robot)
    np.testing.assert_allclose(spline.sample(spline.corners()).q, wanted, atol=1e-13)
    ends = spline.sample([-1.0, 0.0, DURATION, 9.0])
    assert not ends.dq.any() and not ends.ddq.any()
    chords = np.linalg.norm(np.diff(wanted, axis=0), axis=1).cumsum()
    s = quintic_time_law(spline.corners()[1:-1], DURATION)[0]
    np.testing.assert_allclose(s, chords[:-1] / chords[-1], atol=1e-13)
    t = np.random.default_rng(0).uniform(0.01, DURATION - 0.01, 100)
    _, dq, ddq = spline.sample(t)
    np.testing.assert_allclose(central_difference(lambda x: spline.sample(x).q, t), dq, rtol=0, atol=1e-8)
    np.testing.assert_allclose(central_difference(lambda x: spline.sample(x).dq, t), ddq, rtol=0, atol=1e-4)
    inner = spline.corners()[1:-1]
    np.testing.assert_allclose(spline.sample(inner - 1e-9), spline.sample(inner + 1e-9), atol=1e-7)


def test_a_spline_beyond_a_limit_names_the_joint_and_the_way_out():
    robot = ROBOTS["panda"]
    home = np.array(home_posture(robot))
    with pytest.raises(ValueError, match=r"waypoints\[1\]: \w+ = 0\.1 rad is out of .*\[-3\.0718, -0\.0698\]"):
        SplineReference((home, np.where(np.arange(len(home)) == 3, 0.1, home)), DURATION, robot)
    edge = np.tile(home, (4, 1))
    edge[:, [0, 3]] = (0.0, -1.5), (0.1, -0.08), (0.2, -0.3), (0.3, -2.0)
    with pytest.raises(ValueError, match=r"joint4 leaves its range at t = .* 0\.\d+ rad beyond .*Add waypoints"):
        SplineReference(edge, DURATION, robot)
    too_fast(lambda duration: SplineReference((home, home - 0.5), duration, robot))


STEP = 1e-6


@pytest.mark.parametrize("name", shipped_robots())
def test_the_last_link_turns_as_the_jacobian_says_within_reach_and_the_home_posture_can_be_held(name):
    robot = robot_named(name)
    generator, shape = np.random.default_rng(1), (20, len(robot))
    q, dq = generator.uniform(*angle_ranges(robot), shape), generator.normal(size=shape)
    now, before, after = frames(robot, q), frames(robot, q - STEP * dq), frames(robot, q + STEP * dq)
    turned = Rotation.from_matrix(after.rotation[:, -1] @ np.swapaxes(before.rotation[:, -1], -1, -2)).as_rotvec()
    rate = np.einsum("kij,kj->ki", jacobian(now), dq)
    np.testing.assert_allclose(turned / (2.0 * STEP), rate[:, 3:], atol=1e-8)
    np.testing.assert_allclose((after.tip - before.tip) / (2.0 * STEP), rate[:, :3], atol=1e-8)
    assert np.linalg.norm(now.tip - robot.arrays.position[0], axis=1).max() <= reach(robot)
    home, (low, high) = np.array(home_posture(robot)), angle_ranges(robot)
    assert ((low < home) & (home < high)).all()
    assert (np.abs(gravity(robot, home)) <= 0.5 * robot.drive("torque_limit")).all()


def test_planar_robots_are_found_out():
    for name in ("paper", "planar-3r"):
        can = freedom(robot_named(name))
        np.testing.assert_array_equal(can.motion, np.eye(3)[:2])
        np.testing.assert_array_equal(can.turning, np.eye(3)[2:])
    can = freedom(robot_named("ur5"))
    assert (len(can.motion), len(can.turning)) == (3, 3)


SHORT_ARM = dataclasses.replace(ArmParameters(), length=(0.5, 0.4), mass_center=(0.25, 0.2), stiffness=(8e3, 5e3))


def shares(reference, arm):
    """The largest shares of the speed and torque limits that a motion takes of the rigid arm."""
    robot = robot_of(arm)
    q, dq, ddq = reference.sample(np.linspace(0.0, reference.duration, 800))
    torque = inverse_dynamics(robot, q, dq, ddq) + robot.drive("motor_inertia") * ddq
    return np.max(np.abs(dq) / velocity_limits(robot)), np.max(np.abs(torque) / robot.drive("torque_limit"))


def test_the_papers_arm_keeps_the_papers_motion_bit_for_bit_and_a_shorter_one_gets_a_circle_from_home():
    t = np.linspace(0.0, 1.5, 301)
    for arm, close in ((ArmParameters(), 0.0), (robot_named("paper"), 1e-10)):
        for mine, paper in zip(default_reference(arm).sample(t), JointReference().sample(t), strict=True):
            np.testing.assert_allclose(mine, paper, rtol=0, atol=close)
    short = Robot.of(ArmParameters(length=(0.3, 0.2), mass_center=(0.15, 0.1)))
    reference = default_reference(short)  # the paper's circle is out of its reach
    assert isinstance(reference, TipReference)
    np.testing.assert_allclose(reference.sample(0.0).q, home_posture(short), atol=1e-12)


@pytest.mark.parametrize("name", slow_but(["planar-3r"], ["planar-3r", "ur5", "panda"]))
def test_the_circle_follows_its_rule(name):
    robot = robot_named(name)
    reference = default_reference(robot)
    np.testing.assert_allclose(reference.sample([0.0, reference.duration]).q, [home_posture(robot)] * 2, atol=1e-12)
    center, radius = reference.circle
    assert radius / reach(robot) == pytest.approx(0.2)
    up = -robot.arrays.gravity / np.linalg.norm(robot.arrays.gravity)
    np.testing.assert_allclose(reference.tip(0.0).position, center - radius * up, atol=1e-12)
    assert max(shares(reference, robot)) <= 0.5
    if reference.duration > 1.5:
        shorter = dataclasses.replace(reference, duration=reference.duration - 0.1)
        assert max(shares(shorter, robot)) > 0.5


@pytest.mark.slow
def test_a_robot_that_cannot_hold_itself_says_so():
    with pytest.raises(ValueError, match=r"ur5 cannot follow a circle .* % of the torque limit of elbow"):
        default_reference(with_drives(robot_named("ur5"), torque_limit=8.0))


@pytest.mark.parametrize("name", slow_but(["circle", "lemniscate"], ["circle", "lemniscate", "line", "square"]))
def test_an_arm_too_short_for_the_papers_circle_follows_every_path_within_half_of_its_limits(name):
    reference = default_reference(SHORT_ARM, name)
    assert isinstance(reference, JointReference) and reference.duration >= 1.5
    assert max(shares(reference, SHORT_ARM)) <= 0.501
    tip = reference.tip(np.linspace(0.0, reference.duration, 200)).position
    assert np.ptp(tip, axis=0).max() > 0.1 and np.hypot(*tip.T).max() < sum(SHORT_ARM.length)
    if name == "circle":
        center, radius = reference.circle
        np.testing.assert_allclose(np.linalg.norm(tip - center, axis=1), radius, rtol=1e-12)
        assert radius == pytest.approx(0.2 * sum(SHORT_ARM.length))


def test_weak_motors_take_longer_for_the_same_path():
    weak = dataclasses.replace(ArmParameters(), torque_limit=(320.0, 110.0))
    slower, paper = default_reference(weak, "lemniscate"), default_reference(ArmParameters(), "lemniscate")
    assert slower.path == paper.path and slower.duration > paper.duration
    assert max(shares(slower, weak)) <= 0.501
    assert default_reference(weak).duration == 1.5  # the paper's circle stays the paper's


def load_shares(robot):
    """The largest shares of a torque limit that payload and force at the tip take along the default reference."""
    reference = default_reference(robot)
    t = np.linspace(0.0, reference.duration, 201)
    weight = case_for("payload", robot).disturbance.payload.mass * robot.arrays.gravity
    push = dataclasses.replace(case_for("machining", robot).disturbance.tip_force, duration=1e-9, swing=0.0)
    forces = np.array([np.broadcast_to(weight, (len(t), 3)), push.at(t, reference.tip(t).velocity)])
    torque = np.einsum("tij,fti->ftj", tip_jacobian(robot, reference.sample(t).q), forces)
    return np.max(np.abs(torque) / robot.drive("torque_limit"), axis=(1, 2))


@pytest.mark.parametrize("name", ["planar-3r", "ur5"])
def test_loads_take_the_share_of_the_motors_that_they_take_of_the_papers(name):
    robot = robot_named(name)
    np.testing.assert_allclose(load_shares(robot), load_shares(Robot.of(ArmParameters())), rtol=0.06)
    assert case_for("machining", robot).disturbance.tip_force.duration == default_reference(robot).duration


def test_titles_say_the_load_and_the_paper_and_ones_own_cases_keep_theirs(monkeypatch):
    robot = robot_named("planar-3r")
    case = case_for("payload", robot)
    assert case.title == f"Case 3: {case.disturbance.payload.mass:g} kg payload" and case.disturbance.payload.mass < 5.0
    mine = Case("mine", "Mine", Disturbance(payload=Payload(3.0), tip_force=ConstantForce((1.0, 2.0, 3.0))))
    monkeypatch.setitem(cases.CASES, "mine", mine)
    assert case_for("nominal", robot) is find_case("nominal") and case_for("mine", robot) is mine
    for name in cases.PAPER_CASES:
        assert case_for(name, ArmParameters()) is find_case(name)
    with pytest.raises(ValueError, match="unknown case 'other'; choose from: nominal"):
        case_for("other", robot)


def test_the_references_of_a_robots_family_begin_and_end_at_home_within_the_motors():
    robot = robot_named("planar-3r")
    family = reference_family(robot, 4)
    assert family is reference_family(robot, 4) and len({reference.duration for reference in family}) == 4
    for reference in family:
        motion = reference.sample(np.linspace(0.0, reference.duration, 300))
        np.testing.assert_allclose(motion.q[[0, -1]], np.tile(family[0].sample(0.0).q, (2, 1)), atol=1e-12)
        assert 0.01 < np.max(np.abs(motion.dq) / velocity_limits(robot)) <= 0.5
    with pytest.raises(ValueError, match="too weak to move it about its home"):
        reference_family(with_drives(robot, torque_limit=0.1), 2)


def test_loads_are_the_papers_for_its_lengths_and_limits_and_scaled_otherwise():
    stiff = dataclasses.replace(ArmParameters(), stiffness=(1e5, 5e4), mass=(12.0, 8.0))
    for name in ("machining", "payload"):
        assert case_for(name, stiff) is find_case(name)
    weak = dataclasses.replace(ArmParameters(), torque_limit=(250.0, 125.0))
    assert case_for("payload", weak).disturbance.payload.mass == pytest.approx(2.5, abs=0.06)
    force = case_for("machining", weak).disturbance.tip_force
    assert (force.base, force.base + force.swing) == pytest.approx((69.0, 109.0), abs=1.1)
    given = with_loads(find_case("payload"), payload=3.0)
    assert given.disturbance.payload.mass == 3.0 and given.title == "Case 3: 3 kg payload"
    force = with_loads(find_case("machining"), force=(10.0, 30.0), duration=2.0).disturbance.tip_force
    assert (force.base, force.swing, force.duration) == (10.0, 20.0, 2.0)
