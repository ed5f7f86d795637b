"""A serial robot with elastic joints as data: joint frames, inertias of the links, drives and limits.

A robot is a chain of links. Joint i turns link i about a fixed axis of link i - 1 (link 0 is the base):

    R_i(q) = R_{i-1}(q) A_i exp([u_i]× q_i),    p_i(q) = p_{i-1}(q) + R_{i-1}(q) d_i,

with A_i the joint frame's rotation and d_i its position at angle 0, u_i the axis, R_i and p_i rotation and origin of
link i in the base. Each joint is driven through a spring: motor angle q_a, link angle q_b, torque
Γ_t = k_t (q_a - q_b) + b_t (q̇_a - q̇_b). `rigid_body` has the equations of motion of the links.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.common.documents import read_toml, record
from fuzzyarm.envs.physics.friction import DryFriction, dry_friction_of
from fuzzyarm.envs.physics.joint import DIMENSIONS, DRIVE_UNITS, Drive, Joint, Link, Vector, as_rows, as_vector
from fuzzyarm.envs.physics.parameters import LARGEST, ArmParameters
from fuzzyarm.envs.physics.ranges import Ranges

__all__ = ["MOST_JOINTS", "Robot", "robot_named", "shipped_robots"]

MOST_JOINTS = 12  # most joints of a robot: the machine code of its equations grows with the square of their number
_POINT_LIKE = 1e-12  # kg m², used in place of the inertia 0, which `ArmParameters` allows

_SHIPPED = Path(__file__).parent / "robots"


class _Arrays(NamedTuple):
    """The data of a robot with n joints as read-only arrays; quantities and units as in `Joint` and `Link`."""

    position: np.ndarray  # (n, 3)
    rotation: np.ndarray  # (n, 3, 3)
    axis: np.ndarray  # (n, 3)
    mass: np.ndarray  # (n,)
    center: np.ndarray  # (n, 3)
    inertia: np.ndarray  # (n, 3, 3)
    tip: np.ndarray  # (3,)
    gravity: np.ndarray  # (3,)


@dataclasses.dataclass(frozen=True)
class Robot:
    """A serial robot with revolute elastic joints.

    Attributes:
        name: the robot's name.
        joints: the joints in order from the base to the tip, 1 to `MOST_JOINTS`.
        tip: position of the tip [m], shape (3,), in the frame of the last link.
        gravity: acceleration of free fall [m/s²], shape (3,), in the base frame.
        sources: where the values come from.
        assumptions: which values are assumed, and why.

    Examples:
        >>> len(robot_named("ur5").joints)
        6
    """

    name: str
    joints: tuple[Joint, ...]
    tip: Vector
    gravity: Vector = (0.0, 0.0, -9.81)
    sources: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        checks.instance("name", self.name, str)
        joints = tuple(checks.instance("joints", joint, Joint) for joint in checks.sequence_of("joints", self.joints))
        checks.keep(self, "joints", joints)
        checks.whole("the number of joints", len(joints), low=1, high=MOST_JOINTS)
        checks.distinct("joints", [joint.name for joint in joints])
        checks.keep(self, "tip", as_vector("tip", self.tip, "m"))
        checks.keep(self, "gravity", as_vector("gravity", self.gravity, "m/s^2"))
        for name in ("sources", "assumptions"):
            checks.keep(self, name, tuple(checks.texts(name, getattr(self, name))))

    def __len__(self) -> int:
        return len(self.joints)

    @functools.cached_property
    def digest(self) -> str:
        """Hexadecimal SHA-256 digest of all numerical data; names and texts do not affect it."""
        numbers = dataclasses.asdict(self)
        for name in ("name", "sources", "assumptions"):
            del numbers[name]
        for joint in numbers["joints"]:
            del joint["name"]
        return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()

    @functools.cached_property
    def arrays(self) -> _Arrays:
        """The data of the joint frames and the links as read-only arrays."""
        joints, links = self.joints, [joint.link for joint in self.joints]
        frames = [np.array([getattr(one, name) for one in joints]) for name in ("position", "rotation", "axis")]
        bodies = [np.array([getattr(one, name) for one in links]) for name in ("mass", "center", "inertia")]
        values = _Arrays(*[*frames, *bodies, np.array(self.tip), np.array(self.gravity)])
        for array in values:
            array.flags.writeable = False
        return values

    def drive(self, name: str) -> np.ndarray:
        """Return the values (n,) of the field `name` of `Drive`, one for each joint."""
        return np.array([getattr(joint.drive, name) for joint in self.joints])

    def with_payload(self, mass: float, at: str = "tip") -> Robot:
        """Return the robot with a point mass [kg] at its "tip" or at the centre of mass of its last "link"."""
        carried, last = checks.real("payload mass", mass, "kg", low=0.0, high=LARGEST), self.joints[-1]
        link, places = last.link, {"tip": self.tip, "link": last.link.center}
        place = np.array(places[checks.choice("payload at", at, tuple(places))])
        total, center = link.mass + carried, np.array(link.center)
        arm = place - center
        about = arm @ arm * np.eye(DIMENSIONS) - np.outer(arm, arm)
        inertia = np.array(link.inertia) + link.mass * carried / total * about
        both = Link(total, tuple(center + carried / total * arm), as_rows(inertia))
        return dataclasses.replace(self, joints=(*self.joints[:-1], dataclasses.replace(last, link=both)))

    def with_drives(
        self, motor_inertia: tuple[float, ...] | None = None, stiffness: tuple[float, ...] | None = None
    ) -> Robot:
        """Return the robot with other rotors [kg m²] and springs [N m/rad].

        If a rotor loses the inertia d, its link gains d u uᵀ, with the joint axis u, and the link before, which carries
        the rotor, loses d (A u)(A u)ᵀ, with the joint's rotation A: the rigid mass matrix keeps its diagonal.
        """
        joints, before = list(self.joints), np.zeros((DIMENSIONS, DIMENSIONS))
        for k in reversed(range(len(joints))):
            one, drive = joints[k], joints[k].drive
            rotor = drive.motor_inertia if motor_inertia is None else motor_inertia[k]
            spring = drive.stiffness if stiffness is None else stiffness[k]
            axis, turned = np.array(one.axis), np.array(one.rotation) @ one.axis
            lighter = drive.motor_inertia - rotor
            inertia = as_rows(np.array(one.link.inertia) + lighter * np.outer(axis, axis) - before)
            before = lighter * np.outer(turned, turned)
            try:
                link = dataclasses.replace(one.link, inertia=inertia)
                drive = dataclasses.replace(drive, motor_inertia=rotor, stiffness=spring)
                joints[k] = dataclasses.replace(one, link=link, drive=drive)
            except ValueError as error:
                raise ValueError(f"joint {checks.shown(one.name)}: {error}") from None
        return dataclasses.replace(self, joints=tuple(joints))

    @classmethod
    def of(cls, parameters: ArmParameters) -> Robot:
        """Return the two-joint arm as a robot: x and gravity down, y to the right, axes along z, isotropic inertias."""
        p, frame = parameters, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        joints = []
        for j in range(len(p.length)):
            drive = {n: getattr(p, n)[j] for n in DRIVE_UNITS if n not in DryFriction._fields}
            inertia = as_rows(max(p.inertia[j], _POINT_LIKE) * np.eye(DIMENSIONS))
            joints.append(
                Joint(
                    name=f"joint{j + 1}",
                    position=(p.length[0] * j, 0.0, 0.0),
                    rotation=frame,
                    axis=frame[-1],
                    link=Link(p.mass[j], (p.mass_center[j], 0.0, 0.0), inertia),
                    drive=Drive(**drive, **dry_friction_of(p, j)._asdict()),
                    angle_range=(-p.joint_limit[j], p.joint_limit[j]),
                    velocity_limit=p.velocity_limit[j],
                )
            )
        return cls("two-joint arm", tuple(joints), tip=(p.length[-1], 0.0, 0.0), gravity=(p.gravity, 0.0, 0.0))

    def to_toml(self) -> str:
        """Return a TOML text that `from_toml` reads back to an equal robot; angles in rad, all other units SI."""
        content = dataclasses.asdict(self)
        joints = content.pop("joints")
        lines = ["# Serial robot with elastic joints: rad, m, kg, N m.", *_fields(content)]
        for joint in joints:
            link, drive = _fields(joint.pop("link")), _fields(joint.pop("drive"))
            lines += ["", "[[joints]]", *_fields(joint), "[joints.link]", *link, "[joints.drive]", *drive]
        return "\n".join(lines) + "\n"

    @classmethod
    def from_toml(cls, path: str | Path) -> Robot:
        """Read a robot from a TOML file: the fields of this class, with a table `[[joints]]` for each joint.

        Raises:
            ValueError: the file is not TOML, a field is missing or unknown, or a value is out of range; the message
                names the file, the joint and the field.
            OSError: the file cannot be read.
        """
        content = read_toml(Path(path))
        try:
            ranges = Ranges.taken(content)
            robot = record(content, cls)
            ranges.corners(robot)
            return robot
        except ValueError as error:
            raise ValueError(f"{path}: {_with_joint_name(str(error), content)}") from None


def _fields(content: dict[str, Any]) -> list[str]:
    return [f"{name} = {_value(value)}" for name, value in content.items() if value is not None]


def _value(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_value, value))}]"
    # A JSON string is a TOML string, except that JSON does not escape DEL.
    return json.dumps(value).replace("\x7f", "\\u007f") if isinstance(value, str) else repr(value)


def shipped_robots() -> tuple[str, ...]:
    """Return the names of the robots that come with the package."""
    return tuple(sorted(path.stem for path in _SHIPPED.glob("*.toml")))


def robot_named(name: str) -> Robot:
    """Return a robot that comes with the package, by its name; ValueError lists all names if it is unknown."""
    return _read_once(checks.choice("robot", name, shipped_robots()))


@functools.cache
def _read_once(name: str) -> Robot:
    return Robot.from_toml(_SHIPPED / f"{name}.toml")


def _with_joint_name(message: str, content: dict[str, Any]) -> str:
    """Return `message`; if it contains an index such as ``joints[2]``, begin it with that joint's name in `content`."""
    found = re.search(r"joints\[(\d+)\]", message)
    joints = content.get("joints")
    if not (found and isinstance(joints, list) and int(found[1]) < len(joints)):
        return message
    joint = joints[int(found[1])]
    name = joint.get("name") if isinstance(joint, dict) else None
    return message if name is None or repr(name) in message else f"joint {checks.shown(name)}: {message}"
