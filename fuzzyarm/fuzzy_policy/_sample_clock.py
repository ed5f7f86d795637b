"""The time T between two samples, determined from their references.

Given a motion and its derivatives at two instants T apart, the first relation (Hermite) determines T, and the second
relation checks it:

    q(t+T) - q(t) = T/2 (q̇(t) + q̇(t+T)) - T²/12 (q̈(t+T) - q̈(t)) + O(T⁵),
    q̇(t+T) - q̇(t) = T/2 (q̈(t) + q̈(t+T)) + O(T³).

T is accepted only if it satisfies both relations in every joint: a reference at rest, a jump to a new episode and
values that do not describe a motion give no T. With a single joint, two successive intervals must give the same T.
"""

import math
from typing import Any

import numpy as np

from fuzzyarm.envs.observation import PARTS

__all__ = ["SampleClock"]

_TOLERANCE = 1e-3  # largest relative difference between the T of successive intervals that count as equal

# Relative errors that the first and the second relation may have, which matters for samples far apart; largest rounding
# error of an angle relative to its change.
_CLOSED, _SLOPED, _ROUNDED = 1e-4, 0.1, 1e-5


def _period_between(before: np.ndarray, after: np.ndarray) -> float:
    """Return the time T [s] between two observations (5 n,) of a motion of n joints; 0 if they do not determine it."""
    (q, dq, ddq), (q_after, dq_after, ddq_after) = (np.reshape(one, (PARTS, -1))[-3:] for one in (before, after))
    speed, slope = 0.5 * (dq + dq_after), 0.5 * (ddq + ddq_after)
    turned, faster, sharper = q_after - q, dq_after - dq, (ddq_after - ddq) / 12.0
    # a T² - b T + c = 0 in the direction of the speed; the smaller root is the one for which T² is negligible
    a, b, c = float(sharper @ speed), float(speed @ speed), float(turned @ speed)
    root = b * b - 4.0 * a * c
    if c <= 0.0 or root < 0.0:
        return 0.0
    period = 2.0 * c / (b + math.sqrt(root))
    most, rounding = float(np.abs(turned).max()), 4.0 * np.finfo(float).eps * float(np.abs(q).max())
    missed = np.abs(turned - period * speed + period**2 * sharper).max(), np.abs(faster - period * slope).max()
    closed = missed[0] <= _CLOSED * most + rounding and missed[1] <= _SLOPED * np.abs(faster).max()
    return period if closed and rounding <= _ROUNDED * most else 0.0


class SampleClock:
    """The time between the samples of an episode that a policy receives, determined from the first lane (robot)."""

    def __init__(self) -> None:
        self.returned: Any = None  # the state that the policy returned last
        self.samples: list[np.ndarray] = []  # successive observations (lanes, 5 n) that determine T
        # Whether two successive intervals gave the same T; a single interval may span a sample that was left out.
        self.sure, self._found = False, 0.0

    def see(self, observation: np.ndarray, state: Any) -> float:
        """Return the time T [s] since the last observation (lanes, 5 n), to four digits; 0 if it is not known.

        `state` is passed with this observation. The time is known only if `state` equals `returned`, the state that the
        policy returned last.
        """
        seen, period = observation.copy(), 0.0
        # Memories that are still zero are equal in any two episodes.
        copied = self.returned is not None and np.any(self.returned) and np.array_equal(state, self.returned)
        if self.samples and (state is self.returned or copied):
            period = _period_between(self.samples[-1][0], seen[0])
        self.sure = period > 0.0 and abs(period - self._found) <= _TOLERANCE * period
        self._found = period
        self.samples = [*self.samples, seen] if period else [seen]
        return float(f"{period:.4g}") if self.sure or seen.shape[1] > PARTS else 0.0
