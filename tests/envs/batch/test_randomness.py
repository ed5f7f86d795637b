"""The counter-based generator: published words, a bijection, and numbers that pass for independent draws."""

import itertools

import numpy as np
import pytest
from scipy import stats

from fuzzyarm.envs.batch.randomness import draw, key_of, normal_pair, uniform
from fuzzyarm.numbers.functions import bits, whole, word
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

WORDS = 1 << 64
# The generator's first words for the seed 1234567, as Rosetta Code prints them.
PUBLISHED = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431, 16408922859458223821]
SAMPLES = 100_000
GAMMA = 0x9E3779B97F4A7C15


def words(*values):
    return np.array(values, dtype=np.uint64)


def counters(count):
    return np.arange(count, dtype=np.uint64)


def unmixed(word):
    """The word that `mix` takes to this one, in whole numbers: each of its three steps undone in turn."""
    for shift, factor in ((31, 0x94D049BB133111EB), (27, 0xBF58476D1CE4E5B9), (30, None)):
        shifted = word
        for _ in range(64 // shift + 1):
            shifted = word ^ (shifted >> shift)
        word = shifted if factor is None else shifted * pow(factor, -1, WORDS) % WORDS
    return word


def key_with(word):
    """The key whose first number is this word."""
    return words((unmixed(word) - GAMMA) % WORDS)


def uncorrelated(first, second):
    """Whether two samples' correlation is within five standard deviations of none."""
    return abs(np.corrcoef(first, second)[0, 1]) < 5.0 / np.sqrt(len(first))


def test_words_are_the_published_ones_mix_is_a_bijection_and_keys_are_numpys_and_all_different():
    assert draw(words(1234567), counters(5)).tolist() == PUBLISHED
    given = np.random.default_rng(0).integers(0, WORDS, 2000, dtype=np.uint64)
    assert [unmixed(word) for word in draw(given - words(GAMMA), words(0)).tolist()] == given.tolist()
    assert len({int(key_of(seed)) for seed in range(5000)}) == 5000
    assert key_of(2**200 + 1) != key_of(1)  # seeds of any size
    assert key_of(42) == np.random.SeedSequence(42).generate_state(1, np.uint64)[0]


def test_uniform_numbers_are_multiples_of_two_to_minus_53_below_one():
    numbers = uniform(words(7), counters(SAMPLES))
    assert numbers.min() >= 0.0 and numbers.max() < 1.0
    assert set(np.ldexp(numbers, 53) % 2.0) == {0.0, 1.0}  # all 53 bits are in use
    for drawn, number in ((0, 0.0), (WORDS - 1, 1.0 - 2.0**-53), (WORDS // 2, 0.5), (1 << 11, 2.0**-53)):
        assert uniform(key_with(drawn), words(0)).tolist() == [number]


def test_numbers_are_uniform_and_pairs_fill_the_square_evenly():
    """Of neighbouring counters and of neighbouring keys."""
    for numbers in (uniform(words(3), counters(2 * SAMPLES)), uniform(counters(2 * SAMPLES), words(5))):
        assert stats.kstest(numbers, "uniform").pvalue > 1e-4
        counts, _, _ = np.histogram2d(numbers[::2], numbers[1::2], bins=32, range=((0, 1), (0, 1)))
        assert stats.chisquare(counts.ravel()).pvalue > 1e-4


def test_neighbours_are_uncorrelated():
    stream, lanes = uniform(words(9), counters(SAMPLES)), uniform(counters(SAMPLES), words(9))
    for lag, numbers in itertools.product((1, 2, 17, 1000), (stream, lanes)):
        assert uncorrelated(numbers[lag:], numbers[:-lag])
    assert uncorrelated(stream, lanes)
    key = np.array([key_of(0)])
    one, other = (uniform(k, counters(SAMPLES)) for k in (key, draw(key, words(0))))  # word 0: the next episode's key
    assert uncorrelated(one, other) and uncorrelated(one[1:], other[:-1])


def test_normal_pairs_are_standard_normal_and_independent_and_the_outermost_are_box_and_mullers():
    pairs = np.array(normal_pair(words(11), counters(SAMPLES) * words(2)))
    for sample in pairs:
        assert stats.kstest(sample, "norm").pvalue > 1e-4
        # Five standard deviations of each estimate: the variances of the moments are 1/n, 2/n, 15/n and 96/n.
        moments = np.array([np.mean(sample**power) for power in (1, 2, 3, 4)])
        assert (np.abs(moments - [0.0, 1.0, 0.0, 3.0]) < 5.0 * np.sqrt(np.array([1, 2, 15, 96]) / SAMPLES)).all()
    first, second = pairs
    assert uncorrelated(first, second) and uncorrelated(first**2, second**2)
    assert uncorrelated(first[1:], first[:-1]) and uncorrelated(first[1:], second[:-1])
    largest = normal_pair(key_with(WORDS - 1), words(0))
    assert np.hypot(*largest)[0] == pytest.approx(np.sqrt(106.0 * np.log(2.0)), rel=1e-15)
    assert np.array_equal(np.abs(normal_pair(key_with(0), words(0))), np.zeros((2, 1)))


def test_machine_code_draws_the_same_bits_as_numpy():
    rng = np.random.default_rng(2)
    key, counter = rng.integers(0, WORDS, 20_000, dtype=np.uint64), rng.integers(0, 2**50, 20_000, dtype=np.uint64)

    def drawn(given, _, __):
        key, counter = word(given[0]), whole(given[1])
        return given, (bits(draw(key, counter)), uniform(key, counter), *normal_pair(key, counter))

    kernel, found = Kernel(Program(drawn, ((0.0, 0.0), (0.0,) * 4))), np.empty((len(key), 4))
    kernel((np.stack([key.view(np.float64), counter.astype(np.float64)], axis=1), found), np.empty(0))
    assert np.array_equal(found[:, 0].copy().view(np.uint64), draw(key, counter))
    assert np.array_equal(found[:, 1], uniform(key, counter))
    # NumPy's own logarithm may differ from the C library's in the last bit.
    np.testing.assert_allclose(found[:, 2:].T, normal_pair(key, counter), rtol=5e-16)
