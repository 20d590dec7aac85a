"""Figures show what the tables hold."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.support.made_up_runs import (
    OPTIONS,
    SERVED,
    day_run,
    day_scenario,
    small_run,
    small_scenario,
)
from tests.support.made_up_runs import without_devices as bare
from vppres.report import plots
from vppres.report.plots.service import tile_rows
from vppres.scenario.network import Network


def line(figure: Figure, panel: int, label: str):
    """The one line of a panel with the given label."""
    found = [entry for entry in figure.axes[panel].get_lines() if entry.get_label() == label]
    assert len(found) == 1
    return found[0]


def legend_texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_outage_spans_are_half_open_ranges_of_steps():
    run = small_run()
    assert plots.outage_spans(run) == [(1, 3)]
    split = replace(run, steps=run.steps.assign(outage=[True, False, False, True]))
    assert plots.outage_spans(split) == [(0, 1), (3, 4)]
    none = replace(run, steps=run.steps.assign(outage=False))
    assert plots.outage_spans(none) == []


def test_stored_energy_by_hand():
    run = small_run()
    charged = replace(
        run,
        batteries=run.batteries.assign(
            soc_start=[0.2, 0.3, 0.4, 0.5], soc_end=[0.3, 0.4, 0.5, 0.6]
        ),
    )
    assert plots.stored_energy_kwh(charged) == pytest.approx([20, 30, 40, 50, 60])


def test_served_power_by_hand():
    assert plots.served_kw(small_run()).tolist() == [70.0, 10.0, 20.0, 70.0]


def test_steps_hold_to_the_end_of_the_last_step():
    drawn = line(plots.voltages(small_run()), 0, "MPC, H = 5 h: AC power flow")
    assert drawn.get_drawstyle() == "steps-post"
    assert drawn.get_ydata() == pytest.approx([0.98, 0.97, 0.96, 0.95, 0.95])
    beginning, end = drawn.get_xdata()[[0, -1]]
    assert (end - beginning).total_seconds() == 4 * 30 * 60


def test_voltage_figure_names_both_limits():
    texts = [text.get_text() for text in plots.voltages(small_run()).axes[0].texts]
    assert texts == ["outage", "0.947 optimisation limit", "0.94 AC limit"]


def test_the_model_voltage_is_drawn_beside_the_ac_voltage():
    drawn = line(plots.voltages(small_run()), 0, "MPC, H = 5 h: optimisation")
    assert drawn.get_ydata() == pytest.approx([0.99] * 5)


def test_a_tile_and_a_cross_for_every_customer_and_step():
    tiles = plots.service_by_tier(small_run()).axes[0]
    mesh, crosses = tiles.collections
    # Customers in the order of the tiers: a (critical), b, c (low).
    assert (
        np.asarray(mesh.get_array()).reshape(3, 4).astype(bool).tolist()
        == np.transpose(SERVED).tolist()
    )
    assert len(crosses.get_offsets()) == 4


def test_tiers_are_named_with_their_share_in_the_outage():
    texts = [text.get_text() for text in plots.service_by_tier(small_run()).axes[0].texts]
    assert texts == [
        "critical (1)\n50% served\nin outage",
        "low (2)\n25% served\nin outage",
        "outage",
    ]


def test_customers_are_named_while_there_is_room():
    def names(n_customers: int) -> int:
        run = day_run(day_scenario(n_customers))
        return len(plots.service_by_tier(run).axes[0].get_yticks())

    assert (names(32), names(plots.MAX_NAMED_CUSTOMERS + 1)) == (32, 0)


@pytest.mark.parametrize("draw", plots.FIGURES.values(), ids=plots.FIGURES)
def test_runs_are_told_apart_without_colour(draw):
    runs = {"one": small_run(), "two": small_run()}
    figure = draw(runs)
    if draw is plots.service_by_tier:
        assert [ax.get_title(loc="left") for ax in figure.axes[:2]] == ["one", "two"]
        return
    drawn = [
        [entry for entry in figure.axes[0].get_lines() if entry.get_color() == style.color]
        for style in plots.RUN_STYLES[:2]
    ]
    assert drawn[0][0].get_marker() != drawn[1][0].get_marker()
    assert any("one" in text for text in legend_texts(figure))
    assert any("two" in text for text in legend_texts(figure))


def test_a_plan_is_drawn_beside_what_happened():
    run = replace(
        small_run(planned={"served": SERVED, "energy_kwh": [15.0, 20, 30, 20, 15]}),
        options=OPTIONS | {"controller": "full-horizon"},
    )
    figure = plots.energy_and_price(run)
    assert line(figure, 0, "full horizon: planned").get_ydata() == pytest.approx(
        [15, 20, 30, 20, 15]
    )
    assert line(figure, 0, "full horizon").get_ydata() == pytest.approx([15] * 5)


@pytest.mark.parametrize(
    "run",
    [small_run(bare(small_scenario())), small_run(small_scenario(outage=False))],
    ids=["no devices", "no outage"],
)
def test_figures_of_days_without_devices_or_outage(run, tmp_path):
    files = plots.save_figures(run, tmp_path)
    assert [file.name for file in files] == [
        f"{name}.{kind}" for name in [*plots.FIGURES, *plots.RUN_FIGURES] for kind in ("png", "svg")
    ]
    assert all(file.stat().st_size > 1000 for file in files)


def test_equal_runs_give_equal_svg_files(tmp_path):
    first = plots.save_figures(small_run(), tmp_path / "first")
    second = plots.save_figures(small_run(), tmp_path / "second")
    for one, two in zip(first, second, strict=True):
        assert one.read_bytes() == two.read_bytes()


def test_drawing_leaves_pyplot_alone():
    code = "import sys, vppres.report.plots; print('matplotlib.pyplot' in sys.modules)"
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == "False"


def test_few_customers_have_a_row_each_and_many_share_rows(monkeypatch):
    rows = tile_rows(small_run())
    assert rows.names == ["a", "b", "c"]
    assert rows.tiers == ["critical", "low", "low"]
    assert rows.share.tolist() == np.array(SERVED, dtype=float).T.tolist()
    monkeypatch.setattr("vppres.report.plots.service.MAX_ROWS", 2)
    rows = tile_rows(small_run())
    assert rows.names == ["a", "b c"]
    assert rows.share.tolist() == [[1, 1, 0, 1], [1, 0, 0.5, 1]]


def test_large_maps_are_images_within_the_svg(tmp_path, monkeypatch):
    monkeypatch.setattr("vppres.report.plots.service.RASTER_ABOVE", 3)
    plots.save_figure(plots.service_by_tier(small_run()), tmp_path / "many")
    assert "<image" in (tmp_path / "many.svg").read_text(encoding="utf-8")


def test_the_strips_tell_outage_service_and_phases():
    run = small_run()
    run = replace(run, steps=run.steps.drop(columns="phase"))  # as records of old have none
    labels = [text.get_text() for text in plots.timeline(run).axes[0].get_yticklabels()]
    assert labels == ["Grid", "Batteries", "PV power", "Not served"]
    assert {text.get_text() for text in plots.timeline(run).axes[0].texts} == {"2"}
    named = replace(run, steps=run.steps.assign(phase=["ready", "hold", "hold", "ready"]))
    ax = plots.timeline(named).axes[0]
    assert ax.get_yticklabels()[0].get_text() == "Phase"
    assert [text.get_text() for text in ax.texts][:3] == ["ready", "hold", "ready"]


def test_maps_follow_the_feeder():
    net = Network([1, 2, 3, 2], [2, 3, 4, 5], [0.1] * 4, [0.1] * 4, slack_bus=1, base_kv=11.0)
    day = replace(small_scenario(), network=net)
    buses, lines, *_ = plots.feeder_maps(small_run(day)).axes
    assert [text.get_text() for text in buses.get_yticklabels()] == ["1", "2", "3", "4", "5"]
    assert [text.get_text() for text in lines.get_yticklabels()] == ["2", "3", "4", "5"]
    assert lines.get_ylabel() == "Line, by the bus that it feeds"


def test_line_loading_is_in_per_cent_where_lines_have_ratings():
    day = small_scenario()
    run = small_run(day)
    run = replace(run, lines=run.lines.assign(p_ac_kw=100.0, q_ac_kvar=0.0))
    assert plots.line_loadings(run).axes[0].get_ylabel() == "Largest line\ncurrent (A)"
    net = Network(
        [1, 2, 3],
        [2, 3, 4],
        [0.1] * 3,
        [0.1] * 3,
        slack_bus=1,
        base_kv=11.0,
        i_max_a=[10.0, np.inf, np.inf],
    )
    rated = replace(run, scenario=replace(day, network=net))
    figure = plots.line_loadings(rated)
    assert figure.axes[0].get_ylabel() == "Largest line\nloading (%)"
    full = 100.0 * 100.0 / (np.sqrt(3.0) * 11.0) / 10.0
    assert line(figure, 0, "MPC, H = 5 h").get_ydata() == pytest.approx([full] * 5)
