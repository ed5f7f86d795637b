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
    Claim(
        key="table-2-variables",
        where="Table 2",
        says="N_var: 5138, 1298, 338, 98",
        quantity="N_var by the formula of Remark 4",
        unit="-",
        paper=_table_2(5138, 1298, 338, 98),
        measure=m.printed_size("variables"),
    ),
    Claim(
        key="true-variables",
        where="Table 2",
        says="N_var: 5138, 1298, 338, 98",
        quantity="scalar variables of the theorem",
        unit="-",
        paper=_table_2(5138, 1298, 338, 98),
        measure=m.true_size("variables"),
        reason=reasons.TRUE_SIZE,
    ),
    Claim(
        key="table-2-rows",
        where="Table 2",
        says="N_row: 33816, 8728, 2328, 664",
        quantity="N_row by the formula of Remark 4",
        unit="-",
        paper=_table_2(33816, 8728, 2328, 664),
        measure=m.printed_size("rows"),
    ),
    Claim(
        key="true-rows",
        where="Table 2",
        says="N_row: 33816, 8728, 2328, 664",
        quantity="rows of the theorem's inequalities",
        unit="-",
        paper=_table_2(33816, 8728, 2328, 664),
        measure=m.true_size("rows"),
        reason=reasons.TRUE_SIZE,
    ),
)
