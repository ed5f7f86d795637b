"""The elastic observer on balls; see `fuzzy_policy.laws.elastic_observer` for its law and `predictor` for what follows.

    ν = y - C x⁻,    x = x⁻ + L(θ_2) ν,    ε = x - x_d(d̂),    u = u_ff - d̂ - K(θ_2) ε,    x⁻ of the next sample.

It remembers (x̂, d̂)⁻, ten numbers. L and K are linear between the points of a table over cos θ_2 of the measured θ_2:
continuous, with a slope on each part, and on a box with any of the slopes of the parts that it meets.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from flint import arb

from fuzzyarm.envs.observation import JOINTS, REFERENCE, SIZE
from fuzzyarm.envs.physics.dynamics import Arm, gravity_torque
from fuzzyarm.envs.physics.records import filled
from fuzzyarm.eval.certified.tip.enclosures import Jet, ball, low_high
from fuzzyarm.eval.certified.tip.forms import Forms
from fuzzyarm.eval.certified.tip.predictor import ROUNDED, Predictor
from fuzzyarm.eval.certified.tip.response import LAW_ROUNDING, MEASURED, Response, smooth_part
from fuzzyarm.eval.certified.tip.zonotope import Zonotope
from fuzzyarm.fuzzy_policy.known_arm import constants_of
from fuzzyarm.fuzzy_policy.laws.elastic_observer import STATICS_STEPS, ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.elastic_target import target_parts
from fuzzyarm.fuzzy_policy.laws.observer_gains import estimate_parts, state_part

__all__ = ["ObserverLaw"]

PART, STATE = estimate_parts(JOINTS), state_part(JOINTS)
ESTIMATES = PART.load.stop
SECOND = 1  # place of θ_2 among what is measured


class ObserverLaw:
    """The law of an elastic observer, sample by sample.

    Attributes:
        memory: 10, the prediction (x̂, d̂)⁻.
    """

    memory = ESTIMATES

    def __init__(self, policy: ElasticObserverPolicy, references: np.ndarray) -> None:
        """Take the policy for the two-joint arm, and what it is told at each sample (samples, 6)."""
        arm = policy.parameters
        self._arm = filled(Arm, map(float, constants_of(arm)))
        self._predictor = Predictor(self._arm, policy.control_period / policy._substeps, policy._substeps)
        self._tables = policy.feedback, policy.observer
        self._stiffness = [self._arm.stiffness1, self._arm.stiffness2]
        self._wanted, self._feedforward = _told(policy, references)

    def respond(self, k: int, point: np.ndarray, seen: Zonotope) -> Response:
        """Return the answer at the k-th sample, see `SampledLaw`."""
        forms = Forms(point, seen)
        if k == 0:
            self._begin(forms)
        self._correct(forms)
        self._act(forms, self._wanted[k], self._feedforward[k])
        self._predictor.advance(forms)
        torque = range(ESTIMATES, ESTIMATES + JOINTS)
        forms.keep([*torque, *range(ESTIMATES)])
        return Response(forms.middle, forms.spelt_out(), np.zeros(len(forms.middle)))

    def _begin(self, forms: Forms) -> None:
        """Put the first estimate in place of the memory: K (θ - q) = g(q), links as fast as motors, d = 0."""
        spread = forms.spread(np.eye(len(forms.middle)))[:JOINTS]
        at, tube = (self._statics(forms.middle[:JOINTS].tolist(), radii) for radii in ([0.0, 0.0], spread.tolist()))
        middle, gain, rest = smooth_part(
            [q.value for q in at], [[q.slope(i) for i in range(JOINTS)] for q in tube], spread
        )
        rows, start = np.zeros((ESTIMATES, len(forms.middle))), np.zeros(ESTIMATES)
        for angle, part in ((0, PART.q_motor), (JOINTS, PART.dq_motor), (JOINTS, PART.dq_link)):
            rows[part, angle : angle + JOINTS] = np.eye(JOINTS)
            start[part] = forms.middle[angle : angle + JOINTS]
        rows[PART.q_link, :JOINTS], start[PART.q_link] = gain, middle
        lost = np.zeros(ESTIMATES)
        lost[PART.q_link] = rest + ROUNDED * (1.0 + np.abs(middle))
        forms.extend(rows, [arb(x) for x in start.tolist()], lost)
        forms.keep([*range(MEASURED), *range(MEASURED + ESTIMATES, MEASURED + 2 * ESTIMATES)])

    def _statics(self, theta: list[float], radii: list[float]) -> list[Jet]:
        """Return q with K (θ - q) = g(q), as the policy iterates it, for θ in a box."""
        motor = [Jet.variable(ball(x, r), i) for i, (x, r) in enumerate(zip(theta, radii, strict=True))]
        link = motor
        for _ in range(STATICS_STEPS):
            weight = gravity_torque(link[0].sin(), (link[0] + link[1]).sin(), self._arm)
            link = [m - w * (1 / arb(k)) for m, w, k in zip(motor, weight, self._stiffness, strict=True)]
        return link

    def _correct(self, forms: Forms) -> None:
        """Put θ_2 and (x̂, d̂) in place of what is measured and predicted."""
        total = MEASURED + ESTIMATES
        rows = np.zeros((MEASURED, total))
        rows[:, :MEASURED] = np.eye(MEASURED)
        for at, part in ((0, PART.q_motor), (JOINTS, PART.dq_motor)):
            rows[at : at + JOINTS, MEASURED + part.start : MEASURED + part.stop] = -np.eye(JOINTS)
        seen, x = forms.balls(slice(0, MEASURED)), forms.balls(slice(MEASURED, total))
        missing = [a - b for a, b in zip(seen, [*x[PART.q_motor], *x[PART.dq_motor]], strict=True)]
        forms.extend(rows, missing, ROUNDED * (np.abs(rows) @ forms.largest()))
        innovation = slice(total, total + MEASURED)
        size = np.abs(self._tables[1]).max(axis=0) @ forms.largest()[innovation]
        shift, gain, rest = _scheduled(self._tables[1], forms, SECOND, innovation)
        rows = np.zeros((1 + ESTIMATES, total + MEASURED))
        rows[0, SECOND] = 1.0
        rows[1:, MEASURED:total] = np.eye(ESTIMATES)
        rows[1:] += gain
        estimates = [a + b for a, b in zip(x, shift.tolist(), strict=True)]
        lost = rest + ROUNDED * (forms.largest()[MEASURED:total] + np.abs(shift)) + LAW_ROUNDING * size
        forms.extend(rows, [seen[SECOND], *estimates], np.concatenate([[0.0], lost]))
        forms.keep(slice(total + MEASURED, None))

    def _act(self, forms: Forms, wanted: np.ndarray, feedforward: np.ndarray) -> None:
        """Append u after (x̂, d̂), and forget θ_2."""
        total, size = 1 + ESTIMATES, STATE.stop
        rows = np.zeros((size, total))
        rows[:, 1 : 1 + size] = np.eye(size)
        rows[:JOINTS, 1 + PART.load.start :] = np.diag([1.0 / k for k in self._stiffness])
        x = forms.balls(slice(1, None))
        error = [x[i] - float(wanted[i]) for i in range(size)]
        for j in range(JOINTS):
            error[j] += x[PART.load.start + j] / self._stiffness[j]
        forms.extend(rows, error, ROUNDED * (np.abs(rows) @ forms.largest() + np.abs(wanted)))
        errors = slice(total, total + size)
        shift, gain, rest = _scheduled(self._tables[0], forms, 0, errors)
        rows = -gain
        rows[:, 1 + PART.load.start : total] -= np.eye(JOINTS)
        load, given = x[PART.load.start :], [*zip(feedforward.tolist(), shift.tolist(), strict=True)]
        torque = [f - d - s for d, (f, s) in zip(load, given, strict=True)]
        most = np.abs(self._tables[0]).max(axis=0) @ forms.largest()[errors]
        rest += LAW_ROUNDING * (most + np.abs(feedforward) + forms.largest()[1 + PART.load.start : total])
        forms.extend(rows, torque, rest)
        forms.keep([*range(1, total), *range(total + size, total + size + JOINTS)])


def _scheduled(table: np.ndarray, forms: Forms, second: int, of: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the middle, rows and rest of G(θ_2) x, for the table of G, the place of θ_2 and that of the numbers x.

    G x - G_c x_c = G_c δx + G'(ξ) x δθ_2 at some ξ between θ_2 and its middle.
    """
    n = len(forms.middle)
    spread = forms.spread(np.eye(n)[[second, *range(of.start, of.stop)]])
    angle, x = forms.middle[second].item(), forms.middle[of]
    value, _ = _interpolated(table, ball(angle))
    _, slope = _interpolated(table, ball(angle, float(spread[0])))
    here = [arb(v) for v in x.tolist()]
    around = [v + ball(0.0, r) for v, r in zip(here, spread[1:].tolist(), strict=True)]
    at = [_dot(row, here) for row in value]
    slopes = [[_dot(s, around), *row] for s, row in zip(slope, value, strict=True)]
    middle, gain, rest = smooth_part(at, slopes, spread)
    rows = np.zeros((len(at), n))
    rows[:, second], rows[:, of] = gain[:, 0], gain[:, 1:]
    return middle, rows, rest


