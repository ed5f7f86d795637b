"""The rollouts and proofs behind the numbers and the figures, and every measure computed from them.

The controllers are those of section 6.2 and two that explain why our numbers differ from the paper's.
"Printed form" is Theorem 1 or 2 with integral action, the paper's α and Q, one multiplier for all dropped premises of
A, the bound (24), and L = 0, the smallest L that the inequalities allow. "Consistent form" is the form of this project,
see `proof._theorems`.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.arithmetic import last_that_works
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.friction import DryFriction, stribeck_magnitude
from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES
from fuzzyarm.envs.scenario.disturbances import MachiningForce
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.rollout import Rollout, record_rollout
from fuzzyarm.fuzzy_policy import ts_model
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.printed_gains import with_printed_gains
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.policies import load_policy
from fuzzyarm.proof.certificate import certify
from fuzzyarm.proof.vertices import tracking_vertices
from fuzzyarm.synthesis.complexity import full_size, paper_formula
from fuzzyarm.synthesis.specification import PAPER_WEIGHT

__all__ = ["FORMS", "RULES", "SIDES", "TITLES", "Evidence", "gather"]


RULES = (32, 4)
"""Numbers of rules of the controllers that the paper compares."""
FORMS = ("printed", "consistent")
"""Forms of Theorem 2: as the paper prints it, and with a consistent feedforward."""
_CONTROLLERS = Path(__file__).with_name("controllers")
_SOURCES: Mapping[str, str | Path] = {
    "printed-32": _CONTROLLERS / "paper-32-integral.json",
    "printed-4": _CONTROLLERS / "paper-4-integral-common.json",
    "consistent-32": "fuzzy-32",
    "consistent-4": "fuzzy-4",
}
_SWAPPED, _PAPERS_OWN = "printed-4-swapped", "papers-gains"
"""Keys of two more controllers: the printed form with the feedforward of the consistent form, and the printed gains."""
TITLES: Mapping[str, str] = {
    **{f"{form}-{rules}": f"{form} form, {rules} rules" for form in FORMS for rules in RULES},
    _SWAPPED: "printed K and H, consistent L, 4 rules",
    _PAPERS_OWN: "the paper's own gains, 4 rules",
}
"""Titles of the controllers by their key: form and number of rules for the first four."""
SIDES = {"tip": "circularity_error", "motors": "circularity_error_motor"}
"""Circularity errors of a rollout by side: of the tip (links), and of the motors, as if the joints were rigid."""
_INSTANTS = 3001  # evenly spaced along the reference; one of them is the middle, where the reference is fastest


def _compared_policies() -> dict[str, FuzzyPolicy]:
    """Return the compared policies by their key in `TITLES`."""
    policies: dict[str, Any] = {key: load_policy(source) for key, source in _SOURCES.items()}
    printed, consistent = (policies[key].controller for key in ("printed-4", "consistent-4"))
    # Theorem 2 also proves this law, with P, Q and X of the printed form's file but a larger γ, see `smallest_gamma`.
    swapped = dataclasses.replace(printed, feedforward=consistent.feedforward_gains)
    policies |= {_SWAPPED: FuzzyPolicy(swapped), _PAPERS_OWN: FuzzyPolicy(with_printed_gains(printed))}
    for policy in policies.values():
        policy.integral_at = None  # the paper's law does not freeze the integral at the torque limits
    return policies


# Controller files that show Theorem 2 to be feasible with 4, 2 and 1 rules, with and without integral action, and with
# one multiplier for all dropped premises of A or one for each.
_WITNESSES = tuple(
    f"paper-{rules}{integral}{common}"
    for rules, integral, common in itertools.product((4, 2, 1), ("", "-integral"), ("", "-common"))
)
_HIGH_GAIN = "paper-4-common-high-gain"  # the controller file that was designed without the bound (24)
# Labels of `Evidence.gamma_with`, and the controllers whose L is used.
_OTHER_FEEDFORWARDS = {"the consistent form's L": _SWAPPED, "the paper's L_1k": _PAPERS_OWN}


@dataclasses.dataclass(frozen=True)
class Evidence:
    """The data behind the claims, and their measures: methods that return values by label.

    A label is the key of a controller in `TITLES` or a phrase; a measure of rollouts has a value for every
    controller. `smallest_gamma` maps two other controllers to the smallest γ, to 1 %, at which "printed-4" is proven
    with its own P, Q, X, τ and M and their feedforward gains L. With its own L it is proven at γ = 1000.
    """

    reference: JointReference  # the paper's motion
    controllers: Mapping[str, Controller]  # by key of `TITLES`
    rollouts: Mapping[tuple[str, str], Rollout]  # by key of the controller and case
    witnesses: Mapping[str, Controller]  # controllers of the paper's form by the name of their file
    proven: frozenset[str]  # witnesses whose inequalities have all been proven, in exact arithmetic, in this run
    smallest_gamma: Mapping[str, float]

    @property
    def _time(self) -> np.ndarray:
        return np.linspace(0.0, self.reference.duration, _INSTANTS)

    @property
    def _printed(self) -> dict[str, Controller]:
        """The controllers of the printed form by their key."""
        return {key: self.controllers[key] for key in (f"printed-{rules}" for rules in RULES)}

    # Measures of the reference and of the cases.

    def tip_speed(self) -> dict[str, float]:
        """Return {"reference": the largest speed |ṗ| [m/s] of the tip along the reference}."""
        velocity = self.reference.tip(self._time).velocity
        return {"reference": float(np.linalg.norm(velocity, axis=-1).max())}

    def rigid_torque(self) -> dict[str, float]:
        """Return the largest |Γ| [N m] of each joint on the reference by (4): rigid, with viscous and dry friction."""
        parameters, motion = self.reference.parameters, self.reference.sample(self._time)
        coulomb, static = np.array(parameters.coulomb_friction), np.array(parameters.static_friction)
        slip = stribeck_magnitude(motion.dq, DryFriction(coulomb, static, parameters.stribeck_velocity))
        torque = (
            rigid_inverse_dynamics(*motion, arm_constants(parameters)) + np.array(parameters.motor_inertia) * motion.ddq
        )
        torque += np.array(parameters.viscous_friction) * motion.dq + slip * np.sign(motion.dq)
        return {f"joint {number}": float(value) for number, value in enumerate(np.abs(torque).max(axis=0), start=1)}

    def force_range(self) -> dict[str, float]:
        """Return the "smallest" and "largest" machining force f_e [N] over the motion, at a tip speed of 1 m/s."""
        force, time = CASES["machining"].disturbance.tip_force or MachiningForce(), self._time
        size = np.linalg.norm(force.at(time, np.tile([1.0, 0.0], (len(time), 1))), axis=-1)
        return {"smallest": float(size.min()), "largest": float(size.max())}

    def payload(self, label: str) -> dict[str, float]:
        """Return the mass carried in Case 3, under one key.

        If `label` is "payload", the key is "payload" and the unit kg; otherwise "of m_2" and a percentage of m_2.
        """
        mass = CASES["payload"].disturbance.payload.mass
        share = 100.0 * mass / self.reference.parameters.mass[1]
        return {"payload": mass} if label == "payload" else {"of m_2": share}

    # Measures of the inequalities and of their solutions.

    def fewest_rules(self) -> dict[str, float]:
        """Return, under "fewest rules", the fewest rules with which Theorem 2 is proven (0: with none).

        The other entry is the number of controller files for which it is proven; its key says out of how many.
        """
        proven = [self.witnesses[name].model.rules for name in _WITNESSES if name in self.proven]
        return {"fewest rules": min(proven, default=0), f"proven of {len(_WITNESSES)} witnesses": len(proven)}

    def unbounded_gain(self) -> dict[str, float]:
        """Return, for "4 rules", the largest |entry| of K of the design without the bound (24); 0 if it is unproven."""
        proven = _HIGH_GAIN in self.proven
        return {"4 rules": _peak(self.witnesses[_HIGH_GAIN].gains[..., ts_model.PLANT]) if proven else 0.0}

    def bounded_M(self) -> dict[str, float]:
        """Return, by printed controller, the largest norm |M_ik|, M_ik = [K_ik H_ik] P11, the left side of (24)."""
        result = {}
        for key, controller in self._printed.items():
            gains = controller.gains
            products = gains @ controller.P[: gains.shape[-1], : gains.shape[-1]]
            result[key] = float(np.linalg.norm(products, ord=2, axis=(-2, -1)).max())
        return result

    def largest_gain(self, columns: str) -> dict[str, float]:
        """Return, by printed controller, the largest |entry| of [K H] in POSITION, VELOCITY or INTEGRAL `columns`."""
        return {key: _peak(one.gains[..., getattr(ts_model, columns)]) for key, one in self._printed.items()}

    def largest_feedforward_gain(self) -> dict[str, float]:
        """Return the largest |entry| of L under each of the keys "printed-32", "printed-4" and "printed-4-swapped"."""
        return {key: _peak(self.controllers[key].feedforward_gains) for key in (*self._printed, _SWAPPED)}

    def gamma_with(self) -> Mapping[str, float]:
        """Return the smallest γ [1] at which "printed-4" is proven with another feedforward gain L, by name of L."""
        return self.smallest_gamma

    def decay_rate(self) -> dict[str, float]:
        """Return α [1/s] of each loaded controller; it is proven, since `load_policy` refuses unproven controllers."""
        return {key: self.controllers[key].alpha for key in _SOURCES}

    def weight(self) -> dict[str, float]:
        """Return the diagonal of Q, the same for "printed-32" and "printed-4", by entry: Q11, Q22, ..."""
        first, second = (controller.weight for controller in self._printed.values())
        assert first is not None and second is not None and (first == second).all()
        return {f"Q{number}{number}": float(entry) for number, entry in enumerate(first, start=1)}

    def size(self, entry: str, of: str) -> dict[str, float]:
        """Return N_var or N_row, the field `entry` of `Size`, by number of rules: 32, 16, 8 and 4.

        `of`: "formula", of Remark 4, or "theorem", the printed Theorem 1 (32 rules) or 2, without integral action.
        """
        sizes = {}
        for rules in (32, 16, 8, 4):
            model = TSModel(self.reference.parameters, NAMED_RULES[rules])
            if of == "formula":
                size = paper_formula(len(model.A_vertices), len(model.E_vertices))
            else:
                size = full_size(tracking_vertices(model, False, np.array(PAPER_WEIGHT), common_multiplier=True))
            sizes[f"{rules} rules"] = getattr(size, entry)
        return sizes

    # Measures of the rollouts.

    def circularity(self, case: str, side: str, end: str) -> dict[str, float]:
        """Return the circularity error [mm] of each controller; `side` is "tip" or "motors".

        `end`: "inmost" (most negative), "outmost" (most positive) or "largest" (in size).
        """
        ends: Mapping[str, Any] = {"inmost": np.min, "outmost": np.max, "largest": _peak}
        return {key: float(ends[end](1e3 * getattr(self.rollouts[key, case], SIDES[side]))) for key in TITLES}

    def worst_case(self, side: str) -> dict[str, float]:
        """Return, by controller, the largest circularity error in Case 2 over that in Case 3; `side`: tip or motors."""
        second, third = (self.circularity(case, side, "largest") for case in ("machining", "payload"))
        return {key: second[key] / third[key] for key in TITLES}

    def rule_difference(self) -> dict[str, float]:
        """Return, by form and case, the largest gap [mm] over time in tip circularity error between 32 and 4 rules."""
        result = {}
        for form in FORMS:
            for number, case in enumerate(PAPER_CASES, start=1):
                many, few = (self.rollouts[f"{form}-{rules}", case].circularity_error for rules in RULES)
                n = min(len(many), len(few))
                result[f"{form} form, Case {number}"] = 1e3 * _peak(many[:n] - few[:n])
        return result

    def peak_torque(self, joint: str) -> dict[str, float]:
        """Return, by controller, the largest |Γ| [N m] of the joint "1" or "2" in Case 1."""
        return {key: _peak(self.rollouts[key, "nominal"].torque[:, int(joint) - 1]) for key in TITLES}

    def shortest_episode(self) -> dict[str, float]:
        """Return the duration [s] of each controller's shortest episode, cut short if the arm leaves the box (25)."""
        return {key: min(float(self.rollouts[key, case].time[-1]) for case in PAPER_CASES) for key in TITLES}

    def feedforward_at_rest(self) -> dict[str, float]:
        """Return, by controller, the torque L_hv r of joint 1 [N m] at t = 0, when the arm rests on the reference."""
        motion = self.reference.sample(0.0)
        at_rest = np.concatenate([motion.q, motion.dq, *motion])[np.newaxis]
        torques = {}
        for key, controller in self.controllers.items():
            policy, torque = FuzzyPolicy(controller), np.zeros((1, 2))
            policy.act(at_rest, np.zeros((1, policy.memory_size)), torque)
            torques[key] = float(torque[0, 0])
        return torques


