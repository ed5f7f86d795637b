"""The model-predictive laws of `predictive.py`: the program of `predictive_plan` on the estimates of two observers."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from predictive_plan import ARM, HORIZON, LIMIT, PERIOD, STATES, Model, Optimum, plan_of

from fuzzyarm.envs.observation import JOINTS, PARTS
from fuzzyarm.envs.physics.dynamics import Arm
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.records import PerJoint, filled, flat
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.law import seen_by
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, KEPT, places, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Room, correct, predict, tables_of, with_tables
from fuzzyarm.fuzzy_policy.laws.adaptive.law import act, gain_share
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.elastic_observer import steps_of as observer_steps_of
from fuzzyarm.numbers.functions import Cells, each, only
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

__all__ = ["OnAdaptiveEstimate", "OnElasticEstimate"]

KEEP_PLAN = 10  # samples
STARTING = KEPT  # samples; as long as the differences of `adaptive-observer` reach back before the first one
LARGEST_CHANGE = 0.05  # of the believed payload, for which a plan is kept [kg]


class OnElasticEstimate:
    """u = u_ff - d̂ + w on the estimate (x̂, d̂) and with the weights of ``elastic-observer``; one plan for the path.

    Attributes:
        optimum: what gives w.
    """

    def __init__(self, reference: JointReference, limits: bool, payload: float = 0.0) -> None:
        """Plan the whole reference for Table 1 with a payload [kg] that is told."""
        self.optimum, self._observer, model = Optimum(limits), ElasticObserverPolicy(ARM, PERIOD), Model.of(payload)
        self._steps, weights = round(reference.duration / PERIOD), self._observer.weights
        t = PERIOD * np.arange(self._steps + HORIZON + 2)
        self.plan = plan_of(reference, t, model, weights.link_angle, weights.link_velocity)
        observer, schedule = self._observer, self._observer._schedule
        kept = tuple(schedule.kept.tolist())
        self._correct, _, self._predict = observer_steps_of(equations_of(ARM), kept, schedule.cosine, schedule.points)
        constants = observer.control_law.constants
        self._constants = constants._replace(target=constants.target._replace(arm=model.arm))
        self._gains = observer.control_law.tables[1]

    def predict(
        self, observation: np.ndarray, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Return torques (2,) [N m] and the next state: the sample's number and what the observer remembers."""
        parts = np.asarray(observation, dtype=float).reshape(PARTS, JOINTS).tolist()
        seen = type(seen_by(JOINTS))(*(PerJoint(*part) for part in parts))
        k, memory = (0, self._observer.control_law.memory) if state is None else state
        found = self._correct(memory, seen, self._constants, self._gains)
        load = np.array(found.x.load)
        error = np.array(flat(found.x[:4])) - self.plan.x[k]
        error[:JOINTS] += load / np.array(ARM.stiffness)
        torque = np.clip(self.plan.u[k] - load + self.optimum(self.plan, k, error, -load), -LIMIT, LIMIT)
        predicted = self._predict(found.x, tuple(torque.tolist()), self._constants)
        return torque, (min(k + 1, self._steps), memory._replace(past=found.past, started=1.0, predicted=predicted))


