"""Reasons of termination: their texts and their order."""

import itertools

import numpy as np

from fuzzyarm.envs.task import Termination, reason_of


def test_every_reason_has_a_text_of_its_own():
    texts = [reason.text for reason in Termination]
    assert texts[Termination.NONE] == "" and all(texts[1:]) and len(set(texts)) == len(texts)


def test_not_finite_comes_before_angle_and_angle_before_velocity():
    flags = np.array(list(itertools.product([0.0, 1.0], repeat=3)))
    for (finite, angles, velocities), found in zip(flags, reason_of(*flags.T), strict=True):
        if not finite:
            expected = Termination.NOT_FINITE
        elif not angles:
            expected = Termination.ANGLE
        else:
            expected = Termination.NONE if velocities else Termination.VELOCITY
        assert found == reason_of(finite, angles, velocities) == expected
