"""The page of equations against the problem that is really built."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

from vppres.model import problem
from vppres.model.beyond_paper.physical import PhysicalMode
from vppres.model.equations import EQUATIONS, equation_map
from vppres.model.problem import paper_problem
from vppres.model.site import Site
from vppres.model.statement import Statement
from vppres.model.variables import Parameters, Variables
from vppres.scenario.scenario import Scenario

LAST_EQUATION = 30
LABELS = {
    3: "eq:batt_inverter",
    6: "eq:min_pv",
    7: "eq:pv_inverter",
    16: "eq:full-distflow",
    17: "eq:full-distflow1",
    21: "eq:dist_flow_diff",
}
"""The labels that the paper gives in Sections 3.1 and 3.2, by its equations' numbers."""
PAGE = Path(__file__).parents[2] / "docs" / "mathematics.md"


def tables(heading: str) -> list[list[list[str]]]:
    """Cells of the tables below a heading of the page, up to the next heading."""
    text = PAGE.read_text(encoding="utf-8").split(f"{heading}\n", 1)[1]
    found: list[list[list[str]]] = []
    inside = False
    for line in text.splitlines():
        if line.startswith("#"):
            break
        if line.startswith("|"):
            if not inside:
                found.append([])
            cells = re.split(r"(?<!\\)\|", line)[1:-1]
            found[-1].append([cell.strip() for cell in cells])
        inside = line.startswith("|")
    return [rows[2:] for rows in found]


def table(heading: str) -> list[list[str]]:
    """Cells of the first table below a heading of the page."""
    return tables(heading)[0]


def numbers(cell: str) -> set[int]:
    """Numbers of the paper's equations in a cell: those that a row states, not its neighbours'."""
    if cell.startswith(("above", "below", "with")):
        return set()
    return {int(number) for number in re.findall(r"\((\d+)\)", cell)}


def names(cell: str) -> list[str]:
    """Code names of a cell."""
    return re.findall(r"`([A-Za-z_0-9]+)`", cell)


@pytest.fixture
def site(tiny: Scenario) -> Site:
    return Site.of(tiny)


def test_the_table_of_equations_is_made_of_the_families(site: Site) -> None:
    assert equation_map(site) in PAGE.read_text(encoding="utf-8")
    assert list(EQUATIONS) == list(paper_problem(site, 2).subject_to)
    assert set(EQUATIONS) == set(Statement(site, 2).families)


def test_every_equation_of_section_3_has_its_row() -> None:
    rows = [row for part in tables("## Equations") for row in part] + table("## Objective")
    found = [number for row in rows for number in sorted(numbers(row[0]))]
    assert set(found) == set(range(1, LAST_EQUATION))
    page = PAGE.read_text(encoding="utf-8")
    assert f"({LAST_EQUATION}) `objective_function`" in page


def test_every_label_of_the_paper_stands_beside_its_equation() -> None:
    labels: dict[int, str] = {}
    for row in [row for part in tables("## Equations") for row in part]:
        listed = re.findall(r"`(eq:[\w-]+)`", row[1])
        # One label belongs to the last of the equations that a row states, several to each.
        labels |= (
            dict(zip(sorted(numbers(row[0]))[-len(listed) :], listed, strict=True))
            if listed
            else {}
        )
    assert labels == LABELS


def test_code_names_the_labels_that_the_page_names() -> None:
    code = Path(str(problem.__file__)).read_text(encoding="utf-8")
    for number in (3, 6, 7, 21):
        assert f"{LABELS[number]}\n" in code


def test_variables_and_parameters_are_those_of_the_page(site: Site) -> None:
    listed = [names(row[1])[0] for row in table("### Variables")]
    assert sorted(listed) == sorted(vars(Variables(site, 2)))
    listed = [n for r in table("### Parameters") for n in names(r[1])]
    assert sorted(listed) == sorted(vars(Parameters(site, 2)))


def test_objective_terms_are_those_of_the_page() -> None:
    used = inspect.getsource(problem.paper_objective)
    for row in table("## Objective"):
        assert f"{names(row[3])[0]}(site, v, p)" in used
        assert f"# {row[0]}" in used


def test_physical_mode_differs_by_what_the_page_says(site: Site) -> None:
    paper, physical = Statement(site, 2), Statement(site, 2, ((PhysicalMode, True),))
    rows = table("### Physical mode")
    listed = {names(row[3])[0] for row in rows}
    assert set(paper.families) - set(physical.families) == {"voltage_slack"}
    assert set(physical.families) - set(paper.families) <= listed
    known = vars(physical.additions[0]).keys()
    assert {n for row in rows for n in names(row[2])} == known
    changed = {
        name
        for name, constraint in physical.families.items()
        if known & {p.name() for p in constraint.parameters()}
    }
    assert changed == listed
