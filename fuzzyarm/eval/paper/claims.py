"""All numbers of the paper that are compared with ours.

Each claim says where the number stands in the paper, what the paper says, how ours is measured and why the two differ.
"""

from __future__ import annotations

from fuzzyarm.eval.paper.rollout_claims import ROLLOUTS
from fuzzyarm.eval.paper.statements import STATEMENTS
from fuzzyarm.eval.paper.table_2 import TABLE_2

__all__ = ["CLAIMS", "ROLLOUTS", "STATEMENTS", "TABLE_2"]

CLAIMS = (*STATEMENTS, *TABLE_2, *ROLLOUTS)
"""All claims of the paper, in the order of the report."""
