"""Plants of a set in lanes, with the friction, force and encoder errors that the set allows, for `tip_bound.py`.

A plant is a column of genes in [0, 1]: where each constant lies in its range, then how what varies with time does.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Arm, loaded, lump, motors, plant_of
from fuzzyarm.envs.physics.equations import tip_point, two_joints
from fuzzyarm.envs.physics.friction import DRY_TORQUES
from fuzzyarm.envs.physics.integrator import hold_of
from fuzzyarm.envs.physics.records import PerJoint, filled, flat
from fuzzyarm.envs.scenario.cases import find_case
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.policies.spec import without_guest
from fuzzyarm.policies.tip_bound import PERIOD, TipClaim, problem_of
from fuzzyarm.proof.tip.plant import BY_JOINT

__all__ = ["CONSTANTS", "GENES", "SUBSTEPS", "Plants", "random_genes"]

SUBSTEPS = 40
CONSTANTS = 14  # genes of what is constant
GENES = CONSTANTS + 5
FASTEST = 80.0  # [Hz], of bang-bang friction, force and errors of the encoders
SLOWEST = 2.0

_hold = hold_of(two_joints())


def random_genes(lanes: int, rng: np.random.Generator) -> np.ndarray:
    """Return genes (GENES, lanes): every other plant lies at a corner of its set."""
    genes = rng.uniform(size=(GENES, lanes))
    genes[:CONSTANTS, ::2] = np.round(genes[:CONSTANTS, ::2])
    return genes


class Plants:
    """Plants of a set in lanes.

    Attributes:
        plant: the constants by lane, without what is carried.
        payload: mass at the tip beside the case's own, by lane [kg].
    """

    def __init__(self, claim: TipClaim, genes: np.ndarray) -> None:
        """Take the claim whose set the plants are of, and their genes (GENES, lanes)."""
        self.problem, self.claim, self.lanes = problem_of(claim), claim, genes.shape[1]
        self._genes, plants = iter(genes), claim.plants
        nominal = plant_of(self.problem.parameters)
        factors = {
            name: PerJoint(*(self._drawn(plants.of_joint(name, joint)) for joint in range(JOINTS))) for name in BY_JOINT
        }
        zero = np.zeros(self.lanes)
        draw = draw_record(JOINTS)(**factors, payload=zero, force=zero, angle=PerJoint(zero, zero), reference=zero)
        self.plant: Any = two_joints().varied(nominal, draw)
        carried = find_case(claim.case).disturbance.payload
        arm = loaded(lump(self.plant), carried.mass, carried.radius(self.problem.parameters), nominal.gravity)
        self.payload = self._drawn(plants.payload)
        arm = loaded(arm, self.payload, nominal.length[1], nominal.gravity)
        self._static = np.array([own.dry_friction.static_friction + zero for own in motors(arm, (0, 1))])
        if plants.friction == "any":
            free = [own.dry_friction._replace(**dict.fromkeys(DRY_TORQUES, 0.0)) for own in motors(arm, (0, 1))]
            arm = arm._replace(dry_friction1=free[0], dry_friction2=free[1])
        self.arm = np.array([np.broadcast_to(x, self.lanes) for x in flat(arm)], dtype=float)
        self.force = self._drawn(plants.force)
        self._rates = np.array([self._drawn((SLOWEST, FASTEST)) for _ in range(JOINTS)])
        self._phases = np.array([next(self._genes) for _ in range(JOINTS)])
        self._kind = np.minimum((4.0 * next(self._genes)).astype(int), 3)

    def _drawn(self, bounds: tuple[float, float]) -> np.ndarray:
        low, high = bounds
        return low + (high - low) * next(self._genes)

    def _waves(self, t: float) -> np.ndarray:
        """Return 1 or -1 (2, lanes)."""
        return np.where((self._rates * t + self._phases) % 1.0 < 0.5, 1.0, -1.0)

    def friction(self, state: np.ndarray, t: float) -> np.ndarray:
        """Return friction torques (2, lanes) [N m] of a set with any friction: waves, with or against the motion."""
        waves, along = self._waves(t), np.where(state[4:6] >= 0.0, 1.0, -1.0)
        return self._static * np.choose(self._kind, [waves, along, -along, np.sign(waves + 0.5 * along)])

    def tip_errors(self, laps: int = 1) -> np.ndarray:
        """Return the tip error (samples of all laps, lanes) [m] from random corners of the box of starts."""
        problem, plants, lanes = self.problem, self.claim.plants, self.lanes
        policy, table = load_policy(without_guest(self.claim.policy)[0]), problem.schedule
        state, memory = np.repeat(problem.start[:, np.newaxis], lanes, axis=1), np.zeros((lanes, policy.memory_size))
        if self.claim.start is not None:
            box = self.claim.start.columns(len(state) + problem.law.memory, problem.law.memory)
            begun = box @ np.sign(np.random.default_rng(0).normal(size=(box.shape[1], lanes)))
            state += begun[: len(state)]
            memory[:, problem.law.remembered] = begun[len(state) :].T
        waiting, errors = None, []
        for k in (*range(table.steps),) * laps:
            now = PERIOD * len(errors)
            waves = self._waves(now)
            noise = np.repeat(plants.noise, JOINTS)[:, np.newaxis] * np.vstack([waves, -waves[::-1]])
            measured = state[[0, 1, 4, 5]] + noise
            seen = np.hstack([measured.T, np.repeat(table.references[k : k + 1], lanes, axis=0)])
            asked, memory = policy.predict(seen, memory)
            asked = asked + (np.array(problem.guest)[:, np.newaxis] * waves).T
            acting = asked if waiting is None else waiting
            waiting = asked if plants.late else None
            force = table.forces[k][:, np.newaxis] * self.force
            force *= 1.0 + plants.force_swing * waves[0]
            force[:2] += plants.force_course * waves
            self._held(state, np.ascontiguousarray(acting.T), force, now)
            tip = tip_point(PerJoint(state[2], state[3]), filled(Arm, self.arm))
            errors.append(np.hypot(tip.x - table.targets[k + 1, 0], tip.y - table.targets[k + 1, 1]))
        return np.array(errors)

    def _held(self, state: np.ndarray, torque: np.ndarray, force: np.ndarray, t: float) -> None:
        if self.claim.plants.friction == "law":
            _hold(state, torque, force, self.arm, PERIOD / SUBSTEPS, SUBSTEPS)
            return
        parts = 10  # in each of which the friction is held
        for part in range(parts):
            line = np.concatenate([force[:2] + ((part + 0.5) / parts - 0.5) * force[2:], force[2:] / parts])
            now = torque + self.friction(state, t + part * PERIOD / parts)
            _hold(state, now, line, self.arm, PERIOD / SUBSTEPS, SUBSTEPS // parts)
