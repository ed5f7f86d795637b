"""The documented scales: what motors and reference do over the family of references, and what the motors can give."""

import numpy as np

from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.observation import ACTION_SCALE, OBSERVATION_SCALE, observed
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.default_reference import reference_family
from fuzzyarm.envs.scenario.disturbances import Disturbance


def test_scales_are_the_magnitudes_of_the_family_and_the_limits_of_the_motors():
    family = reference_family(ArmParameters())
    rows = np.concatenate([Schedule.build(one, Disturbance(), 5e-3).references for one in family])
    scale = observed(OBSERVATION_SCALE)
    reference = [scale.q_reference, scale.dq_reference, scale.ddq_reference]
    np.testing.assert_allclose(np.ravel(reference), np.sqrt(np.mean(rows**2, axis=0)), rtol=0.03)
    np.testing.assert_array_equal(np.ravel(reference[:2]), np.ravel([scale.q_motor, scale.dq_motor]))
    env = FuzzyArmEnv()
    np.testing.assert_array_equal(ACTION_SCALE, env.action_space.high)