class OnAdaptiveEstimate:
    """u = u_ff + Δτ_d - ŵ + s w on the estimate and with the weights of ``adaptive-observer``, for one episode.

    A plan is made for the arm, payload and forces on which that law acts, every `KEEP_PLAN` samples and whenever the
    payload has changed by `LARGEST_CHANGE`. Δτ_d is what has changed of τ_d since, which also bends the target by
    Δτ_d/K_t; ŵ is the estimated torque beside the motors', s the share of the gain at the soft start. The state is that
    at which the command arrives, and the filter predicts with the torque that is commanded. What is commanded in the
    first `STARTING` samples is what the filter learns from first; they are those of `adaptive-observer`, so that the
    estimates compare.

    Attributes:
        optimum: what gives w.
    """

    def __init__(self, reference: JointReference, limits: bool, own_start: bool = False) -> None:
        """Begin an episode; with `own_start` it commands its own torques from the first sample on."""
        self.optimum, self._reference = Optimum(limits), reference
        self._starting = 0 if own_start else STARTING
        policy = AdaptiveObserverPolicy(ARM, PERIOD)
        self._settings, self._weights, belief = policy.settings, policy.weights, policy.belief
        self._memory, self._found = np.zeros((1, policy.memory.noise.stop)), np.empty((1, _found().size))
        self._parts = remembered(self._memory[0], equations_of(ARM))
        self._tables = tables_of(policy.settings)
        self._belief = {name: slice(STATES + at.start, STATES + at.stop) for name, at in belief._asdict().items()}
        self._k, self._torque, self._planned_at, self._payload = 0, np.zeros(JOINTS), 0, np.inf

    def predict(
        self, observation: np.ndarray, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Return torques (2,) [N m] and no state: what is remembered stays here.

        Raises:
            SystemExit: the filter has diverged.
        """
        seen = np.array(observation, dtype=float)[np.newaxis]
        _sample()((self._memory, seen, self._torque[np.newaxis].copy(), self._found), np.empty(0), self._tables)
        self._room = room = _found().of(self._found[0])
        law = room.torque
        if not np.isfinite(law).all():
            raise SystemExit(f"the filter has diverged at sample {self._k}")
        z = room.acted
        self._plan_anew_if_needed(z)
        late = float(z[self._belief["lateness"]][0])
        now, rest = self._k - self._planned_at + int(late), late % 1.0
        change = room.link_torque[0] - self.plan.torque[self._k - self._planned_at]
        shift = change - z[self._belief["offset"]] + rest * (self.plan.u[now + 1] - self.plan.u[now])
        error = room.state - ((1.0 - rest) * self.plan.x[now] + rest * self.plan.x[now + 1])
        arm = self._arm
        error[:JOINTS] -= change / np.array([arm.stiffness1, arm.stiffness2])
        share = gain_share(self._parts, self._settings)
        if self._k >= self._starting:
            law = self.plan.u[now] + shift + share * self.optimum(self.plan, now, error, shift)
        self._torque, self._k = np.clip(law, -LIMIT, LIMIT), self._k + 1
        return self._torque, None

    def _plan_anew_if_needed(self, z: np.ndarray) -> None:
        payload, forces = float(z[self._belief["payload"]][0]), z[STATES : STATES + len(self._settings.reopening)]
        if self._k - self._planned_at < KEEP_PLAN and abs(payload - self._payload) <= LARGEST_CHANGE:
            return
        self._planned_at, self._payload, self._arm = self._k, payload, filled(Arm, self._room.numbers)
        t = PERIOD * (self._k + np.arange(HORIZON + 2 * KEEP_PLAN))
        model, weights = Model(self._arm, float(forces[0]), forces[1:].copy()), self._weights
        self.plan = plan_of(self._reference, t, model, weights.link_angle, weights.link_velocity)


class Found(NamedTuple):
    """What a sample leaves: z on which the law acts, τ_d, x when the command acts, the arm's numbers, and u_a."""

    acted: Any
    link_torque: Any
    state: Any
    numbers: Any
    torque: Any


class _found:
    """The places of `Found` in a row of numbers."""

    def __init__(self) -> None:
        policy = _policy()
        size, numbers = len(policy.settings.spread), len(policy.settings.base)
        self.cells = Found(*map(Cells, ((size,), (KEPT, JOINTS), (STATES,), (numbers,), (JOINTS,))))
        self.size = sum(cell.size for cell in self.cells)

    def of(self, row: np.ndarray) -> Found:
        """Return the parts of a row."""
        ends = np.cumsum([cell.size for cell in self.cells])[:-1]
        return Found(*(part.reshape(cell.shape) for part, cell in zip(np.split(row, ends), self.cells, strict=True)))


@functools.cache
def _policy() -> AdaptiveObserverPolicy:
    return AdaptiveObserverPolicy(ARM, PERIOD)


@functools.cache
def _sample() -> Kernel:
    """Return the kernel of one sample of the filter, on memory, observation, commanded torques and `Found`.

    From the second sample on it first predicts, with what was commanded at the last one.
    """
    policy, cells, physics = _policy(), _found().cells, equations_of(ARM)

    def sample(m: Any, seen: Any, commanded: Any, found: Found, _: Any, *tables: Any) -> tuple[Any, ...]:
        s = with_tables(policy.settings, tables)
        room = Room(physics, s)
        for _ in only(m.flags[FLAG.samples] > 0.0):
            for j in range(JOINTS):
                m.commands[0, j] = commanded[j]
            predict(m, s, room, commanded)
        correct(m, s, room, seen)
        act(room.acted, m, s, room, found.torque)
        for part, held in (
            (found.acted, room.acted), (found.state, room.one.state[:, 0]), (found.numbers, room.numbers),
        ):  # fmt: skip
            for i in each(len(part)):
                part[i] = held[i]
        for k in each(KEPT):
            for j in each(JOINTS):
                found.link_torque[k, j] = room.link_torque[k, j]
        return m, seen, commanded, found

    ports = places(physics), seen_by(JOINTS), (0.0,) * JOINTS, cells
    return Kernel(Program(sample, ports, (), [table.shape for table in tables_of(policy.settings)]))
