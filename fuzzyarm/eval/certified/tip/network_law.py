"""A learned policy on balls: tanh layers on features with a memory, with or without a certified law below them.

    b = clip(W_n h_n + b_n, ±1),   h_(i+1) = tanh(W_i h_i + b_i),   h_0 = clip((f - mean)/std, ±c),
    a⁺ = λ a + (1 - λ) b  at an action instant,   u = law(θ - scale a⁺, θ̇, x_I; r)   or   u = scale a⁺.

See `learned_policy.features`, `network` and `policy`. It remembers a, the past errors, actions and excess torques, the
leaky integral, and x_I of the law below. Features and layers are followed as numbers that are linear in the deviations,
with a new unknown for what each tanh, asinh or clip leaves (`bends`), so what they have in common is kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat

from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import JOINTS, Observation
from fuzzyarm.envs.physics.records import PerJoint
from fuzzyarm.eval.certified.tip.bends import ASINH, STRAIGHT, TANH, Clip, append_bent
from fuzzyarm.eval.certified.tip.enclosures import ball
from fuzzyarm.eval.certified.tip.forms import Forms
from fuzzyarm.eval.certified.tip.laws import asked, ball_law
from fuzzyarm.eval.certified.tip.response import LAW_ROUNDING, MEASURED, Response, smooth_part
from fuzzyarm.eval.certified.tip.zonotope import Zonotope
from fuzzyarm.learned_policy.features import Features
from fuzzyarm.learned_policy.network import Network
from fuzzyarm.learned_policy.policy import LearnedPolicy

__all__ = ["BallNetwork", "NetworkLaw"]

ROUNDED = 2.0**-46
"""Relative allowance for a few float operations, tanh and asinh among them."""


class _Memory(NamedTuple):
    """Where what is remembered lies after θ, θ̇."""

    action: slice
    errors: slice
    actions: slice
    integral: slice
    excesses: slice
    base: slice


class _Feature(NamedTuple):
    """f = g((constant + sign x)/scale), x the number of that place; g: asinh if `bent`, else the identity."""

    number: int | None
    sign: float
    constant: float
    scale: float
    bent: bool


class BallNetwork:
    """A network on balls."""

    def __init__(self, network: Network) -> None:
        """Take the network."""
        self._network = network
        self._layers = [
            (arb_mat(weight.astype(float).tolist()), arb_mat([[float(x)] for x in bias]))
            for weight, bias in zip(network.weights, network.biases, strict=True)
        ]

    def act(self, forms: Forms, features: np.ndarray, at: list[Any]) -> None:
        """Append b to the numbers of `forms`.

        Args:
            forms: see there; what the layers leave between is appended, too.
            features: f - f_c as rows (n, numbers) of the numbers' deviations.
            at: f_c, balls.
        """
        network = self._network
        scaled = features / network.std[:, np.newaxis]
        normal = [(f - m) / s for f, m, s in zip(at, network.mean.tolist(), network.std.tolist(), strict=True)]
        append_bent(forms, scaled, normal, [Clip(network.clip)] * len(normal))
        for number, (weight, bias) in enumerate(self._layers):
            width = weight.ncols()
            rows = np.zeros((weight.nrows(), len(forms.middle)))
            rows[:, -width:] = network.weights[number]
            before = (
                weight * arb_mat([[h] for h in forms.balls(slice(len(forms.middle) - width, None))]) + bias
            ).entries()
            bend = TANH if number < len(self._layers) - 1 else Clip(1.0)
            append_bent(forms, rows, before, [bend] * len(before))

    def rounding(self, features: np.ndarray) -> np.ndarray:
        """Return by how much the policy's floats may err in the action (2,), for |f| <= features."""
        network = self._network
        error = ROUNDED * (features + np.abs(network.mean)) / network.std
        size = np.minimum((features + np.abs(network.mean)) / network.std, network.clip)
        for weight, bias in zip(network.weights, network.biases, strict=True):
            positive = np.abs(weight.astype(float))
            sums = positive @ size + np.abs(bias)
            error = positive @ error + 2.0**-52 * (2 + positive.shape[1]) * sums + 2.0**-48
            size = np.ones(len(bias))
        return np.asarray(1.01 * error)


