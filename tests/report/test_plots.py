"""Figures show what the tables hold."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.support.made_up_runs import (
    OPTIONS,
    SERVED,
    day_run,
    day_scenario,
    small_run,
    small_scenario,
)
from tests.support.made_up_runs import without_devices as bare
from vppres.day import series
from vppres.report.plots.axes import TimeAxis, ValueAxis, range_of, round_values, time_step_min
from vppres.report.plots.chart import Band, Chart, Curve, Curves, Limit
from vppres.report.plots.drawing import (
    BLUE,
    CIVIDIS,
    RUN_STYLES,
    Canvas,
    Style,
    blend,
    coloured,
    path_of,
)
from vppres.report.plots.figures import (
    FIGURES,
    RUN_FIGURES,
    energy_and_price,
    feeder_maps,
    import_load_pv,
    line_loadings,
    save_figures,
    service_by_tier,
    timeline,
    voltages,
)
from vppres.report.plots.rows import MAX_NAMED_CUSTOMERS, Tiles, tile_rows
from vppres.scenario.network import Network


def curve(chart: Chart, panel: int, name: str) -> Curve:
    """The one curve of a panel with the given name."""
    found = [entry for entry in chart.panels[panel].curves if entry.name == name]
    assert len(found) == 1
    return found[0]


def texts(chart: Chart) -> list[str]:
    return re.findall(r"<text[^>]*>(.*?)</text>", chart.svg())


# What is drawn.


def test_outage_spans_are_half_open_ranges_of_steps():
    run = small_run()
    assert series.outage_spans(run) == [(1, 3)]
    split = replace(run, steps=run.steps.assign(outage=[True, False, False, True]))
    assert series.outage_spans(split) == [(0, 1), (3, 4)]
    none = replace(run, steps=run.steps.assign(outage=False))
    assert series.outage_spans(none) == []


def test_stored_energy_by_hand():
    run = small_run()
    charged = replace(
        run,
        batteries=run.batteries.assign(
            soc_start=[0.2, 0.3, 0.4, 0.5], soc_end=[0.3, 0.4, 0.5, 0.6]
        ),
    )
    assert series.stored_energy_kwh(charged) == pytest.approx([20, 30, 40, 50, 60])


def test_served_power_by_hand():
    assert series.served_kw(small_run()).tolist() == [70.0, 10.0, 20.0, 70.0]


def test_voltages_of_power_flow_and_optimisation():
    chart = voltages(small_run())
    ac = curve(chart, 0, "MPC, H = 5 h: lowest, AC power flow")
    assert ac.values == pytest.approx([0.98, 0.97, 0.96, 0.95])
    model = curve(chart, 0, "MPC, H = 5 h: lowest, optimisation")
    assert model.values == pytest.approx([0.99] * 4)
    limits = [limit.name for limit in chart.panels[0].limits]
    assert limits == ["0.947 pu, optimisation limit", "0.94 pu, AC limit"]
    assert {*limits, "outage"} <= {*texts(chart)}


def test_a_tile_and_a_cross_for_every_customer_and_step():
    tiles = service_by_tier(small_run()).panels[0]
    assert isinstance(tiles, Tiles)
    # Customers in the order of the tiers: a (critical), b, c (low).
    assert tiles.rows_of.share.astype(bool).tolist() == np.transpose(SERVED).tolist()
    crosses = re.findall(r'<path d="([^"]*)"[^>]*stroke="#FFFFFF" stroke-width="1.2"', tiles_svg())
    assert crosses[0].count("M") == 2 * int(np.sum(~np.array(SERVED, dtype=bool)))


def tiles_svg() -> str:
    return service_by_tier(small_run()).svg()


def test_tiers_are_named_with_their_share_in_the_outage():
    found = texts(service_by_tier(small_run()))
    for words in ("critical (1)", "50% supplied", "low (2)", "25% supplied", "in outage", "outage"):
        assert words in found


def test_customers_are_named_while_there_is_room():
    def names(n_customers: int) -> int:
        return len(service_by_tier(day_run(day_scenario(n_customers))).panels[0].names)

    assert (names(32), names(MAX_NAMED_CUSTOMERS + 1)) == (32, 0)


@pytest.mark.parametrize("draw", FIGURES.values(), ids=FIGURES)
def test_runs_are_told_apart_without_colour(draw):
    chart = draw({"one": small_run(), "two": small_run()})
    found = " ".join(texts(chart))
    assert "one" in found
    assert "two" in found
    if draw is service_by_tier:
        assert len(chart.panels) == 4
        return
    drawn = {entry.style for entry in chart.panels[0].curves}
    assert {*RUN_STYLES[:2]} <= drawn


def test_a_plan_is_drawn_beside_what_happened():
    run = replace(
        small_run(planned={"served": SERVED, "energy_kwh": [15.0, 20, 30, 20, 15]}),
        options=OPTIONS | {"controller": "full-horizon"},
    )
    chart = energy_and_price(run)
    planned = curve(chart, 0, "full horizon: planned").values
    assert planned == pytest.approx([15, 20, 30, 20, 15])
    assert curve(chart, 0, "full horizon").values == pytest.approx([15] * 5)


def test_what_is_not_served_is_hatched_for_one_run_alone():
    run = small_run()
    (band,) = import_load_pv(run).panels[1].bands
    assert (band.upper - band.lower).tolist() == [0.0, 60.0, 50.0, 0.0]
    assert import_load_pv({"one": run, "two": run}).panels[1].bands == ()


def test_few_customers_have_a_row_each_and_many_share_rows(monkeypatch):
    rows = tile_rows(small_run())
    assert rows.names == ["a", "b", "c"]
    assert rows.tiers == ["critical", "low", "low"]
    assert rows.share.tolist() == np.array(SERVED, dtype=float).T.tolist()
    monkeypatch.setattr("vppres.report.plots.rows.MAX_ROWS", 2)
    rows = tile_rows(small_run())
    assert rows.names == ["a", "b c"]
    assert rows.share.tolist() == [[1, 1, 0, 1], [1, 0, 0.5, 1]]


def test_the_strips_tell_outage_service_and_phases():
    run = small_run()
    run = replace(run, steps=run.steps.drop(columns="phase"))  # as records of old have none
    (strips,) = timeline(run).panels
    assert [strip.name for strip in strips.strips] == [
        "Grid",
        "Batteries",
        "PV power",
        "Off supply",
        "kW off",
    ]
    assert [look[2] for look in strips.strips[-2].looks] == ["", "2", "2", ""]
    assert [look[2] for look in strips.strips[-1].looks] == ["", "60", "50", ""]
    named = replace(run, steps=run.steps.assign(phase=["ready", "hold", "hold", "ready"]))
    found = texts(timeline(named))
    assert found.count("ready") == 2
    assert found.count("hold") == 1
    assert found.count("2") == 2


def test_maps_follow_the_feeder():
    net = Network([1, 2, 3, 2], [2, 3, 4, 5], [0.1] * 4, [0.1] * 4, slack_bus=1, base_kv=11.0)
    day = replace(small_scenario(), network=net)
    buses, lines = feeder_maps(small_run(day)).panels
    assert buses.names == ["1", "2", "3", "4", "5"]
    assert lines.names == ["2", "3", "4", "5"]
    assert lines.axis == "Line, by the bus that it feeds"


def test_line_loading_is_in_per_cent_where_lines_have_ratings():
    day = small_scenario()
    run = small_run(day)
    run = replace(run, lines=run.lines.assign(p_ac_kw=100.0, q_ac_kvar=0.0))
    assert line_loadings(run).panels[0].axis == "Largest line\ncurrent (A)"
    net = Network(
        [1, 2, 3],
        [2, 3, 4],
        [0.1] * 3,
        [0.1] * 3,
        slack_bus=1,
        base_kv=11.0,
        i_max_a=[10.0, np.inf, np.inf],
    )
    chart = line_loadings(replace(run, scenario=replace(day, network=net)))
    assert chart.panels[0].axis == "Largest line\nloading (%)"
    full = 100.0 * 100.0 / (np.sqrt(3.0) * 11.0) / 10.0
    assert curve(chart, 0, "MPC, H = 5 h").values == pytest.approx([full] * 4)


# Files.


@pytest.mark.parametrize(("run", "kinds"), [
    (small_run(bare(small_scenario())), ("png", "svg")),
    (small_run(small_scenario(outage=False)), ("svg",)),
], ids=["no devices", "no outage"])  # fmt: skip
def test_figures_of_days_without_devices_or_outage(run, kinds, tmp_path):
    files = save_figures(run, tmp_path, kinds)
    assert [file.name for file in files] == [
        f"{name}.{kind}" for name in [*FIGURES, *RUN_FIGURES] for kind in kinds
    ]
    assert all(file.stat().st_size > 1000 for file in files)
    assert all("nan" not in file.read_text() for file in files if file.suffix == ".svg")


@pytest.mark.nightly
def test_equal_runs_give_equal_files(tmp_path):
    first = save_figures(small_run(), tmp_path / "first")
    second = save_figures(small_run(), tmp_path / "second")
    for one, two in zip(first, second, strict=True):
        assert one.read_bytes() == two.read_bytes()


# How it is drawn.


def test_steps_hold_to_their_end_and_instants_are_joined():
    run = small_run()
    panel = Curves("kW", [Curve("a", np.array([0.0, 1.0, 1.0, 0.0]), Style(BLUE))], 100.0, 0.0, 1.0)
    steps = Chart("steps", "", run, [panel])
    left, right = steps.time.left, steps.time.right
    (top, bottom) = (steps.frames()[0].top, steps.frames()[0].bottom)
    quarter = (right - left) / 4
    path = path_of(
        [
            (left, bottom),
            (left + quarter, bottom),
            (left + quarter, top),
            (left + 2 * quarter, top),
            (left + 2 * quarter, top),
            (left + 3 * quarter, top),
            (left + 3 * quarter, bottom),
            (right, bottom),
        ]
    )
    assert f'd="{path}"' in steps.svg()
    energy = Curve("e", np.array([0.0, 1.0, 0.0, 1.0, 0.0]), Style(BLUE))
    joined = Chart("joined", "", run, [replace(panel, curves=[energy])])
    points = zip(np.linspace(left, right, 5), [bottom, top, bottom, top, bottom], strict=True)
    assert f'd="{path_of(points)}"' in joined.svg()


def test_what_is_not_known_interrupts_a_curve_and_a_band():
    values = np.array([1.0, np.nan, 1.0, 2.0])
    panel = Curves(
        "",
        [Curve("a", values, Style(BLUE))],
        100.0,
        bands=[Band(values, values + 1.0, BLUE, "between")],
    )
    svg = Chart("gap", "", small_run(), [panel]).svg()
    assert "nan" not in svg
    assert svg.count('fill="url(#gap-lines-0072B2)"') == 2 + 1  # two stretches, and the legend
    assert path_of([(0, 1), (1, np.nan), (2, 3)]) == "M0 1M2 3"


def test_values_lie_where_they_belong():
    axis = ValueAxis(0.0, 10.0, 200.0, 100.0)
    assert axis(np.array([0.0, 5.0, 10.0])).tolist() == [200.0, 150.0, 100.0]
    decades = ValueAxis(1e-9, 1e-3, 60.0, 0.0, logarithmic=True)
    assert decades(np.array([0.0, 1e-9, 1e-6])) == pytest.approx([60.0, 60.0, 30.0])
    assert np.isnan(decades(np.array([np.nan]))[0])
    assert next(name for _, name in decades.ticks()) == "1e\N{MINUS SIGN}9"


def test_outages_lie_where_they_were():
    axis = TimeAxis(small_run(), 100.0, 500.0)
    assert axis.outages == [(200.0, 400.0)]
    assert axis.ticks()[0] == (100.0, "00:00")
    assert "from 19 July 2022" in axis.title


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.0, 4700.0), (0.9401, 0.9402), (1e-7, 3)])
def test_ticks_are_round_few_and_inside(low, high):
    ticks = round_values(low, high)
    assert 2 <= len(ticks) <= 6
    assert low - 1e-9 <= ticks[0] < ticks[-1] <= high + 1e-9


@pytest.mark.parametrize("minutes", [5, 60, 24 * 60, 2880, 7 * 1440, 366 * 1440])
def test_times_have_room(minutes):
    assert 1 <= minutes / time_step_min(minutes) <= 13


def test_a_constant_has_a_range():
    low, high = range_of([np.full(4, 5.0)], None, None, logarithmic=False)
    assert low < 5.0 < high


def test_limits_are_within_the_axis():
    values = np.array([1.0, 1.01, 1.02, 1.0])
    panel = Curves("", [Curve("a", values, Style(BLUE))], 100.0, limits=[Limit(0.94, "limit")])
    assert "limit" in texts(Chart("limit", "", small_run(), [panel]))
    assert panel._range[0] < 0.94


def test_colours_of_a_scale():
    assert coloured(CIVIDIS, 0.0) == "#00224e"
    assert coloured(CIVIDIS, 1.0) == "#fee838"
    assert blend(("#000000", "#FFFFFF"), np.array([0.5, np.nan])).tolist() == [
        [128, 128, 128],
        [255, 255, 255],
    ]


def test_texts_of_others_are_text():
    canvas = Canvas("x")
    canvas.text(0, 0, "<b>&")
    assert "&lt;b&gt;&amp;" in canvas.svg(10, 10, '"<x>')
    assert 'aria-label="&#34;&lt;x&gt;"' in canvas.svg(10, 10, '"<x>')


def test_pointers_read_what_is_drawn():
    data = energy_and_price(small_run()).data()
    by_name = {reading["name"]: reading["values"] for reading in data["curves"]}
    assert by_name["Stored energy (kWh)"] == ["15"] * 5
    assert data["steps"] == 4
    (rows,) = service_by_tier(small_run()).data()["rows"]
    assert (rows["of"], rows["each"]) == ("customers", [[0], [1], [2]])
    (buses, lines) = feeder_maps(small_run()).data()["rows"]
    assert (buses["of"], lines["of"], lines["each"]) == ("buses", "lines", [[0], [1], [2]])
    strips = timeline(small_run()).data()["curves"]
    assert [(one["name"], one["values"]) for one in strips] == [
        ("Off supply", ["0", "2", "2", "0"]),
        ("kW off", ["0", "60", "50", "0"]),
    ]
