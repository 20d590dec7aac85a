"""The page that is read first: its sums by hand, both clocks, the price, and the file on paper."""

from __future__ import annotations

import re
import shutil
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.command_line import call
from tests.support.made_up_runs import (
    day_run,
    day_scenario,
    small_run,
    small_scenario,
    without_devices,
)
from vppres.core.errors import InputError, ReportError
from vppres.day.metrics import summarise
from vppres.day.reliability import reliability_by_tier, reliability_figures
from vppres.day.series import off_kw
from vppres.day.trajectory import Trajectory
from vppres.io import read_scenario, write_scenario
from vppres.report.answer import answer
from vppres.report.clock import Clock
from vppres.report.events import events_of
from vppres.report.findings import findings
from vppres.report.finished import priced, read_finished
from vppres.report.first_page import (
    energy_rows,
    foundations,
    further_notes,
    limit_rows,
    price_sentence,
    supply_rows,
    who_and_why,
)
from vppres.report.key_figures import number
from vppres.report.operating_order import (
    off_sentence,
    operating_order,
    shown_orders,
)
from vppres.report.pdf import BROWSERS, find_browser, write_pdf
from vppres.report.run_folder import render_report, write_run
from vppres.scenario.source import Source
from vppres.scenario.timegrid import TimeGrid

LONDON = "Europe/London"


def test_reliability_by_hand() -> None:
    # Of b and c each loses supply once: for 30 and 60 min, 10 + 40 kWh.
    low = reliability_by_tier(small_run()).loc["low"]
    assert low.tolist() == [2.0, 2.0, 2.0, 90.0, 120.0, 50.0]


def test_two_interruptions_of_a_customer_count_twice() -> None:
    run = small_run()
    served = run.customers["served"].to_numpy(bool).reshape(4, 3).copy()
    served[:, 0] = [False, True, False, True]
    run = replace(run, customers=run.customers.assign(served=served.ravel()))
    critical = reliability_by_tier(run).loc["critical"]
    assert critical[["interrupted", "interruptions", "minutes_lost"]].tolist() == [1.0, 2.0, 60.0]


def test_parts_are_parts_of_one_customer() -> None:
    day = small_scenario()
    customers = replace(day.customers, id=["a", "b/1", "b/2"])
    run = small_run(replace(day, customers=customers, pv=replace(day.pv, customer=["b/1"])))
    run = replace(run, options={**run.options, "parts": {"b": 2}})
    figures = reliability_figures(run)
    # a loses 30 min; half of b loses 30 min, the other half 60.
    assert figures["customer_minutes_lost"] == 75.0
    assert figures["minutes_lost_per_customer"] == 37.5
    assert figures["interruptions_per_customer"] == 1.0


def test_supply_in_words() -> None:
    run = small_run()
    rows = {row.tier: row for row in supply_rows(run, summarise(run))}
    assert list(rows) == ["critical", "low", "all"]
    assert (rows["all"].customers, rows["all"].interruptions, rows["all"].minutes) == (
        "3",
        "100.0",
        "40.0",
    )
    assert (rows["low"].unserved, rows["low"].share) == ("50.0", "25.0%")


def test_who_was_off_and_why() -> None:
    told = who_and_why(small_run())
    assert told[0] == (
        "3 of 3 customers lost supply. Most important first: a (critical) 30 min, "
        "c (low) 1 h, b (low) 30 min."
    )
    assert told[1].startswith("No reasons recorded")
    quiet = small_run(small_scenario(outage=False))
    quiet = replace(quiet, customers=quiet.customers.assign(served=True))
    assert who_and_why(quiet) == ["All 3 customers were supplied at all times."]


def test_energy_adds_up() -> None:
    run = small_run()
    rows = {words: float(text.replace(",", "")) for words, text in energy_rows(run, summarise(run))}
    assert rows["Demand"] == 140  # 70 kW for two hours
    assert rows["Demand"] == rows["Supplied"] + rows["Not supplied"]
    assert "Exported" not in rows
    sold = {**summarise(run), "export_kwh": 12.0}
    assert ("Exported", "12") in energy_rows(run, sold)
    bare = small_run(without_devices(small_scenario()))
    assert "PV available" not in dict(energy_rows(bare, summarise(bare)))


