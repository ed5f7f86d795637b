"""The documentation's tables of the exported C, from stored results."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

__all__ = ["exported_table", "misra_table"]


def misra_table(document: dict[str, Any]) -> str:
    """Return the table of what the MISRA addon finds in the exported C."""
    found = {rule for row in document["rows"] for rule in row["violations"]}
    rules = sorted(found, key=lambda rule: [int(part) for part in rule.split(".")])
    rows = [
        [row["source"], f"{row['lines']:,}", *(str(row["violations"].get(rule, "")) for rule in rules)]
        for row in document["rows"]
    ]
    made = f"`{document['command']}`; {document['cppcheck']}; {made_with(document)}"
    return f"{table(['source', 'lines', *rules], rows)}\n\n{made}"


def exported_table(document: dict[str, Any]) -> str:
    """Return the table of the exported C: bits, times and what float costs."""
    compilers = list(document["compilers"])
    headings = [
        "law",
        "ticks",
        "numbers that differ",
        *(f"{name}, ns a tick: median (5 to 95 %)" for name in compilers),
        "`predict` [ns]",
        "float: torque off, rms / max [N m]",
        "float: largest tip error, not double's [mm]",
    ]
    rows = [
        [
            row["law"],
            f"{row['ticks']:,}",
            ", ".join(str(row["differing"][name]) for name in compilers),
            *("{median:.0f} ({p5:.0f} to {p95:.0f})".format(**row["nanoseconds"][name]) for name in compilers),
            f"{row['python_nanoseconds']:.0f}",
            *(
                (
                    f"{row['float']['torque_rms']:.2g} / {row['float']['torque_max']:.2g}",
                    f"{row['float']['tip_float_mm']:.3g}, not {row['float']['tip_double_mm']:.3g}",
                )
                if row["float"]
                else ("refused", "")
            ),
        ]
        for row in document["rows"]
    ]
    versions = ", ".join(document["compilers"].values())
    return f"{table(headings, rows)}\n\n`{document['command']}`; {versions}; {made_with(document)}"
