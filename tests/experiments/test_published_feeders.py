"""The table of published feeders, from files that stand where theirs do."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from typer.testing import CliRunner

from experiments.studies import published_feeders

dss = pytest.importorskip("opendssdirect")

SCRIPT = """clear
new circuit.t basekv=4.16 pu=1.02 bus1=s mvasc3=200 mvasc1=180
new line.l bus1=s bus2=b r1=.3 x1=.4 r0=.6 x0=1.2 length=1
new load.a bus1=b.1 phases=1 kv=2.4 kw=100 pf=.95
new load.off bus1=b.2 phases=1 kv=2.4 kw=9 enabled=no
new load.dark bus1=far.2 phases=1 kv=2.4 kw=7
new capacitor.c bus1=b kv=4.16 kvar=50 r=.1
set voltagebases=[4.16]
calcvoltagebases
solve
export voltages
"""


def test_each_feeder_is_compared_with_opendss_on_its_own_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = published_feeders.FEEDERS[:2]
    master = tmp_path / published_feeders.WHERE / known[0].master
    master.parent.mkdir(parents=True)
    master.write_text(SCRIPT)
    page = tmp_path / "page.md"
    page.write_text(f"before\n{published_feeders.BEGIN}\n{published_feeders.END}\nafter\n")
    monkeypatch.setattr(published_feeders, "FEEDERS", known)
    app = published_feeders.typer.Typer()
    app.command()(published_feeders.main)
    results = tmp_path / "results"
    done = CliRunner().invoke(app, [str(tmp_path), "--page", str(page), "--results", str(results)])
    assert done.exit_code == 0, done.output
    assert ":file: _static/page/published.csv" in page.read_text()
    with (tmp_path / "_static" / "page" / "published.csv").open(newline="") as file:
        _, *rows = csv.reader(file)
    _, buses, loads, kw, words, apart, losses, _ = rows[0]
    assert (buses, loads, kw, words, apart) == ("2", "1 of 2", "100.0 of 107.0", "", "< 1e-6")
    own, theirs = losses.split(", ")
    assert own == theirs
    assert rows[1][4] == "is not in the folder"
    assert [each.name for each in master.parent.iterdir()] == [master.name]  # nothing is written
    where = CliRunner().invoke(app, [str(tmp_path), "--where"])
    assert f"{known[0].label}: {published_feeders.WHERE}/{known[0].master}" in where.output


def test_what_is_not_compared_and_a_clone_that_fails_say_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = published_feeders.FEEDERS[:1]
    master = tmp_path / published_feeders.WHERE / known[0].master
    master.parent.mkdir(parents=True)
    master.write_text(SCRIPT.replace("kw=100", "kw=100 vminpu=.5").replace("solve\n", ""))
    monkeypatch.setattr(published_feeders, "FEEDERS", known)
    failed = published_feeders.Itself(error="OpenDSS finds no solution of it")
    monkeypatch.setattr(published_feeders, "itself", lambda _: failed)
    outcome = published_feeders.attempt(known[0], tmp_path)
    assert outcome.words == "not compared: OpenDSS finds no solution of it"
    nowhere = {"there": (tmp_path / "no repository").as_uri()}
    monkeypatch.setattr(published_feeders, "REPOSITORIES", nowhere)
    app = published_feeders.typer.Typer()
    app.command()(published_feeders.main)
    done = CliRunner().invoke(app, [str(tmp_path), "--fetch"])
    assert done.exit_code == 2, done.output
    assert f"is not cloned from {nowhere['there']} (" in " ".join(done.output.split())


@pytest.mark.daily
def test_voltages_that_a_new_folder_must_accept_are_an_option(tmp_path: Path) -> None:
    master = tmp_path / "far.dss"
    apart = SCRIPT.replace("kw=100", "kw=1000 vminpu=1")  # drawn as an impedance far below it
    master.write_text(apart)
    feeder, words, _ = published_feeders.imported(master)
    assert feeder is not None
    assert words == "`--accept-deviation`"
    master.write_text(apart.replace("vminpu=1", "vminpu=.5"))
    assert published_feeders.imported(master)[1] == ""
