"""Random streams, one per episode of a lane: number k is a pure function of the stream's key and the counter k.

SplitMix64 (Steele, Lea and Flood, 2014): number k of the stream with key s is mix(s + (k + 1) γ), where γ is a constant
and mix a bijection of 64-bit words. A lane needs no generator object, number k is available at once, and machine code
and NumPy give the same bits.

The numbers of an episode are used in this order: number 0 is the key of the lane's next episode; the numbers from 1 on
are for the domain randomisation in the order of `randomisation.draw_record`, 17 numbers for two joints; from
`noise_counter` on, every control step uses two numbers per joint for the encoder noise, angles before velocities.
"""

from typing import Any

import numpy as np

from fuzzyarm.envs.physics.elementwise import logarithm, root, sine_cosine
from fuzzyarm.envs.physics.records import size
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.numbers.functions import number

__all__ = ["NEXT_KEY", "RANDOMISATION", "draw", "key_before", "key_of", "noise_counter", "normal_pair", "uniform"]

_GAMMA = 0x9E3779B97F4A7C15
_FIRST, _SECOND = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
_FIRST_INVERSE, _SECOND_INVERSE = (pow(factor, -1, 2**64) for factor in (_FIRST, _SECOND))
_RESOLUTION = 2.0**-53
NEXT_KEY, RANDOMISATION = 0, 1  # counters, see above
_FIRST_NOISE = 32  # first counter of the noise, unless many joints need more numbers before it
_TWO_PI = 2.0 * np.pi


def noise_counter(joints: int) -> int:
    """Return the first counter of the encoder noise of an episode, for an arm with this number of joints."""
    return max(_FIRST_NOISE, RANDOMISATION + size(draw_record(joints)))


def _mix(word: Any) -> Any:
    """Return scrambled 64-bit words (uint64); the map is a bijection."""
    word = (word ^ (word >> 30)) * _FIRST
    word = (word ^ (word >> 27)) * _SECOND
    return word ^ (word >> 31)


def draw(key: Any, counter: Any) -> Any:
    """Return word number `counter` (uint64 or a Python int) of the stream with key `key` (uint64)."""
    offset = (counter + 1) * _GAMMA
    return _mix(key + (offset % 2**64 if isinstance(offset, int) else offset))


def key_before(key: np.ndarray) -> np.ndarray:
    """Return the keys (lanes,) uint64 of the streams whose number `NEXT_KEY` is `key` (lanes,), by inverting `draw`."""
    word = key ^ (key >> 31) ^ (key >> 62)
    word = word * _SECOND_INVERSE
    word = (word ^ (word >> 27) ^ (word >> 54)) * _FIRST_INVERSE
    word = word ^ (word >> 30) ^ (word >> 60)
    return np.asarray(word - (NEXT_KEY + 1) * _GAMMA)


def uniform(key: Any, counter: Any) -> Any:
    """Return number `counter` of the stream as a float in [0, 1), a multiple of 2^-53."""
    return number(draw(key, counter) >> 11) * _RESOLUTION


def normal_pair(key: Any, counter: Any) -> tuple[Any, Any]:
    """Return two independent standard normal samples (Box and Muller).

    They are from numbers `counter` and `counter` + 1 of the stream with key `key`.
    """
    radius = root(-2.0 * logarithm(1.0 - uniform(key, counter)))
    sine, cosine = sine_cosine(_TWO_PI * uniform(key, counter + 1))
    return radius * cosine, radius * sine


def key_of(seed: int) -> np.uint64:
    """Return the key of a lane seeded with `seed`, scrambled by NumPy's `SeedSequence`."""
    key: np.uint64 = np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]
    return key
