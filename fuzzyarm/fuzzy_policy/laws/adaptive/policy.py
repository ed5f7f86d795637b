"""The adaptive observer: it estimates arm, load and delay while the arm moves, and acts on the estimate.

    correct   z = (x, p) by the measured motors, see `filter`; p is load, constants and delay, see `belief`,
    act       u = u_ff(p) - K (x⁺ - x_d(p)⁺),
    predict   z⁻ of the next sample: x advanced by the elastic arm with parameters p under the clipped commands.

x_d = (θ_d, q_d, θ̇_d, q̇_d) and u_ff are those of `elastic_target` for the arm and the load of p: the torque that bends
the joints is τ = M q̈_d + C q̇_d + g - Jᵀ F, at the last samples of the reference with the current p. The ⁺ marks values
d control periods ahead, when the command reaches the motors: x is advanced by the pending commands, x_d by its
derivatives. K is a linear quadratic regulator, scheduled over posture and payload, see `regulator`.

If the filter diverges or the commands oscillate (`AdaptiveWeights.largest_swing`), `Beliefs.diverged` is set, and
`Policy.act` uses the law `fallback` from then on.
"""

import dataclasses
import functools
from typing import Any

import numpy as np

from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.known_arm import travel_of
from fuzzyarm.fuzzy_policy.law import Law, LawPolicy, law_of, seen_by, within_limits
from fuzzyarm.fuzzy_policy.laws.adaptive._frozen import FrozenObserver
from fuzzyarm.fuzzy_policy.laws.adaptive._passes import AdaptivePasses
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FACTORS, FLAG, KEPT, AdaptiveWeights, belief_of, layout, places
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Scratch, Settings, correct, predict
from fuzzyarm.fuzzy_policy.laws.adaptive.regulator import act, adaptive_weights_for, feedback_table
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.functions import Cells, array, when
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

__all__ = ["AdaptiveObserverPolicy", "Beliefs"]


@dataclasses.dataclass(frozen=True)
class Beliefs:
    """Estimates of the adaptive observer for n joints, each with its own standard deviation.

    The filter divides a load between masses and forces: a payload may appear as a force, or the reverse.
    """

    force: np.ndarray  # at the tip [N], (..., axes)
    force_deviation: np.ndarray
    payload: np.ndarray  # at the tip [kg], (...)
    payload_deviation: np.ndarray
    factors: dict[str, np.ndarray]  # factors on the known arm's constants, by the names `belief.FACTORS`, (..., n)
    factors_deviation: dict[str, np.ndarray]
    offset: np.ndarray  # torques added to the motors' torques [N m], (..., n)
    offset_deviation: np.ndarray
    lateness: np.ndarray  # delay from a command to the motors [s], (...)
    lateness_deviation: np.ndarray
    encoder_noise: np.ndarray  # estimated standard deviation of the noise of the angles [rad], (..., n)
    # Mean squared innovation relative to the variance that the filter expects, (...); far above 1 the filter is wrong.
    surprise: np.ndarray
    diverged: np.ndarray  # whether the filter has diverged, or the commands swing, and the fallback acts, (...)
    # For each part of p, see `belief`, whether an estimate is at an end of its range, (...); an estimate of no delay,
    # no dry friction or no damping does not count.
    at_end: dict[str, np.ndarray]
    other_path: np.ndarray  # whether this pass has left the previous pass's path, see `passes`, (...)


