"""What an arm is tuned under: its motion, its loads and how fast small deviations must decay; Table 1's, scaled.

The motion is the arm's default reference. Loads are scaled as those of the cases are, see `envs.scenario.cases`; the
cases with loads themselves play no part in any search.
"""

from __future__ import annotations

from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.scenario.cases import case_for, find_case
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import MachiningForce
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of, with_drives

__all__ = ["PERIOD", "PERIODS", "force_factor", "heaviest", "periods_of", "radius_within", "with_stiffness"]

PERIOD = 1e-3
"""Control period of everything that is tuned [s]."""
PERIODS = 1500
"""Control periods of the paper's motion."""


def periods_of(arm: AnyArm) -> int:
    """Return how many control periods the arm's motion takes."""
    return round(default_reference(arm).duration / PERIOD)


def radius_within(share: float, periods: int) -> float:
    """Return the spectral radius per control period with which deviations shrink to a share in so many periods."""
    return float(share ** (1.0 / periods))


def heaviest(arm: AnyArm) -> float:
    """Return the payload [kg] that the arm has to bear: the one of its case ``payload``, 5 kg for Table 1."""
    return case_for("payload", arm).disturbance.payload.mass


def force_factor(arm: AnyArm) -> float:
    """Return the arm's forces over those of Table 1 [1], by which its machining force is scaled; 1 for Table 1."""
    own, papers = (case.disturbance.tip_force for case in (case_for("machining", arm), find_case("machining")))
    assert isinstance(own, MachiningForce) and isinstance(papers, MachiningForce)
    return own.base / papers.base


def with_stiffness(arm: AnyArm, factor: float) -> AnyArm:
    """Return the arm with all joints `factor` times as stiff."""
    return with_drives(arm, stiffness=factor * per_joint_of(arm, "stiffness"))
