"""Survival of outages equals hand arithmetic, goes on where it stopped, and says how sure it is."""

from __future__ import annotations

import json
from dataclasses import replace
from errno import EACCES, ENOSPC
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.command_line import call
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.io import write_scenario
from vppres.scenario.scenario import Scenario
from vppres.studies import survival as study
from vppres.studies.side_by_side import Where
from vppres.studies.survival import (
    ONSETS,
    Survival,
    Tried,
    lengths_of,
    survival,
    variants_of,
    wilson,
)
from vppres.studies.survival_page import answers, how, write_survival

STEPS = 8
LENGTHS = (1, 2, 4)
ENERGY_KWH, LEAST, CHARGED = 60.0, 0.1, 0.8
HERE = Where(1)


def load_kw() -> np.ndarray:
    return 8.0 + 3.0 * np.arange(STEPS)


def clinic(energy_kwh: float = ENERGY_KWH) -> Scenario:
    """A battery without losses and a customer, on a line of next to no resistance."""
    times = pd.date_range("2025-07-01", periods=STEPS, freq="h", tz="UTC")
    return Scenario.from_tables(
        {
            "scenario": {
                "name": "clinic",
                "time": {"start": times[0], "step_minutes": 60, "steps": STEPS},
                "network": {"slack_bus": "grid", "base_kv": 0.4},
                "tiers": {"critical": 1.0},
                "controller": {"mode": "paper"},
            },
            "lines": [{"from_bus": "grid", "to_bus": "clinic", "r_ohm": 1e-4, "x_ohm": 1e-4}],
            "customers": [{"id": "ward", "bus": "clinic", "tier": "critical", "power_factor": 1.0}],
            "batteries": [
                {
                    "id": "battery",
                    "bus": "clinic",
                    "energy_kwh": energy_kwh,
                    "p_max_kw": 40.0,
                    "s_max_kva": 40.0,
                    "soc_min": LEAST,
                    "soc_max": 0.9,
                    "eta_charge": 1.0,
                    "eta_discharge": 1.0,
                }
            ],
            "load_kw": pd.DataFrame({"ward": load_kw()}, index=times),
            "system": pd.DataFrame({"price_gbp_per_kwh": 0.25, "temperature_c": 20.0}, index=times),
        }
    )


def tried(
    folder: Path, scale: str | None = None, knowledge: str = "known", **how: float
) -> Survival:
    options = RunOptions(outages=knowledge)
    which = Tried(tuple(map(float, LENGTHS)), **{"charged": CHARGED, **how})
    return survival(variants_of(clinic(), options, scale), which, folder, HERE)


def by_hand(onset: int, hours: int, energy_kwh: float = ENERGY_KWH) -> float:
    """Demand of an outage beyond the usable energy in kWh; the series repeat."""
    demand = load_kw()[np.arange(onset, onset + hours) % STEPS].sum()
    return float(demand - energy_kwh * (CHARGED - LEAST))


def test_survival_is_hand_arithmetic_for_every_onset_and_length(tmp_path: Path) -> None:
    found = tried(tmp_path / "s", "batteries=1,2")
    outages = found.by_onset()
    assert len(outages) == 2 * STEPS * len(LENGTHS)
    start = found.variants[0].site.grid.start
    for row in outages.to_dict("records"):
        onset = round((pd.Timestamp(row["onset"]) - start) / pd.Timedelta("1h"))
        energy_kwh = ENERGY_KWH * float(row["variant"].split()[-1])
        fits = by_hand(onset, int(row["length_h"]), energy_kwh) <= 1e-9
        assert (row["kept_h.critical"] == row["length_h"]) == fits
        assert (row["not_supplied_kwh"] == 0.0) == fits
    table = found.table().set_index(["variant", "length_h"])
    for factor, hours in ((f, h) for f in (1, 2) for h in LENGTHS):
        hand = np.mean([by_hand(t, hours, factor * ENERGY_KWH) <= 1e-9 for t in range(STEPS)])
        row = table.loc[(f"batteries x {factor}", hours)]
        assert (row["throughout"], row["low"], row["high"]) == (hand, hand, hand)
        assert hours * hand <= row["expected_h"] <= hours
    assert 0.0 < table.loc[("batteries x 1", 2), "throughout"] < 1.0
    assert found.customers()["throughout"].tolist() == found.table()["throughout"].tolist()


def test_an_end_that_is_not_known_takes_a_run_for_all_lengths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs: list[int | None] = []
    real = study.run_day

    def counted(site: Scenario, options: RunOptions, steps: int | None = None) -> object:
        runs.append(steps)
        return real(site, options, steps=steps)

    monkeypatch.setattr(study, "run_day", counted)
    found = tried(tmp_path / "s", knowledge="none", onsets=2)
    assert runs == [max(LENGTHS)] * 2
    outages = found.by_onset().groupby("onset")
    for _, rows in outages:
        kept = rows.set_index("length_h")["kept_h.critical"]
        assert kept.tolist() == [min(kept[4.0], hours) for hours in LENGTHS]


def test_what_is_finished_is_not_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "AT_A_TIME", 1)
    real, done = study.run_job, []

    def once(job: study.Job) -> list[study.OutageOutcome]:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(job.key)
        return real(job)

    monkeypatch.setattr(study, "run_job", once)
    with pytest.raises(KeyboardInterrupt) as interrupt:
        tried(tmp_path / "s", onsets=4)
    assert interrupt.value.__notes__[0].startswith("what is finished is kept in ")
    done.append("")
    again = tried(tmp_path / "s", onsets=4)
    assert len(done) == 5
    monkeypatch.undo()
    monkeypatch.setattr(study, "AT_A_TIME", 1)
    whole = tried(tmp_path / "whole", onsets=4)
    pd.testing.assert_frame_equal(again.by_onset(), whole.by_onset())


