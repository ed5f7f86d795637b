"""A scenario: what one episode asks of the arm and what acts on it."""

from __future__ import annotations

from typing import NamedTuple

from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.reference import Reference

__all__ = ["Scenario"]


class Scenario(NamedTuple):
    """A disturbance and the reference to be tracked under it.

    Attributes:
        disturbance: what acts beside the controller.
        reference: the motion asked for; None: each episode draws one from the domain randomisation's references.
    """

    disturbance: Disturbance
    reference: Reference | None
