"""Table 2 of the paper, the size of the design problem by number of rules, as data."""

from __future__ import annotations

from fuzzyarm.eval.paper import measures as m
from fuzzyarm.eval.paper import reasons
from fuzzyarm.eval.paper.claim import Claim

__all__ = ["TABLE_2"]


def _table_2(*sizes: int) -> dict[str, float]:
    return {f"{rules} rules": size for rules, size in zip(m.TABLE_2_RULES, sizes, strict=True)}


# Table 2 of the paper, row by row.
TABLE_2: tuple[Claim, ...] = (
    Claim("table-2-variables", "Table 2", "N_var: 5138, 1298, 338, 98", "N_var by the formula of Remark 4", "-",
          _table_2(5138, 1298, 338, 98), m.printed_size("variables")),
    Claim("true-variables", "Table 2", "N_var: 5138, 1298, 338, 98", "scalar variables of the theorem", "-",
          _table_2(5138, 1298, 338, 98), m.true_size("variables"), reason=reasons.TRUE_SIZE),
    Claim("table-2-rows", "Table 2", "N_row: 33816, 8728, 2328, 664", "N_row by the formula of Remark 4", "-",
          _table_2(33816, 8728, 2328, 664), m.printed_size("rows")),
    Claim("true-rows", "Table 2", "N_row: 33816, 8728, 2328, 664", "rows of the theorem's inequalities", "-",
          _table_2(33816, 8728, 2328, 664), m.true_size("rows"), reason=reasons.TRUE_SIZE),
)  # fmt: skip