@pytest.mark.nightly
def test_two_workers_of_a_cluster_find_the_same(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    variants = variants_of(clinic(), RunOptions(outages="none"), None)
    which = Tried((1.0, 2.0), charged=CHARGED)
    here = survival(variants, which, tmp_path / "here", HERE)
    there = survival(variants, which, tmp_path / "there", Where(2, scheduler="local"))
    pd.testing.assert_frame_equal(here.by_onset(), there.by_onset())


def test_batteries_are_charged_as_operation_without_outages_leaves_them(tmp_path: Path) -> None:
    site = clinic()
    options = RunOptions(outages="none")
    found = survival(
        variants_of(site, options, None), Tried((1.0,), charged=None), tmp_path / "s", HERE
    )
    # Without an outage ahead energy at a flat price is not stored: at the least charge nothing is.
    assert found.table()["throughout"].tolist() == [0.0]
    known = survival(
        variants_of(site, RunOptions(outages="known"), None),
        Tried((1.0,), onsets=3),
        tmp_path / "known",
        HERE,
    )
    # An outage that is seen coming is prepared for.
    assert known.table()["throughout"].tolist() == [1.0]


def test_a_sample_says_how_sure_it_is(tmp_path: Path) -> None:
    found = tried(tmp_path / "s", onsets=5)
    row = found.table().iloc[0]
    assert row["onsets"] == 5
    assert (row["low"], row["high"]) == wilson(row["throughout"], 5)
    assert "5 of 8 steps, drawn by chance" in how(found)
    (words,) = answers(found, found.table())
    assert words.startswith(
        "The tier critical keeps supply throughout an outage of 1 h in 100% (57%"
    )
    assert [round(end, 4) for end in wilson(0.0, 10)] == [0.0, 0.2775]


def test_the_command_writes_tables_and_a_page(tmp_path: Path) -> None:
    write_scenario(clinic(), tmp_path / "clinic")
    words = ("--lengths", "1,4", "--charged", str(CHARGED), "--onsets", "8", "--jobs", "1")
    out = tmp_path / "s"
    result = call("survival", tmp_path / "clinic", *words, "--out", out, "--json")
    record = json.loads(result.stdout)
    assert [row["length_h"] for row in record["rows"]] == [1.0, 4.0]
    files = {path.name for path in out.iterdir()}
    assert {"survival.html", "survival.csv", "customers.csv", "onsets.csv", "survival.svg"} <= files
    page = (out / "survival.html").read_text()
    assert "keeps supply throughout an outage of 1 h in 100%" in page
    assert "the shares are exact for these series" in page
    assert len(pd.read_csv(out / "onsets.csv")) == 2 * STEPS
    again = call("survival", tmp_path / "clinic", *words, "--out", out)
    assert again.exit_code == 0
    assert "100.0%" in again.stdout


@pytest.mark.parametrize(("error", "status", "words"), [
    (KeyboardInterrupt(), 130, "Interrupted; what is finished is kept in {}, and the same command"),
    (OSError(ENOSPC, "", "x"), 1, "The disk is full, or a quota is reached; what is finished is kept"),
    (OSError(EACCES, "no", "x"), 2, "{}: cannot be written (no). Choose another folder"),
])  # fmt: skip
def test_a_command_that_breaks_off_says_what_is_kept(
    error: BaseException,
    status: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def breaks_off(*_: object) -> None:
        raise error

    monkeypatch.setattr(study, "map_unordered", breaks_off)
    write_scenario(clinic(), tmp_path / "clinic")
    options = ("--charged", "0.8", "--jobs", "1", "--out", tmp_path / "s")
    result = call("survival", tmp_path / "clinic", *options)
    assert result.exit_code == status
    assert words.format(tmp_path / "s") in result.stderr


def test_wrong_options_are_refused(tmp_path: Path) -> None:
    write_scenario(clinic(), tmp_path / "clinic")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("x")
    for options, words in (
        (("--lengths", "0.5"), "are not hours in whole steps of 1 h"),
        (("--lengths", "a"), "are not hours in whole steps of 1 h"),
        (("--lengths", "1,72"), "lengths = 1,72: is out of range"),
        (("--scale", "wind=1"), "must be one of batteries, pv, load and factors"),
        (("--scale", "batteries=-1"), "batteries"),
        (("--out", tmp_path / "other"), "is not the folder of such a study"),
    ):
        given = options if "--out" in options else (*options, "--out", tmp_path / "s")
        result = call("survival", tmp_path / "clinic", *given)
        assert result.exit_code == 2, options
        assert words in " ".join(result.stderr.split()), (words, result.stderr)
    assert lengths_of(None, 4.0) == (4.0, 8.0, 12.0, 24.0, 48.0)


def test_what_has_dates_does_not_repeat(tmp_path: Path) -> None:
    site = clinic()
    options = replace(RunOptions(outages="none"), forecaster="seasonal")
    with pytest.raises(InputError, match="does not fit into 8 steps that cannot repeat"):
        survival(variants_of(site, options, None), Tried((4.0,)), tmp_path / "s", HERE)


def test_the_page_compares_variants(tmp_path: Path) -> None:
    found = tried(tmp_path / "s", "load=1,2", onsets=2)
    record = write_survival(found, tmp_path / "s")
    assert {row["variant"] for row in record["rows"]} == {"load x 1", "load x 2"}
    page = (tmp_path / "s" / "survival.html").read_text()
    assert "Load x 2: the tier critical" in page
    assert (tmp_path / "s" / "onsets_2.svg").is_file()
    assert Tried((1.0,)).onsets == ONSETS