class NetworkLaw:
    """The law of a learned policy, sample by sample.

    Attributes:
        memory: how many numbers it remembers.
    """

    def __init__(self, policy: LearnedPolicy, references: np.ndarray) -> None:
        """Take the policy, and what it is told at each sample (samples, 6)."""
        self._features, self._action = policy.bundle.features, policy.bundle.action
        self._network, self._calls = BallNetwork(policy.bundle.network), policy.calls_per_action
        d, based = self._features, policy.base is not None
        sizes = 1, d.past_errors, d.past_actions, 1, d.past_excesses, int(based)
        self._at = _Memory(*consecutive(MEASURED, *(JOINTS * n for n in sizes))[1:])
        self.memory = self._at.base.stop - MEASURED
        self._base = None if policy.base is None else (ball_law(policy.base), asked(policy.base, references))
        self._period, self._control_period = policy.action_period, policy.control_period
        self._leak, self._references = policy._features._leak, references
        self._aims, self._feedforward = _told(policy._features, references, self._calls)

    def respond(self, k: int, point: np.ndarray, seen: Zonotope) -> Response:
        """Return the answer at the k-th sample, see `SampledLaw`."""
        forms, instant = Forms(point, seen), k // self._calls
        if k % self._calls == 0:
            self._choose(forms, self._aims[instant], self._references[k])
        self._command(forms, k)
        self._excess(forms, self._feedforward[instant])
        forms.keep([*range(forms.middle.size - JOINTS, forms.middle.size), *range(MEASURED, MEASURED + self.memory)])
        return Response(forms.middle, forms.spelt_out(), np.zeros(len(forms.middle)))

    def _choose(self, forms: Forms, aim: np.ndarray, reference: np.ndarray) -> None:
        """Renew the action and what is remembered of the past; θ_d and θ̇_d are the `aim` (4,)."""
        n, at = len(forms.middle), self._at
        scratch, features = forms.copy(), [*self._listed(aim, reference)]
        self._append_features(scratch, features)
        count = len(features)
        self._network.act(scratch, np.eye(len(scratch.middle))[n:], scratch.balls(slice(n, n + count)))
        last = slice(len(scratch.middle) - JOINTS, None)
        middle, (gain, rest) = scratch.middle[last], scratch.over_base(last)
        rest += self._network.rounding(scratch.largest()[n : n + count])
        share = self._action.smoothing
        rows = (1.0 - share) * gain
        rows[:, at.action] += share * np.eye(JOINTS)
        before = forms.balls(at.action)
        ends = [arb(share) * a + (1.0 - share) * b for a, b in zip(before, middle.tolist(), strict=True)]
        forms.extend(rows, ends, rest + ROUNDED)
        self._remember(forms, aim)

    @staticmethod
    def _append_features(forms: Forms, features: list[_Feature]) -> None:
        """Append the features to the numbers that they are made of."""
        rows, numbers, at, bends = np.zeros((len(features), len(forms.middle))), forms.balls(), [], []
        for row, f in zip(rows, features, strict=True):
            x = arb(f.constant)
            if f.number is not None:
                row[f.number] = f.sign / f.scale
                x += f.sign * numbers[f.number]
            at.append(x / f.scale)
            bends.append(ASINH if f.bent else STRAIGHT)
        append_bent(forms, rows, at, bends)

    def _remember(self, forms: Forms, aim: np.ndarray) -> None:
        """Remember the new action, which stands behind the numbers, and the error from the `aim`."""
        n, at, d = len(forms.middle) - JOINTS, self._at, self._features
        error = np.zeros((JOINTS, n + JOINTS))
        error[:, :JOINTS] = -np.eye(JOINTS)
        errors = [float(x) - y for x, y in zip(aim[:JOINTS], forms.balls(slice(0, JOINTS)), strict=True)]
        forms.extend(error, errors, ROUNDED * np.abs(aim[:JOINTS]))
        new = np.eye(n + 2 * JOINTS)
        leaky = self._leak * (new[at.integral] + self._period * new[n + JOINTS :])
        summed = [self._leak * (x + self._period * e) for x, e in zip(forms.balls(at.integral), errors, strict=True)]
        forms.extend(leaky, summed, ROUNDED * (np.abs(leaky) @ forms.largest()))
        order = np.arange(n)
        order[at.action] = np.arange(n, n + JOINTS)
        for part, newest, count in ((at.errors, n + JOINTS, d.past_errors), (at.actions, n, d.past_actions)):
            if count:
                order[part] = [*range(newest, newest + JOINTS), *range(part.start, part.stop - JOINTS)]
        past = at.excesses
        if past.stop > past.start:
            order[past.start + JOINTS : past.stop] = np.arange(past.start, past.stop - JOINTS)
        order[at.integral] = np.arange(n + 2 * JOINTS, n + 3 * JOINTS)
        forms.keep(order.tolist())

    def _listed(self, aim: np.ndarray, reference: np.ndarray) -> Iterator[_Feature]:
        """Yield the features in their order, see `features`."""
        d, at = self._features, self._at
        for first, scale in ((0, d.error_scale), (JOINTS, d.rate_scale)):
            for i in range(first, first + JOINTS):
                yield _Feature(i, -1.0, float(aim[i]), scale, True)
        scales = np.repeat([1.0, d.velocity_scale, d.acceleration_scale], JOINTS)
        for x, scale in zip(reference.tolist(), scales.tolist(), strict=True):
            yield _Feature(None, 0.0, x, scale, False)
        for part, scale, bent in (
            (at.errors, d.error_scale, True), (at.actions, 1.0, False), (at.integral, d.integral_scale, True),
            (at.excesses, d.excess_scale, False),
        ):  # fmt: skip
            if part != at.integral or d.integral_time > 0.0:
                for i in range(part.start, part.stop):
                    yield _Feature(i, 1.0, 0.0, scale, bent)

    def _command(self, forms: Forms, k: int) -> None:
        """Append u, and renew x_I of the law below."""
        n, at, scale = len(forms.middle), self._at, np.array(self._action.scale)
        if self._base is None:
            rows = np.zeros((JOINTS, n))
            rows[:, at.action] = np.diag(scale)
            torque = [a * s for a, s in zip(forms.balls(at.action), scale.tolist(), strict=True)]
            forms.extend(rows, torque, ROUNDED * (np.abs(rows) @ forms.largest()))
            return
        law, samples = self._base
        rows = np.eye(n)[: MEASURED + JOINTS]
        rows[:JOINTS, at.action] -= np.diag(scale)
        rows[MEASURED:] = np.eye(n)[at.base]
        x = forms.balls()
        moved = [x[i] - s * x[at.action.start + i] for i, s in enumerate(scale.tolist())]
        forms.extend(rows, [*moved, *x[JOINTS:MEASURED], *x[at.base]], ROUNDED * (np.abs(rows) @ forms.largest()))
        picked = np.eye(n + MEASURED + JOINTS)[n:]
        spread, here = forms.spread(picked), forms.balls(slice(n, None))
        around = [x + ball(0.0, r) for x, r in zip(here, spread.tolist(), strict=True)]
        theta, velocity, integral = (slice(i * JOINTS, (i + 1) * JOINTS) for i in range(3))
        value = law.torque(here[theta], here[velocity], here[integral], samples[k]).value
        tube = law.torque(around[theta], around[velocity], around[integral], samples[k])
        middle, gain, rest = smooth_part(value, tube.slopes, spread)
        step = picked[integral] + self._control_period * picked[theta]
        wanted = samples[k].reference[theta].tolist()
        summed = [
            x + self._control_period * (q - r) for x, q, r in zip(here[integral], here[theta], wanted, strict=True)
        ]
        lost = ROUNDED * (np.abs(step) @ forms.largest() + self._control_period * np.abs(wanted))
        ends = [*summed, *(arb(u) for u in middle.tolist())]
        forms.extend(np.vstack([step, gain @ picked]), ends, np.concatenate([lost, rest + LAW_ROUNDING * tube.terms]))
        kept = n + len(picked)
        forms.keep([*range(at.base.start), *range(kept, kept + JOINTS), *range(kept + JOINTS, kept + 2 * JOINTS)])

    def _excess(self, forms: Forms, feedforward: np.ndarray) -> None:
        """Remember the excess of u over u_ff as the latest."""
        at, n = self._at, len(forms.middle)
        if at.excesses.stop == at.excesses.start:
            return
        rows = np.eye(n)[n - JOINTS :]
        over = [u - float(f) for u, f in zip(forms.balls(slice(n - JOINTS, n)), feedforward, strict=True)]
        forms.extend(rows, over, ROUNDED * (forms.largest()[n - JOINTS :] + np.abs(feedforward)))
        order = np.arange(n)
        order[at.excesses.start : at.excesses.start + JOINTS] = np.arange(n, n + JOINTS)
        forms.keep(order.tolist())


def _told(features: Features, references: np.ndarray, calls: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (θ_d, θ̇_d) (instants, 4) at each action instant, and u_ff (instants, 2)."""
    if features._target is None:
        aims = references[::calls, : 2 * JOINTS]
        return aims, np.zeros((len(aims), JOINTS))
    memory, found = features.memory, []
    for row in references[::calls]:
        q, dq, ddq = (PerJoint(*part) for part in row.reshape(3, JOINTS).tolist())
        past, feedforward, aim = features.told(memory, Observation(q, dq, q, dq, ddq))
        memory = memory._replace(target=past)
        found.append([*aim.q, *aim.dq, *feedforward])
    return np.array(found)[:, : 2 * JOINTS], np.array(found)[:, 2 * JOINTS :]
