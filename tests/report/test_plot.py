"""``vppres.plot`` shows what the tables hold, in Axes that are labelled."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.collections import FillBetweenPolyCollection
from matplotlib.dates import num2date
from matplotlib.lines import Line2D

import vppres
from tests.support.made_up_runs import OPTIONS, SERVED, day_run, day_scenario, small_run
from vppres.core.errors import InputError
from vppres.day.trajectory import Trajectory

ONE_PANEL = ("supply", "energy", "voltages", "feeder", "compare")
OF_SEVERAL = ("supply", "energy", "voltages", "compare")


@pytest.fixture(autouse=True)
def figures() -> Iterator[None]:
    pyplot.switch_backend("agg")
    yield
    pyplot.close("all")


def line(ax: Axes, label: str) -> Line2D:
    """The one line of a picture with a label."""
    (found,) = [entry for entry in ax.lines if entry.get_label() == label]
    return found


def legend_of(ax: Axes) -> list[str]:
    found = ax.get_legend()
    return [text.get_text() for text in found.get_texts()]


def day_ahead(hours: float, served: float = 2400.0) -> Trajectory:
    """The made-up day, as if it had been planned so far ahead."""
    return replace(day_run(day_scenario(), served), options=OPTIONS | {"horizon_h": hours})


@pytest.mark.parametrize("kind", ONE_PANEL)
def test_a_picture_has_labels_with_units_and_a_legend(kind: str) -> None:
    ax = small_run().plot(kind)
    assert ax.get_xlabel()
    assert legend_of(ax)
    assert kind == "feeder" or "(" in ax.get_ylabel()
    ax.figure.savefig("/dev/null", format="svg")


@pytest.mark.parametrize("kind", OF_SEVERAL)
def test_several_runs_are_told_apart_without_colour(kind: str) -> None:
    runs = {str(n): small_run() for n in range(5)}
    ax = getattr(vppres.plot, kind)(runs)
    words = " ".join(legend_of(ax))
    assert all(label in words for label in runs)
    if kind == "compare":
        looks: list[Any] = [bars[0].get_hatch() for bars in ax.containers]
    else:
        thick = [entry for entry in ax.lines if entry.get_linewidth() > 1.35]
        firsts = [next(x for x in thick if str(x.get_label()).startswith(n)) for n in runs]
        looks = [(x.get_linewidth(), str(x.get_linestyle()), str(x._dash_pattern)) for x in firsts]
    assert len({str(look) for look in looks}) == 5


def test_the_axes_that_are_given_are_drawn_into() -> None:
    _, (left, right) = pyplot.subplots(1, 2)
    assert vppres.plot.energy(small_run(), ax=left) is left
    assert vppres.plot.compare([small_run()], right) is right
    assert len(pyplot.get_fignums()) == 1


def test_supply_is_stacked_up_to_what_was_served() -> None:
    run = small_run()
    ax = run.plot("supply")
    areas = [x for x in ax.collections if isinstance(x, FillBetweenPolyCollection)]
    tops = {str(x.get_label()): x.get_paths()[0].vertices[:, 1].max() for x in areas}
    # 12 kW of PV with 1 kW curtailed; the grid gives the rest of 70 kW; 60 kW are off in step 1.
    assert tops == pytest.approx({"PV": 11.0, "grid": 70.0, "not supplied": 70.0})
    assert line(ax, "demand").get_ydata()[:-1].tolist() == [70.0] * 4


def test_energy_has_the_plan_and_the_limits() -> None:
    planned = {"served": SERVED, "energy_kwh": [15.0, 20, 30, 20, 15]}
    run = replace(small_run(planned=planned), options=OPTIONS | {"controller": "full-horizon"})
    ax = run.plot("energy")
    assert list(line(ax, "full horizon").get_ydata()) == pytest.approx([15.0] * 5)
    assert list(line(ax, "full horizon: planned").get_ydata()) == planned["energy_kwh"]
    assert {"upper SoC limit", "lower SoC limit"} <= {*legend_of(ax)} and not ax.texts


def test_limits_of_voltage_are_named_in_the_legend() -> None:
    ax = small_run().plot("voltages")
    network = small_run().scenario.network
    for words, value in (("optimisation", network.v_min_pu), ("AC", network.v_min_ac_pu)):
        name = f"{value:g} pu, {words} limit"
        assert name in legend_of(ax) and set(line(ax, name).get_ydata()) == {value}
    assert not ax.texts


def test_each_kind_of_unit_has_its_mark_in_the_feeder() -> None:
    site = vppres.load_scenario("village-hot-week")
    ax = vppres.plot.feeder(site)
    legend = ax.get_legend()
    looks = {
        text.get_text().partition(" (")[0]: (
            mark.get_facecolor().tolist(),
            mark.get_paths()[0].vertices.tolist(),
        )
        for text, mark in zip(legend.get_texts(), legend.legend_handles, strict=True)
    }
    kinds = ("vehicles", "thermal loads", "generating sets")
    assert len({str(looks[name]) for name in kinds}) == 3


def test_times_are_those_of_the_clock_on_the_site() -> None:
    run = small_run()
    grid = replace(run.scenario.grid, zone="Europe/London")
    ax = replace(run, scenario=replace(run.scenario, grid=grid)).plot("voltages")
    assert ax.get_xlabel() == "Time (Europe/London), from 19 July 2022"
    ax.figure.draw_without_rendering()
    first = ax.get_xticklabels()[0].get_text()
    assert num2date(ax.get_xticks()[0], tz="Europe/London").strftime("%H:%M") == first == "01:00"


def test_a_day_and_a_scenario_have_their_panels() -> None:
    run = day_run(day_scenario())
    supply, service, energy = run.plot()
    assert supply.get_ylabel() == "Power (kW)"
    assert {"critical", "high", "low", "outage"} == {*legend_of(service)}
    assert energy.get_ylabel() == "Stored energy (kWh)"
    feeder, series = run.scenario.plot()
    assert "batteries (32)" in legend_of(feeder)
    critical = run.scenario.customers.tier == "critical"
    drawn = line(series, f"demand, critical ({critical.sum()})").get_ydata()
    assert drawn[:-1] == pytest.approx(run.scenario.load_kw[:, critical].sum(axis=1))


def test_customers_off_supply_are_crossed_out_in_the_step_that_is_shown() -> None:
    def crosses(**options: Any) -> int:
        ax = small_run().plot("feeder", **options)
        drawn = [x for x in ax.collections if len(x.get_offsets()) and x.get_sizes()[0] == 56]
        return sum(len(x.get_offsets()) for x in drawn)

    assert crosses(time="2022-07-19T00:00Z") == 0
    assert crosses(time="2022-07-19T00:30Z") == 2
    assert crosses() == 2


def test_a_figure_against_the_horizon() -> None:
    plan = replace(day_run(day_scenario()), options=OPTIONS | {"controller": "full-horizon"})
    runs = [day_ahead(6.0), plan, day_ahead(2.0, 1800.0)]
    ax = vppres.plot.horizon(runs, "served_share.high")
    found = [vppres.summarise(run)["served_share"]["high"] for run in (runs[2], runs[0])]
    assert line(ax, "MPC").get_xydata().tolist() == [[2.0, found[0]], [6.0, found[1]]]
    assert line(ax, "full horizon").get_ydata()[0] == found[1] > found[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("Prediction horizon H (h)", "served share, high")
    assert vppres.plot.horizon(runs, "cost_gbp").get_ylabel() == "Cost of imported energy (GBP)"


def test_bars_are_the_shares_supplied_in_the_outage() -> None:
    ax = vppres.plot.compare([small_run(), small_run()])
    assert legend_of(ax) == ["MPC, H = 5 h", "MPC, H = 5 h (2)"]
    heights = [[bar.get_height() for bar in bars] for bars in ax.containers]
    assert heights == [pytest.approx([50.0, 25.0])] * 2


@pytest.mark.parametrize(("draw", "words"), [
    (lambda run: run.plot("week"), "kind = week: is no picture of a run"),
    (lambda run: run.plot(ax=[]), "ax = 0: needs 3 Axes"),
    (lambda run: run.plot("feeder", time="2022-07-19T00:31Z"), "is not the beginning of a step"),
    (lambda run: vppres.plot.horizon(run, "cost"), "value = cost: is no number of the run's summary"),
    (lambda run: vppres.plot.energy([run] * 6), "runs = 6: draws 1 to 5 runs in one picture"),
    (lambda run: vppres.plot.energy([]), "runs = 0: draws 1 to 5 runs in one picture"),
])  # fmt: skip
def test_what_cannot_be_drawn_says_so(draw: Callable[[Trajectory], Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        draw(small_run())


def test_many_buses_without_devices() -> None:
    scenario = day_scenario(90)
    ax = vppres.plot.feeder(scenario)
    assert len(ax.texts) == 0
    assert np.isfinite(ax.get_ylim()).all()


@pytest.mark.nightly
def test_matplotlib_is_loaded_on_use() -> None:
    code = (
        "import sys, vppres; vppres.Scenario, vppres.Trajectory; print('matplotlib' in sys.modules);"
        "vppres.plot; print('matplotlib' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]