def test_limits_that_are_exceeded_say_so() -> None:
    run = small_run()
    lowest, highest, line = limit_rows(run)
    assert (lowest.value, lowest.limit, lowest.exceeded) == ("0.9500 pu", "0.94 pu", False)
    assert highest.what == "Highest voltage"
    assert line.limit == "no line has a rating"
    low = run.buses.assign(v_ac_pu=run.buses["v_ac_pu"].where(run.buses["bus"] != 3, 0.93))
    assert limit_rows(replace(run, buses=low))[0].exceeded
    dark = run.buses.assign(v_ac_pu=np.nan)
    assert limit_rows(replace(run, buses=dark))[0].where == "no live bus"


def test_price_follows_the_scenario(tmp_path: Path) -> None:
    day = replace(small_scenario(), voll_gbp_per_kwh=6.0)
    write_scenario(day, tmp_path / "day")
    assert read_scenario(tmp_path / "day").voll_gbp_per_kwh == 6.0
    words = price_sentence(summarise(small_run(day)))
    assert "55 kWh not supplied at 6 GBP/kWh" in words
    assert words.endswith("given by the scenario or with --voll): £330.")
    assert "London Economics" in price_sentence(summarise(small_run()))


def test_what_the_result_rests_on_is_on_the_first_page() -> None:
    """Each note once: those that do not fit are with the assumptions."""
    notes = [f"Note {i}." for i in range(10)]
    run = small_run(
        replace(small_scenario(), source=Source.of("net.json", "pandapower", notes)),
    )
    run = replace(run, options={**run.options, "mode": "physical", "headroom": 0.1})
    told = foundations(run)
    formers = [words for words in told if words.startswith("In an island ")]
    assert len(formers) == 1 and "10% of the rating stays free as headroom." in formers[0]
    assert any(
        words.startswith("The controller knows when each outage begins and ends") for words in told
    )
    assert any(words.startswith("Made from net.json (pandapower).") for words in told)
    said = [*(words for words in told if "Note" in words), *further_notes(run)]
    assert said == [f"At import: {note}" for note in notes]
    calm = small_run(small_scenario(outage=False))
    assert foundations(calm) == []


def test_the_operating_order_switches_each_customer_when_its_supply_changes(
    tmp_path: Path,
) -> None:
    run = small_run()
    order = operating_order(run)
    served = run.customers["served"].to_numpy(bool).reshape(len(run.steps), -1).copy()
    on = dict.fromkeys(run.scenario.customers.id, True)
    for t, time in enumerate(run.steps["time"].dt.strftime("%Y-%m-%dT%H:%M:%SZ")):
        for row in order[order["time"] == time].itertuples():
            on[row.customer] = row.action == "close"
            assert row.off_kw == pytest.approx(off_kw(run)[t])
        assert list(on.values()) == served[t].tolist()
    write_run(run, tmp_path / "run", figures=False)
    written = pd.read_csv(tmp_path / "run" / "operating_order.csv")
    assert written["customer"].tolist() == order["customer"].tolist()
    lines = shown_orders(run)
    assert len(lines) == order["time"].nunique()
    assert lines[0] == "19 Jul 00:30: open c, b. Off then: 60.0 kW."
    assert off_sentence(run).startswith("Off supply: ")
    kept = replace(run, customers=run.customers.assign(served=True))
    assert operating_order(kept).empty and off_sentence(kept) == "" and shown_orders(kept) == []


# ---------------------------------------------------------------------------------------- clocks


