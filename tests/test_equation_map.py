"""The page of equations against the problem that is really built."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vppres.model import constraints, objective
from vppres.model.beyond_paper.physical import PhysicalParameters
from vppres.model.forms import Form, WindowModel
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables
from vppres.scenario.scenario import Scenario

PAGE = Path(__file__).parent.parent / "docs" / "mathematics.md"


def table(heading: str) -> list[list[str]]:
    """Cells of the first table below a heading of the page."""
    text = PAGE.read_text(encoding="utf-8").split(f"{heading}\n", 1)[1]
    rows = []
    for line in text.splitlines():
        if line.startswith("|"):
            rows.append([cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]])
        elif rows:
            break
    return rows[2:]


def names(cell: str) -> list[str]:
    """Code names of a cell."""
    return re.findall(r"`([A-Za-z_0-9]+)`", cell)


@pytest.fixture
def site(tiny: Scenario) -> Site:
    return Site.of(tiny)


@pytest.mark.parametrize("polygon_sides", [0, 16])
def test_every_constraint_has_its_row_and_every_row_its_constraint(
        site: Site, polygon_sides: int) -> None:
    model = WindowModel(site, 2, Form(polygon_sides=polygon_sides))
    rows = table("## Equations")
    assert sorted(names(row[3])[0] for row in rows) == sorted(model.constraints)


def test_constraints_are_made_by_the_functions_that_the_page_names(site: Site) -> None:
    v, p = Variables.create(site, 2, "integer", "integer"), Parameters.create(site, 2)
    for row in table("## Equations"):
        function, constraint = names(row[2])[0], names(row[3])[0]
        assert constraint in getattr(constraints, function)(site, v, p)


def test_variables_and_parameters_are_those_of_the_page() -> None:
    assert [names(r[1])[0] for r in table("### Variables")] == list(
        Variables.__dataclass_fields__)
    listed = [n for r in table("### Parameters") for n in names(r[1])]
    assert sorted(listed) == sorted(Parameters.__dataclass_fields__)


def test_objective_terms_are_those_of_the_page() -> None:
    for row in table("## Objective"):
        assert hasattr(objective, names(row[2])[0])


@pytest.mark.parametrize("polygon_sides", [0, 16])
def test_physical_mode_differs_by_what_the_page_says(site: Site, polygon_sides: int) -> None:
    paper = WindowModel(site, 2, Form(polygon_sides=polygon_sides))
    physical = WindowModel(site, 2, Form(polygon_sides=polygon_sides, physical=True))
    rows = table("### Physical mode")
    listed = {names(row[3])[0] for row in rows}
    assert set(paper.constraints) - set(physical.constraints) == {"voltage_slack"}
    assert set(physical.constraints) - set(paper.constraints) <= listed
    known = set(PhysicalParameters.__dataclass_fields__)
    assert {n for row in rows for n in names(row[2])} == known
    changed = {name for name, constraint in physical.constraints.items()
               if known & {p.name() for p in constraint.parameters()}}
    assert changed == listed
