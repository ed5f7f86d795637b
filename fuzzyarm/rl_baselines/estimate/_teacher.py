"""The teacher: the law of the adaptive observer, given the true state, plant, load and delay.

The law gets the true state of the arm, and as its beliefs p the true constants, payload and delay of the lane. The
force is known at the last, current and next samples, so that the motors follow it in time. The student
has to learn the difference between the teacher's torque and its own base torque u_b.
"""

import functools
from typing import Any

import numpy as np

from fuzzyarm.envs.batch.layout import CLOCK
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.equations import equations_of, two_joints
from fuzzyarm.envs.physics.records import columns, filled, flat, size
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.fuzzy_policy.law import seen_by
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import KEPT, Memory, places
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Scratch, begin, take_in
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.adaptive.regulator import act
from fuzzyarm.numbers.functions import Cells
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program
from fuzzyarm.rl_baselines.estimate._courses import Courses

__all__ = ["Teacher"]

_SAMPLES = (*range(0, -KEPT, -1), 1)  # samples of the known force, counted from now


class Teacher:
    """The teacher's torques for the lanes of `Courses`, computed by the law of the adaptive observer."""

    def __init__(self, adaptive: AdaptiveObserverPolicy, courses: Courses) -> None:
        self._lanes, self._delay, self._settings = courses.lanes, courses.delay, adaptive.settings
        self._belief, self._payload, self._physics = adaptive.belief, courses.payload, equations_of(adaptive.arm)
        self._nominal = self._physics.plant_of(adaptive.arm)
        slopes = self._settings.slopes.copy()
        slopes[:, self._belief.lateness] = 0.0
        self._inverse = np.linalg.pinv(slopes)
        self._limit = np.array(adaptive.torque_limit)
        self._force_at = columns(row_record(self._physics.joints, self._physics.axes)).force

    def torque(self, observation: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Return u* (lanes, n) [N m], clipped to the torque limits, for observations (lanes, 5 n) before the step.

        `memory` (lanes, ·) is the memory of the student's adaptive observer, from which the torques in transit are
        read. If the filter of the observer has diverged, these torques are unknown, and u* is nan.
        """
        known = np.stack([self._force(ahead) for ahead in _SAMPLES], axis=1)
        torque = np.empty((len(observation), len(self._limit)))
        known = np.ascontiguousarray(known.reshape(len(known), -1))
        arrays = memory.copy(), observation, np.ascontiguousarray(self.beliefs()), known, torque
        self._acting(arrays, np.empty(0), self._settings.tables)
        wanted: np.ndarray = np.clip(torque, -self._limit, self._limit)
        return wanted

    def beliefs(self) -> np.ndarray:
        """Return the true states and parameters p, (lanes, 4 n + size of p).

        The forces in p are zero, since the law gets the true forces separately.
        """
        s = self._settings
        p = s.guess + (self._numbers() - s.base) @ self._inverse.T
        p[:, self._belief.lateness] = self._delay[:, np.newaxis]
        return np.hstack([self._lanes.numbers(slice(size(self._physics.State))).T, p])

    def _numbers(self) -> np.ndarray:
        """Return the constants of the true arms and payloads (lanes, k), each row a vector a of `adaptive.belief`."""
        lanes, physics = self._lanes, self._physics
        if physics is two_joints():
            return np.array(lanes.numbers(columns(lanes.layout.Lane).arm)).T
        plant = self._nominal
        if lanes.randomisation.varies:
            plant = physics.varied(plant, filled(draw_record(physics.joints), lanes.drawn))
        return np.stack(np.broadcast_arrays(*flat(plant), self._payload), axis=-1)

    def _force(self, ahead: int) -> np.ndarray:
        """Return the tip forces (lanes, axes) [N] `ahead` control periods from now.

        A time before the start or after the end of the episode counts as its start or end.
        """
        clock, lanes = self._lanes.clock, self._lanes
        rows = lanes.table[np.clip(clock[CLOCK.row] + ahead, clock[CLOCK.first], clock[CLOCK.last])]
        mean, change = np.split(rows[:, self._force_at], 2, axis=1)
        force: np.ndarray = lanes.numbers(columns(lanes.layout.Lane).force_factor).T * (mean - 0.5 * change)
        return force

    @functools.cached_property
    def _acting(self) -> Kernel:
        """The compiled law: from memory, observation, `beliefs` and known forces, it writes the torque to an array."""
        physics, settings, joints = self._physics, self._settings, self._physics.joints

        def act_on_truth(
            m: Memory, seen: Observation, truth: Any, known: Any, torque: Any, _: Any, *tables: Any
        ) -> tuple[Any, ...]:
            s = settings.with_tables(tables)
            room = Scratch(physics, s, known)
            take_in(m, room, seen)
            begin(m, s, room)
            act(truth, m, s, room, torque)
            return m, seen, truth, known, torque

        ports = (
            places(physics),
            seen_by(joints),
            Cells((len(settings.spread),)),
            Cells((KEPT + 1, physics.axes)),
            Cells((joints,)),
        )
        return Kernel(Program(act_on_truth, ports, (), [table.shape for table in settings.tables]))
