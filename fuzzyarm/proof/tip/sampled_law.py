"""The torque and memory of a policy after a sample, for all states of a zonotope at once.

    (u, m⁺) = law(θ, θ̇, m; r_k),      m: the values that the policy carries from one sample to the next.

The policy's own law is run on affine numbers. Its arguments are a point plus a zonotope of deviations of (θ, θ̇, m); its
results are another point plus deviations of (u, m⁺), over the same columns and new ones, so torque and memory stay
correlated. The part of the memory that depends only on the reference is not in m, but stored as floats.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.checks import shown
from fuzzyarm.fuzzy_policy.law import law_of, seen_by
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.functions import RECORDERS, like
from fuzzyarm.proof.tip._affine import WORTH, Affine, Space
from fuzzyarm.proof.tip.enclosures import ROUND_UP, SLACK, NoBound
from fuzzyarm.proof.tip.zonotope import Zonotope, merged, product

__all__ = ["Response", "SampledLaw"]

_WORTH_A_COLUMN = 1e-3  # an unknown above this share of a result's size keeps its column
_MOST_UNKNOWNS = 6  # unknowns for each result, beyond which they are merged
_RUNS = 6  # runs that show which parts of the memory depend on the measurements

_UNKNOWN: dict[type[Policy], str] = {
    AdaptiveObserverPolicy: "there is no bound for the adaptive observer: the corrections of its Kalman filter divide "
    "by a covariance in its memory and pass a gate and a dead zone, whose branches are undecided on a tube",
    LearnedObserverPolicy: "there is no bound for the learned observer: its filter divides by a covariance in its "
    "memory and branches on it, which is undecided on a tube, and the gates of its network multiply their memory",
}
"""The reason why there is no bound, by policy class, for classes that derive from a class with a bound."""


class Response(NamedTuple):
    """The set of torque and memory x = (u, m⁺) after a sample: x = middle + columns g + β, |g_i| <= 1, |β| <= box."""

    middle: np.ndarray  # (2 + m,) torques [N m] and the memory
    columns: np.ndarray  # (2 + m, n); the first belong to the columns of the law's arguments
    box: np.ndarray  # (2 + m,)


class SampledLaw:
    """The law of a policy, evaluated at each sample for all states of a zonotope."""

    def __init__(self, policy: Policy, references: np.ndarray) -> None:
        """Prepare a policy's law for the references (samples, 3 n); `NoBound` if the law has no enclosure."""
        if type(policy) in _UNKNOWN:
            raise NoBound(f"{_UNKNOWN[type(policy)]}; choose elastic-observer, which has a bound")
        law = law_of(policy)
        if law is None:
            raise NoBound(
                f"there is no bound for {shown(type(policy).__name__)}: it defines no `Law`; choose elastic-observer, "
                "a learned policy, or a fuzzy policy or computed-torque, with or without the ending -tip"
            )
        self._law, self._references, self._joints = law, references, policy.joints
        self._measured = 2 * policy.joints  # length of (θ, θ̇), which precedes the memory
        # Some runs with different measurements: entries of the memory that differ depend on measurements. `_answer`
        # checks that all others equal those recorded here.
        asked = np.repeat(references[:, np.newaxis], _RUNS, axis=1)
        apart = 0.1 ** np.arange(_RUNS)[:, np.newaxis] * np.random.default_rng(0).normal(
            size=(len(asked), 1, self._measured)
        )
        observations = np.concatenate([asked[:, :, : self._measured] + apart, asked], axis=2)
        memory, torque, held = np.zeros((_RUNS, policy.memory_size)), np.empty((_RUNS, policy.joints)), []
        for observation in observations:
            held.append(memory.copy())
            policy.act(observation, memory, torque)
        self._held = np.array([*held, memory])
        # Indices of the entries of the policy's memory that depend on measurements, and their count.
        self.remembered = np.flatnonzero((self._held != self._held[:, :1]).any(axis=(0, 1)))
        self.memory = len(self.remembered)

    def repeats(self, steps: int) -> bool:
        """Return whether all laps of `steps` samples except the first begin with the same stored memory."""
        second, third = (np.delete(self._held[lap * steps, 0], self.remembered) for lap in (1, 2))
        return bool((second == third).all())

    def respond(self, k: int, point: np.ndarray, seen: Zonotope) -> Response:
        """Return (u, m⁺) at the k-th sample, for deviations `seen` from a point (4 + m,): measured θ, θ̇, memory.

        `NoBound` if a choice of the law is undecided on this set or an operation has no enclosure; ValueError if an
        enclosure is not finite.
        """
        space = Space(seen)
        RECORDERS.append(space)
        try:
            return _spelt_out(space, self._answer(k, space, point))
        except TypeError as error:
            raise NoBound(f"the law uses an operation that cannot be enclosed: {error}") from error
        finally:
            RECORDERS.pop()

    def _answer(self, k: int, space: Space, point: np.ndarray) -> list[Affine]:
        """Return (u, m⁺) at sample k, for a point (4 + m,) plus the deviations of a space, as affine numbers."""
        variables, memory = space.variables(point), self._held[k, 0].tolist()
        for place, number in zip(self.remembered.tolist(), variables[self._measured :], strict=True):
            memory[place] = number
        seen = like(seen_by(self._joints), iter([*variables[: self._measured], *self._references[k].tolist()]))
        law = self._law
        after, torque = law.act(like(law.memory, iter(memory)), seen, law.constants, *law.tables)
        numbers, own = [*_numbers((after,))], set(self.remembered.tolist())
        for place, (number, held) in enumerate(zip(numbers, self._held[k + 1, 0].tolist(), strict=True)):
            if place not in own and (isinstance(number, Affine) or number != held):
                raise NoBound("a part of the law's memory that should depend only on references differs in two runs")
        return [space.number(x) for x in [*torque, *(numbers[place] for place in sorted(own))]]


def _numbers(tree: Any) -> Iterator[Any]:
    """Yield the numbers of nested tuples and arrays, in order."""
    for part in tree:
        yield from _numbers(part) if isinstance(part, tuple | np.ndarray) else (part,)


def _spelt_out(space: Space, numbers: list[Affine]) -> Response:
    """Return affine numbers of `space` as a `Response`: large unknowns and rests as columns, small ones in the box."""
    rows, (middle, size, rest) = space.rows(numbers), np.array([(x.middle, x.size, x.rest) for x in numbers]).T
    known = len(space.base.box)
    inner, own = rows[:, :known], rows[:, known:]
    rest = rest + np.abs(inner) @ space.base.box + SLACK * size
    total = space.reach(rows) + rest
    small = (np.abs(own) <= _WORTH_A_COLUMN * total[:, np.newaxis]).all(axis=0)
    rest += np.abs(own[:, small]).sum(axis=1)
    own = own[:, ~small]
    if own.shape[1] > _MOST_UNKNOWNS * len(own):
        own, missed = merged(own)
        rest += missed
    rest *= ROUND_UP
    if not (np.isfinite(middle).all() and np.isfinite(rest).all() and np.isfinite(rows).all()):
        raise NoBound("no finite enclosure was found for the law's torque or memory")
    beside = rest > WORTH * total  # these rests become columns, the others a box
    columns = np.hstack([product(inner, space.base.columns), own, np.diag(np.where(beside, rest, 0.0))[:, beside]])
    return Response(middle, columns, np.where(beside, 0.0, rest))