def test_times_are_those_of_the_site_and_of_utc_on_demand(tmp_path: Path) -> None:
    day = small_scenario()
    run = small_run(replace(day, grid=replace(day.grid, zone=LONDON)))
    assert events_of(run)[0].time == "19 Jul 01:30"
    clock = Clock.of(run)
    assert clock.note == "Times are those of Europe/London: UTC+1 h."
    assert clock.heading == "Time (Europe/London)"
    assert clock.full(run.steps["time"].iloc[0]) == "19 Jul 01:00 BST"
    write_run(run, tmp_path / "run", figures=False)
    for options, shown in (((), "from 02:00 to 02:30"), (("--utc",), "from 01:00 to 01:30")):
        assert call("report", tmp_path / "run", *options).exit_code == 0
        assert shown in (tmp_path / "run" / "report.html").read_text()


@pytest.mark.parametrize(
    ("start", "shown", "changes"),
    [
        # Clocks go forward at 01:00 UTC: local time jumps from 01:00 to 02:00.
        (
            "2026-03-29T00:00Z",
            ["00:00 GMT", "02:00 BST", "03:00 BST"],
            "Europe/London: UTC+0 h, UTC+1 h from 29 Mar 02:00.",
        ),
        # Clocks go back at 01:00 UTC: 01:00 comes twice.
        (
            "2026-10-25T00:00Z",
            ["01:00 BST", "01:00 GMT", "02:00 GMT"],
            "Europe/London: UTC+1 h, UTC+0 h from 25 Oct 01:00.",
        ),
    ],
)
def test_days_of_23_and_25_hours(start: str, shown: list[str], changes: str) -> None:
    clock = Clock(TimeGrid(pd.Timestamp(start), 60, 24, LONDON))
    assert [clock.at(t)[len("29 Mar ") :] for t in range(3)] == shown
    assert clock.note == f"Times are those of {changes}"


def test_a_date_is_that_of_the_site_and_is_written_once() -> None:
    clock = Clock(TimeGrid(pd.Timestamp("2026-07-01T20:00Z"), 60, 20, "Asia/Tokyo"))
    assert clock.at(0) == "02 Jul 05:00"
    assert clock.span(0, 2) == "from 02 Jul 05:00 to 07:00"
    assert clock.span(0, 19) == "from 02 Jul 05:00 to 03 Jul 00:00"


# ------------------------------------------------------------------------------------ the answer


def answered(run: Trajectory) -> str:
    return answer(run, summarise(run))


def test_the_answer_comes_first_and_names_who_was_off_and_when() -> None:
    # a, the only critical customer, is off from 01:00 to 01:30; 55 kWh are not supplied.
    run = small_run()
    assert answered(run) == (
        "The only critical customer did not keep supply for all 1 h; a was off from 01:00 to 01:30."
        " 55.0 kWh not supplied."
    )
    page = render_report(run, summarise(run))
    order = [
        "The only critical customer",
        "Grid outage",
        "Operating order",
        "Assumptions that matter",
        "Remarks",
    ]
    places = [page.index(words) for words in order]
    assert places == sorted(places)


def test_the_answer_for_many_customers() -> None:
    run = day_run(day_scenario(), 2600.0)
    served = run.by_step("customers", "served").copy()
    critical = np.flatnonzero(run.scenario.customers.tier == "critical")
    served[:, critical] = True
    count = len(critical)

    def told(*off: tuple[int, slice]) -> str:
        kept = served.copy()
        for customer, steps in off:
            kept[steps, critical[customer]] = False
        changed = run.customers.assign(served=kept.ravel())
        return answered(replace(run, customers=changed)).split(". ")[0]

    names = [str(run.scenario.customers.id[c]) for c in critical]
    assert told() == f"All {count} critical customers kept supply for all 6 h"
    # The hour with grid is not the outage's.
    assert told((0, slice(17, 19))) == (
        f"{count - 1} of {count} critical customers kept supply for all 6 h; "
        f"{names[0]} was off from 17:00 to 18:00"
    )
    many = told(*((c, slice(12, 14 + c)) for c in range(4)))
    assert many.endswith(f"{names[1]} was off from 12:00 to 15:00, 1 more was off in part of it")
    assert told(*((c, slice(12, 13)) for c in range(count))).startswith(f"None of {count} ")
    assert told((0, slice(12, 18, 2))).count(" and ") == 2
    quarter = told(*((0, slice(t, t + 1)) for t in (12, 14, 16)), (0, slice(17, 18)))
    assert quarter.endswith("from 12:00 to 13:00 and from 14:00 to 15:00 and from 16:00 to 18:00")


