"""What trainings share: evaluations that are brief."""

import pytest

from fuzzyarm.envs.scenario.paths import Line
from fuzzyarm.envs.scenario.reference import JointReference


@pytest.fixture(scope="module")
def brief_evaluations():
    """Let evaluations follow a short line, not the circle: that takes longer than these trainings."""
    from fuzzyarm.rl_baselines import _case_evaluation as case_evaluation

    brief = JointReference(Line((0.4, 0.5), (0.42, 0.5)), duration=0.1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(case_evaluation, "default_reference", lambda arm: brief)
        yield