class AdaptiveObserverPolicy(LawPolicy):
    """The adaptive observer, with regulator and elastic target; the law is in the module's docstring.

    `belief` has the slice of each part of the parameters p, `memory` that of each part of the filter's memory.
    """

    def __init__(
        self,
        parameters: AnyArm | None = None,
        control_period: float = 1e-3,
        weights: AdaptiveWeights | None = None,
        fallback: Policy | None = None,
    ) -> None:
        """Design the regulator for a control period [s] and the arm as the controller knows it (default Table 1).

        `fallback` acts once the filter has diverged, by default computed torque at the tip. Default weights are those
        of `adaptive_weights_for`. ValueError if the control period is out of range, or no gains exist.
        """
        super().__init__(ArmParameters() if parameters is None else parameters, control_period)
        self.arm, physics = self.parameters, equations_of(self.parameters)
        self.belief, self.memory = belief_of(physics), layout(physics)
        self.weights = weights or adaptive_weights_for(self.arm, self.control_period)
        self.fallback = fallback or TipPolicy(ComputedTorquePolicy(self.parameters, control_period))
        self.memory_size = self.memory.noise.stop + self.fallback.memory_size
        feedback = feedback_table(self.arm, self.control_period, self.weights)
        self.settings = Settings(self.arm, self.control_period, self.weights, feedback)

    def act_with(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray, known: np.ndarray) -> None:
        """Evaluate the law like `act`, filling `torque`, for a tip force that is known in part.

        `known` (lanes, `KEPT` + 1, axes) [N] is this part, see `Scratch`.
        """
        tables = self.control_law.tables
        self._beside((memory, observation, known.reshape(len(known), -1), torque), self._constants, tables)

    @functools.cached_property
    def control_law(self) -> Law:
        """The law; its memory is a `Memory`, then the memory of `fallback`."""
        behind = self._behind
        given = behind.constants, tuple(map(float, self.fallback.torque_limit))
        held = places(equations_of(self.arm)), behind.memory
        return Law(self._answer_of(), held, given, (*self.settings.tables, *behind.tables), told=True)

    @functools.cached_property
    def _beside(self) -> Kernel:
        answer, law = self._answer_of(), self.control_law

        def beside(memory: Any, seen: Observation, known: Any, _: Any, given: Any, *tables: Any) -> tuple[Any, ...]:
            after, torque = answer(memory, seen, given, *tables, known=known)
            return after, seen, known, torque

        force = Cells((KEPT + 1, equations_of(self.arm).axes))
        ports = law.memory, seen_by(self.joints), force, (0.0,) * self.joints
        return Kernel(Program(beside, ports, law.constants, [table.shape for table in law.tables]))

    def _answer_of(self) -> Any:
        """Return the law as ``answer(memory, seen, given, *tables, known, admit)``.

        `known` is that of `Scratch`; `admit` turns requested into applied torques; the others are those of `Law.act`.
        """
        physics, settings, own = equations_of(self.arm), self.settings, len(self.settings.tables)
        fall_back = within_limits(self._behind, self.joints, self.fallback.integral_at)

        def answer(
            memory: Any, seen: Observation, given: Any, *tables: Any, known: Any = None, admit: Any = None
        ) -> tuple[Any, Any]:
            (m, behind), s = memory, settings.with_tables(tables[:own])
            room, torque = Scratch(physics, s, known), array(physics.joints)
            correct(m, s, room, seen)
            act(room.acted, m, s, room, torque)
            for j, applied in enumerate(() if admit is None else admit([torque[j] for j in range(physics.joints)])):
                m.commands[0, j] = applied
            predict(m, s, room, torque)
            found = behind, physics.PerJoint(*(torque[j] for j in range(physics.joints)))
            lost = m.flags[FLAG.lost] == 1.0
            behind, found = when(lost, lambda: fall_back(memory[1], seen, given, *tables[own:]), found)
            return (m, behind), found

        return answer

    @functools.cached_property
    def _behind(self) -> Law:
        """The law of `fallback`."""
        found = law_of(self.fallback)
        if found is None:
            raise ValueError(
                "fallback must be a policy whose control law is defined as a `Law`, such as one from "
                f"`fuzzyarm.fuzzy_policy.laws`; {type(self.fallback).__name__} does not define one"
            )
        return found

    def repeated(self) -> AdaptivePasses:
        """Return this policy for repeated passes over one path."""
        return AdaptivePasses(self)

    def without_dry_friction(self) -> FrozenObserver:
        """Return this policy with its adaptation frozen, for the same arm without dry friction."""
        return FrozenObserver(self)

    def beliefs(self, state: np.ndarray) -> Beliefs:
        """Return the `Beliefs` at the next sample, from a state (..., memory_size) returned by `predict`."""
        return self.beliefs_of(self.checked_state(state)[..., : self.memory.noise.stop])

    def beliefs_of(self, own: np.ndarray) -> Beliefs:
        """Return the `Beliefs` at the next sample, from the filter's part `own` (..., size) of a state."""
        part, belief, states = self.memory, self.belief, 4 * self.joints
        forces = belief.force.stop
        shape, size = own.shape[:-1], part.z.stop - part.z.start
        p, P = own[..., part.z][..., states:], own[..., part.P].reshape(*shape, size, size)
        covariance = P[..., states:, states:]
        deviation = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0))
        # The tip force is H (f_t, F), with the direction of travel and the unit vectors as the columns of H.
        reference = own[..., part.references].reshape(*shape, -1, 3, self.joints)[..., 0, :, :]
        travel = travel_of(self.arm, reference[..., 0, :], reference[..., 1, :])
        unit = np.broadcast_to(np.eye(forces - 1), (*shape, forces - 1, forces - 1))
        low, high = self.settings.low, self.settings.high
        ends = (p >= high) | ((p <= low) & (low != 0.0))
        H = np.concatenate([travel[..., np.newaxis], unit], axis=-1)
        force_covariance = H @ covariance[..., :forces, :forces] @ np.swapaxes(H, -1, -2)
        return Beliefs(
            force=(H @ p[..., :forces, np.newaxis])[..., 0],
            force_deviation=np.sqrt(np.maximum(np.diagonal(force_covariance, axis1=-2, axis2=-1), 0.0)),
            payload=p[..., belief.payload][..., 0],
            payload_deviation=deviation[..., belief.payload][..., 0],
            factors={name: p[..., getattr(belief, name)] for name in FACTORS},
            factors_deviation={name: deviation[..., getattr(belief, name)] for name in FACTORS},
            offset=p[..., belief.offset],
            offset_deviation=deviation[..., belief.offset],
            lateness=self.control_period * p[..., belief.lateness][..., 0],
            lateness_deviation=self.control_period * deviation[..., belief.lateness][..., 0],
            encoder_noise=np.sqrt(own[..., part.noise]),
            surprise=own[..., FLAG.surprise],
            diverged=own[..., FLAG.lost] != 0.0,
            at_end={name: ends[..., part].any(axis=-1) for name, part in belief._asdict().items()},
            other_path=np.zeros(shape, dtype=np.bool_),
        )
