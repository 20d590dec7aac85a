"""A researcher's half hour without a file: load, change, run, look, draw, compare."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

import vppres
from tests.support.made_up_runs import small_run, small_scenario
from tests.support.refusals import refusal
from tests.support.tiny_day import tiny_scenario
from vppres.core.errors import InputError
from vppres.io import packaged_scenarios, read_scenario, scenario_digest, write_scenario
from vppres.scenario.scenario import Scenario

Tables = dict[str, Any]
IDLE = vppres.RunOptions(controller="idle")


def test_a_researchers_half_hour(tiny: Scenario) -> None:
    pyplot.switch_backend("agg")
    battery, customer = tiny.batteries.id[0], tiny.customers.id[-1]
    energy_kwh = 2.0 * tiny.batteries.energy_kwh[0]
    changed = tiny.replace("batteries", battery, energy_kwh=energy_kwh).replace(
        "customers", customer, tier=tiny.tiers[0]
    )
    assert changed.batteries.energy_kwh[0] == energy_kwh
    assert changed.customers.tier[-1] == tiny.tiers[0]
    first = tiny.customers.tier == tiny.tiers[0]
    assert changed.customers.weight[-1] == tiny.customers.weight[first][0]
    runs = {name: vppres.run_day(day, IDLE) for name, day in {"was": tiny, "is": changed}.items()}
    assert runs["is"].t.soc.shape == (tiny.grid.n_steps + 1, len(tiny.batteries))
    assert runs["is"].t.served[customer].sum() >= runs["was"].t.served[customer].sum()
    ax = vppres.plot.compare(runs)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["was", "is"]
    runs["is"].plot("energy", ax=pyplot.subplots()[1])
    changed.plot()
    pyplot.close("all")


@pytest.mark.parametrize("name", packaged_scenarios())
def test_a_scenario_is_made_of_its_tables_again(name: str) -> None:
    day = vppres.load_scenario(name)
    assert scenario_digest(Scenario.from_tables(day.to_tables())) == scenario_digest(day)


def spoilt(spoil: Callable[[Tables], None]) -> Tables:
    tables = tiny_scenario().to_tables()
    spoil(tables)
    return tables


def negative(tables: Tables) -> None:
    tables["batteries"].loc[0, "energy_kwh"] = -5.0
    tables["batteries"]["energy"] = 1.0


def another_tier(tables: Tables) -> None:
    tables["customers"].loc[0, "tier"] = "crit"


def gap_in_time(tables: Tables) -> None:
    tables["load_kw"] = tables["load_kw"].drop(index=2)


def no_steps(tables: Tables) -> None:
    del tables["scenario"]["time"]["steps"]


def no_lines(tables: Tables) -> None:
    del tables["lines"]


@pytest.mark.parametrize("spoil", [negative, another_tier, gap_in_time, no_steps, no_lines])
def test_tables_are_refused_with_the_words_for_a_folder(
    spoil: Callable[[Tables], None], tmp_path: Path
) -> None:
    import tomli_w

    tables = spoilt(spoil)
    write_scenario(tiny_scenario(), tmp_path / "day")
    (tmp_path / "day" / "scenario.toml").write_text(tomli_w.dumps(tables["scenario"]))
    for file in (tmp_path / "day").glob("*.csv"):
        if file.stem in tables:
            tables[file.stem].to_csv(file, index=False)
        else:
            file.unlink()
    with pytest.raises(InputError) as of_folder:
        read_scenario(tmp_path / "day")
    assert refusal(Scenario.from_tables, tables) == str(of_folder.value)


def test_times_and_flags_may_be_those_of_pandas(tiny: Scenario) -> None:
    tables = tiny.to_tables()
    for name in ("load_kw", "pv_kw", "system"):
        frame = tables[name].set_index("time")
        tables[name] = frame.set_axis(pd.DatetimeIndex(frame.index, name="when"))
    tables["batteries"]["grid_forming"] = np.ones(len(tiny.batteries), dtype=bool)
    tables["scenario"]["time"]["start"] = pd.Timestamp(tables["scenario"]["time"]["start"])
    tables["scenario"]["time"]["steps"] = np.int64(tiny.grid.n_steps)
    tables["customers"] = tables["customers"].to_dict("records")
    made = Scenario.from_tables(tables)
    assert made.formers.all()
    np.testing.assert_array_equal(made.load_kw, tiny.load_kw)


def test_what_is_not_there_is_not_changed(tiny: Scenario) -> None:
    battery = str(tiny.batteries.id[0])
    for call, words in (
        (lambda: tiny.replace("batteries", "x", energy_kwh=1), "batteries, id = x: is not in the"),
        (lambda: tiny.replace("battery", battery), "Did you mean batteries?"),
        (lambda: tiny.replace("load_kw", battery), "is no table of this scenario with names"),
        (lambda: tiny.replace("batteries", battery, energy=1), "energy: is not a known column"),
        (lambda: Scenario.from_tables({"customer": []}), "Did you mean customers?"),
    ):
        assert words in refusal(call)


def test_rows_without_an_identifier_are_named_by_their_bus(tiny: Scenario) -> None:
    bus = tiny.network.to_bus[-1]
    made = tiny.replace("lines", bus, r_ohm=0.75)
    at = [str(name) for name in made.network.to_bus].index(str(bus))
    assert made.network.r_ohm[at] == 0.75


def test_a_weight_of_its_own_stays() -> None:
    day = small_scenario()  # of the tier low b has the weight 0.1, and c one of its own, 0.2
    assert day.replace("customers", "c", tier="critical").customers.weight.tolist() == [1, 0.1, 0.2]
    assert day.replace("customers", "b", tier="critical").customers.weight.tolist() == [1, 1, 0.2]


def test_wide_tables_are_the_long_ones() -> None:
    run = small_run()
    served = run.t.served
    assert served.columns.tolist() == ["a", "b", "c"]
    assert served.index.tolist() == run.steps["time"].tolist()
    assert served.to_numpy().ravel().tolist() == run.customers["served"].tolist()
    assert run.t.soc.index[-1] == run.scenario.grid.end
    assert run.t.v_ac_pu.columns.tolist() == [1, 2, 3, 4]
    assert run.t.p_ac_kw.columns.names == ["from_bus", "to_bus"]
    assert run.t.of("pv", "q_kvar").shape == (4, 1)
    assert {"served", "soc", "available_kw"} <= {*dir(run.t)}
    assert "q_kvar" not in dir(run.t)
    with pytest.raises(AttributeError, match=r'Write run.t.of\("pv", "q_kvar"\)'):
        _ = run.t.q_kvar
    with pytest.raises(InputError, match="is no column of this run"):
        run.t.of("pv", "soc_end")
    assert not hasattr(run.t, "nothing")