def test_the_answer_without_an_outage() -> None:
    calm = small_run(small_scenario(outage=False))
    served = calm.customers.assign(served=True)
    assert answered(replace(calm, customers=served)) == (
        "All 3 customers kept supply at all times. All demand was supplied."
    )
    assert answered(calm).startswith("None of 3 customers kept supply at all times; c was off")


def test_what_makes_the_answer_doubtful_stands_below_it() -> None:
    run = small_run(without_devices(small_scenario()))
    run = replace(run, options={**run.options, "mode": "physical"})
    page = render_report(run, summarise(run))
    assert (
        page.index("The only critical") < page.index("No battery can form") < page.index("Grid out")
    )
    assert findings(run)[0].startswith("No battery can form a grid")


def test_nothing_is_minus_zero_or_undefined_and_empty_panels_are_left_out() -> None:
    assert [number(v, "+.2f") for v in (-0.001, 0.001, -0.01)] == ["0.00", "0.00", "-0.01"]
    bare = small_run(without_devices(small_scenario(outage=False)))
    page = render_report(bare, summarise(bare))
    text = re.sub(r"<(script|style|svg).*?</\1>", "", page, flags=re.DOTALL)
    assert not re.search(r"-0(\.0+)?\b(?!\.)|n/a|\bnan\b", text)
    assert "Supplied in the outage" not in text
    assert "Stored energy (kWh)" not in page
    assert ">PV power<" not in page and ">Batteries<" not in page
    assert "Stored energy (kWh)" in render_report(small_run(), summarise(small_run()))


# ------------------------------------------------------------------------------------------- paper


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    write_run(small_run(), tmp_path / "run", figures=False)
    return tmp_path / "run"


def test_another_value_of_lost_load_prices_a_finished_run(run_folder: Path) -> None:
    done = priced(read_finished(run_folder), 2.0)
    assert done.summary["energy_not_supplied_gbp"] == 110.0
    assert done.summary["resilience"] == summarise(small_run())["resilience"]


def test_without_a_browser_nothing_is_begun(
    run_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(run_folder))
    result = call("report", str(run_folder), "--pdf")
    assert result.exit_code == 2
    assert "there is no browser that could print the PDF" in result.stderr
    assert "Install Chromium or Chrome" in result.stderr
    assert not (run_folder / "report.html").exists()


def test_a_browser_that_fails_leaves_the_older_file(tmp_path: Path) -> None:
    broken = tmp_path / "browser"
    broken.write_text("#!/bin/sh\necho 'no display' >&2\nexit 1\n", encoding="utf-8")
    broken.chmod(broken.stat().st_mode | stat.S_IXUSR)
    older = tmp_path / "report.pdf"
    older.write_bytes(b"%PDF-older")
    with pytest.raises(ReportError, match=r"did not print the report \(no display\)"):
        write_pdf("<p>page</p>", older, str(broken))
    assert older.read_bytes() == b"%PDF-older"
    assert [file.name for file in tmp_path.glob("*.part*")] == []


def test_browsers_are_found_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="no browser"):
        find_browser()
    program = tmp_path / "google-chrome"
    program.touch(mode=0o755)
    assert find_browser() == str(program)


@pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="no browser on the path")
def test_the_report_is_printed(run_folder: Path) -> None:
    result = call("report", str(run_folder), "--pdf", "--voll", "2")
    assert result.exit_code == 0, result.stderr
    printed = run_folder / "report.pdf"
    assert f"Written to {printed}" in result.stdout
    content = printed.read_bytes()
    assert content.startswith(b"%PDF-")
    assert content.rstrip().endswith(b"%%EOF")
    assert 2 <= len(re.findall(rb"/MediaBox", content)) <= 12
    assert "at 2 GBP/kWh" in (run_folder / "report.html").read_text(encoding="utf-8")