def _peak(values: np.ndarray) -> float:
    return float(np.abs(values).max())


def gather(progress: Callable[[], None] = lambda: None) -> Evidence:
    """Run all controllers in the paper's cases and prove the `witnesses`; call `progress` after each run and proof."""
    policies, reference, rollouts = _compared_policies(), JointReference(), {}
    for case in PAPER_CASES:
        env = FuzzyArmEnv(case=case, reference=reference)
        for key, policy in policies.items():
            rollouts[key, case] = record_rollout(env, policy, policy_name=key, case=case, seed=0)
            progress()
    witnesses, proven = _prove_witnesses(progress)
    controllers = {key: policy.controller for key, policy in policies.items()}
    gammas = {
        label: _smallest_gamma(dataclasses.replace(controllers["printed-4"], feedforward=controllers[key].feedforward))
        for label, key in _OTHER_FEEDFORWARDS.items()
    }
    return Evidence(reference, controllers, rollouts, witnesses, proven, gammas)


def _prove_witnesses(progress: Callable[[], None]) -> tuple[dict[str, Controller], frozenset[str]]:
    """Return the controllers of the files `_WITNESSES` and `_HIGH_GAIN` by name, and the names of the proven ones."""
    witnesses, proven = {}, set()
    for name in (*_WITNESSES, _HIGH_GAIN):
        witnesses[name] = Controller.load(_CONTROLLERS / f"{name}.json")
        if certify(witnesses[name]).proven:
            proven.add(name)
        progress()
    return witnesses, frozenset(proven)


def _smallest_gamma(controller: Controller) -> float:
    """Return the smallest γ in [1e2, 1e5] at which a controller is proven, to 1 %; infinite if there is none."""

    def proven(gamma: float) -> bool:
        return certify(dataclasses.replace(controller, gamma=gamma)).proven

    if not proven(1e5):
        return math.inf
    found = last_that_works(proven, good=1e5, bad=1e2, resolution=0.01)
    assert found is not None  # without a limit there always is one
    return found
