"""The equation map: which of the paper's equations each family of rows states.

``equations.csv`` has a line for each of the paper's families, in the paper's order;
``docs/mathematics.md`` shows it as the table that :func:`equation_map` makes.
"""

from __future__ import annotations

from vppres.core.tables import packaged_table
from vppres.model import constraints, problem
from vppres.model.site import Site

EQUATIONS = {line["family"]: line for line in packaged_table(__file__, "equations.csv")}
"""Numbers, label and equation of the paper by the names of families."""


def equation_map(site: Site) -> str:
    """The table of the families that the page states for a site, in Markdown."""
    page = problem.paper_problem(site, 1)
    made = constraints.made_by(site, page.v, page.p)
    rows = [
        "| paper | label | equation | function (`model.constraints`) | constraint |",
        "|---|---|---|---|---|",
    ]
    for family in page.subject_to:
        line = EQUATIONS[family]
        label = f" `{line['label']}` " if line["label"] else " "
        rows.append(
            f"| {line['paper']} |{label}| {line['equation']} | `{made[family][0]}` | `{family}` |"
        )
    return "\n".join(rows)
