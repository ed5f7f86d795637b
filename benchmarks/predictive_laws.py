"""The model-predictive laws of `predictive.py`: the program of `predictive_plan` on the estimates of two observers."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from predictive_plan import ARM, HORIZON, LIMIT, PERIOD, STATES, SUBSTEPS, Model, Optimum, plan_of

from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.physics.dynamics import Arm
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.records import in_columns, reader
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.laws.adaptive.law import steps_of
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, KEPT, Memory, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.adaptive.regulator import gain_share
from fuzzyarm.fuzzy_policy.laws.adaptive.room import Room, room_for
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.gain_schedule import place_in_schedule
from fuzzyarm.fuzzy_policy.laws.observer_gains import estimate_parts, state_part
from fuzzyarm.fuzzy_policy.laws.observer_steps import begin_of, correct_of, predict_of

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
        physics, self._arm = equations_of(ARM), model.arm
        self._begin, self._correct, self._predict = begin_of(physics), correct_of(JOINTS), predict_of(physics)
        self._per_joint = reader(physics.PerJoint, in_columns)

    def predict(
        self, observation: np.ndarray, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Return torques (2,) [N m] and the next state: the sample's number and the prediction (1, 10)."""
        o = observed(np.asarray(observation, dtype=float)[np.newaxis])
        if state is None:
            k, predicted = 0, np.zeros((1, estimate_parts(JOINTS).load.stop))
            self._begin(0, o.q_motor, o.dq_motor, predicted, np.array(ARM.stiffness), self._arm)
        else:
            k, predicted = state[0], state[1].copy()
        schedule = self._observer._schedule
        index, weight = np.empty(2, dtype=np.int64), np.empty(2)
        place_in_schedule(o.q_motor[0], schedule.kept, schedule.cosine, schedule.points, index, weight)
        self._correct(0, o, predicted, self._observer.observer, index, weight, np.empty(2 * JOINTS))
        load = predicted[0, estimate_parts(JOINTS).load]
        error = predicted[0, state_part(JOINTS)] - self.plan.x[k]
        error[:JOINTS] += load / np.array(ARM.stiffness)
        torque = np.clip(self.plan.u[k] - load + self.optimum(self.plan, k, error, -load), -LIMIT, LIMIT)
        physics_torque, physics_load = self._per_joint(torque[np.newaxis], 0), self._per_joint(load[np.newaxis], 0)
        self._predict(predicted, 0, physics_torque, physics_load, self._arm, PERIOD / SUBSTEPS, SUBSTEPS)
        return torque, (min(k + 1, self._steps), predicted)


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
        self._memory, self._room = np.zeros(policy.memory.noise.stop), room_for(policy.settings)
        self._parts = remembered(self._memory, JOINTS, len(policy.settings.guess), len(policy.settings.reopening))
        self._belief = {name: slice(STATES + at.start, STATES + at.stop) for name, at in belief._asdict().items()}
        self._k, self._torque, self._planned_at, self._payload = 0, np.zeros(JOINTS), 0, np.inf

    def predict(
        self, observation: np.ndarray, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Return torques (2,) [N m] and no state: what is remembered stays here.

        Raises:
            SystemExit: the filter has diverged.
        """
        seen, law = np.asarray(observation, dtype=float)[np.newaxis], np.empty(JOINTS)
        known = np.zeros((KEPT + 1, len(self._settings.reopening) - 1))
        _sample()(seen, self._parts, self._torque, known, self._settings, self._room, law)
        if not np.isfinite(law).all():
            raise SystemExit(f"the filter has diverged at sample {self._k}")
        z = self._room.acted
        self._plan_anew_if_needed(z)
        late = float(z[self._belief["lateness"]][0])
        now, rest = self._k - self._planned_at + int(late), late % 1.0
        change = self._room.link_torque[0] - self.plan.torque[self._k - self._planned_at]
        shift = change - z[self._belief["offset"]] + rest * (self.plan.u[now + 1] - self.plan.u[now])
        error = self._room.one[0][:, 0] - ((1.0 - rest) * self.plan.x[now] + rest * self.plan.x[now + 1])
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
        self._planned_at, self._payload, self._arm = self._k, payload, Arm(*self._room.numbers)
        t = PERIOD * (self._k + np.arange(HORIZON + 2 * KEEP_PLAN))
        model, weights = Model(self._arm, float(forces[0]), forces[1:].copy()), self._weights
        self.plan = plan_of(self._reference, t, model, weights.link_angle, weights.link_velocity)


@functools.cache
def _sample() -> Callable[..., None]:
    """Return the compiled ``sample(observation, m, commanded, known, s, room, torque)``: one sample of the filter.

    From the second sample on it first predicts, with what was commanded at the last one. It fills `torque` (2,) [N m]
    with what `adaptive-observer` would command, and `room` with what it acts on.
    """
    correct, act, predict = steps_of(equations_of(ARM))

    @njit(error_model="numpy")
    def sample(
        observation: np.ndarray,
        m: Memory,
        commanded: np.ndarray,
        known: np.ndarray,
        s: Settings,
        room: Room,
        torque: np.ndarray,
    ) -> None:
        if m.flags[FLAG.samples] > 0.0:
            m.commands[0] = commanded
            predict(m, s, room, commanded)
        correct(0, observed(observation), m, s, room)
        act(room.acted, m, s, room, known, torque)

    return sample