def _dot(row: list[Any], column: list[Any]) -> Any:
    return sum((a * b for a, b in zip(row, column, strict=True)), arb(0))


def _interpolated(table: np.ndarray, angle: arb) -> tuple[list[list[Any]], list[list[Any]]]:
    """Return G, nested lists (rows, columns) of balls, at the angles [rad] of a ball, and ∂G/∂angle there."""
    points = len(table)
    place = (angle.cos() + 1) * (0.5 * (points - 1))
    low, high = low_high(place)
    parts = range(*(min(max(int(np.floor(x)), 0), points - 2) + i for i, x in ((0, low), (1, high))))
    turn = angle.sin() * (-0.5 * (points - 1))
    value, slope = _part(table, parts[0], place, turn)
    for left in parts[1:]:
        for joined, other in zip((value, slope), _part(table, left, place, turn), strict=True):
            for row, more in zip(joined, other, strict=True):
                row[:] = [a.union(b) for a, b in zip(row, more, strict=True)]
    return value, slope


def _part(table: np.ndarray, left: int, place: Any, turn: Any) -> tuple[list[list[Any]], list[list[Any]]]:
    """Return G and ∂G/∂angle by the line between two points."""
    share = place - left
    value, slope = [], []
    for first, second in zip(table[left].tolist(), table[left + 1].tolist(), strict=True):
        rises = [arb(b) - a for a, b in zip(first, second, strict=True)]
        value.append([share * rise + a for a, rise in zip(first, rises, strict=True)])
        slope.append([turn * rise for rise in rises])
    return value, slope


def _told(policy: ElasticObserverPolicy, references: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return x_d for d̂ = 0 (samples, 8) and u_ff (samples, 2), which depend on the reference alone."""
    target, memory = policy._target, np.zeros((1, policy._target.memory_size))
    observation, aim, feedforward = np.zeros((1, SIZE)), np.empty((1, target.size)), np.empty((1, JOINTS))
    theta, dtheta, _ = target_parts(JOINTS)
    wanted, torques = [], []
    for row in references:
        observation[:, REFERENCE] = row
        target.advance(observation, memory, aim, feedforward)
        wanted.append(np.concatenate([aim[0, theta], row[:JOINTS], aim[0, dtheta], row[JOINTS : 2 * JOINTS]]))
        torques.append(feedforward[0].copy())
    return np.array(wanted), np.array(torques)
