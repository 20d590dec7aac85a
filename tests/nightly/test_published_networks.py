"""The script that tries published networks: options that refusals name, and the table of a page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.frame.tried import write_table
from experiments.studies import networks
from experiments.studies.networks import Candidate, Outcome
from vppres.core.errors import InputError, Problem


def refusing(*cures: str) -> Any:
    """A way to run that is refused until each option was given."""
    needed = {"--balance": "balance", "--slack": "slack", "--open-loops": "open_loops"}

    def run(
        candidate: Candidate, _: Path, chosen: dict[str, Any], accept: bool, state: dict[str, Any]
    ) -> str:
        for cure in cures:
            given = accept if cure == "--accept-deviation" else needed.get(cure) in chosen
            if not given:
                raise InputError(Problem(candidate.label, "cannot be so", f"Try {cure}."))
        state["buses"] = 7
        return "runs"

    return run


def test_options_that_refusals_name_are_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(networks, "_run", refusing("--slack", "--balance", "--accept-deviation"))
    outcome = networks.attempt(Candidate("a net", lambda: None), tmp_path)
    assert outcome.options == ("`--slack all`", "`--balance`", "`--accept-deviation`")
    assert (outcome.words, outcome.buses) == ("runs", 7)


def test_a_refusal_without_an_option_is_the_outcome(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(networks, "_run", refusing("something else"))
    outcome = networks.attempt(Candidate("a net", lambda: None), tmp_path)
    assert outcome.words == "no: cannot be so. Try something else."
    assert outcome.options == ()


def test_the_table_replaces_the_one_of_the_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{networks.BEGIN}\nold\n{networks.END}\nafter\n")
    outcome = Outcome("a net", (), 3, 1e-12, 3e-4, 0.0123, "runs", 1.0)
    marks = (networks.BEGIN, networks.END)
    rows = [networks.row_of(outcome)]
    write_table(networks.HEAD, rows, [outcome], tmp_path / "networks", "Networks", page, marks)
    assert page.read_text() == (
        f"before\n{networks.BEGIN}\n\n"
        "```{csv-table}\n:file: _static/page/networks.csv\n:header-rows: 1\n```\n\n"
        f"{networks.END}\nafter\n"
    )
    assert (tmp_path / "_static" / "page" / "networks.csv").read_text() == (
        "network,buses,needs,no load,as given,worst hour,a day\n"
        "a net,3,,< 1e-6,0.0003,0.0123,runs\n"
    )
