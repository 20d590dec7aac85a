"""Systems without a customer: everything they give is exported or curtailed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.tiny_day import tiny_scenario
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.explain.day import explain_day
from vppres.io import read_scenario, scenario_digest, write_scenario
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.scenario.assets import Customers, PVSystems
from vppres.scenario.parts import split_sheddable
from vppres.scenario.scenario import Scenario

SYSTEMS = {
    "id": ["roof", "mill"],
    "p_max_kw": [30.0, 90.0],
    "s_max_kva": [40.0, 90.0],
    "kind": ["pv", "wind"],
}


def alone() -> Scenario:
    """The tiny day with a windmill at bus 3, where the shop is, that nobody owns."""
    tiny = tiny_scenario()
    pv = PVSystems(**SYSTEMS, customer=["hospital", ""], bus=[None, 3])
    return replace(tiny, pv=pv, pv_kw=with_wind(tiny))


def owned_by_nobody() -> Scenario:
    """The same mill, owned by a customer that never takes anything."""
    tiny = tiny_scenario()
    c = tiny.customers
    customers = Customers(
        id=[*c.id, "nobody"],
        bus=[*c.bus, 3],
        tier=[*c.tier, "low"],
        weight=[*c.weight, 0.02],
        power_factor=[*c.power_factor, 1.0],
    )
    return replace(
        tiny,
        customers=customers,
        load_kw=np.column_stack([tiny.load_kw, np.zeros(tiny.grid.n_steps)]),
        pv=PVSystems(**SYSTEMS, customer=["hospital", "nobody"]),
        pv_kw=with_wind(tiny),
    )


def with_wind(tiny: Scenario) -> np.ndarray:
    return np.column_stack([tiny.pv_kw[:, 0], [90.0, 20.0, 80.0, 85.0, 40.0, 60.0]])


@pytest.mark.daily
@pytest.mark.parametrize("options", [
    RunOptions(horizon_h=3.0),
    pytest.param(RunOptions(horizon_h=3.0, mode="physical"), marks=pytest.mark.nightly),
    pytest.param(RunOptions(horizon_h=3.0, method="monolithic"), marks=pytest.mark.nightly),
    pytest.param(RunOptions(controller="full-horizon"), marks=pytest.mark.nightly),
    pytest.param(RunOptions(controller="reserve"), marks=pytest.mark.nightly),
], ids=["mpc", "physical", "monolithic", "plan", "rules"])  # fmt: skip
def test_the_day_is_that_of_an_owner_who_takes_nothing(options: RunOptions) -> None:
    run = run_day(alone(), options)
    other = run_day(owned_by_nobody(), options)
    for table, columns in {
        "steps": ["p_grid_kw", "losses_kw"],
        "pv": ["available_kw", "self_kw", "export_kw", "curtailed_kw"],
        "batteries": ["charge_kw", "discharge_kw", "soc_end"],
        "buses": ["v_ac_pu"],
    }.items():
        mine, theirs = (r.tables[table][columns].to_numpy(float) for r in (run, other))
        assert mine == pytest.approx(theirs, abs=1e-4), table
    served = other.customers[other.customers["id"] != "nobody"]["served"]
    assert run.customers["served"].tolist() == served.tolist()


def mill(run: Trajectory) -> pd.DataFrame:
    return run.pv[run.pv["id"] == "mill"]


def test_power_is_exported_or_curtailed() -> None:
    run = explain_day(run_day(alone(), RunOptions(horizon_h=3.0)))
    rows = mill(run)
    assert (rows["self_kw"] == 0).all()
    assert rows["bus"].tolist() == [3] * 6
    assert rows["customer"].tolist() == [""] * 6
    balance = rows["export_kw"] + rows["curtailed_kw"] - rows["available_kw"]
    assert balance.to_numpy() == pytest.approx(np.zeros(6), abs=1e-6)
    # In the outage wind, roof and the batteries carry all that 29 + 85 kW and 24 + 40 kW allow.
    assert run.customers["served"].to_numpy().reshape(6, 3)[3].all()
    assert summarise(run)["pv_curtailed_kwh"] >= 0


def test_folder_reads_back_equal(tmp_path: Path) -> None:
    write_scenario(alone(), tmp_path / "mine")
    day = read_scenario(tmp_path / "mine")
    assert scenario_digest(day) == scenario_digest(alone())
    assert (tmp_path / "mine" / "pv.csv").read_text().splitlines() == [
        "id,customer,p_max_kw,s_max_kva,kind,bus",
        "roof,hospital,30.0,40.0,pv,",
        "mill,,90.0,90.0,wind,3",
    ]


def test_folders_without_such_systems_look_as_before(tmp_path: Path) -> None:
    write_scenario(tiny_scenario(), tmp_path / "mine")
    header = (tmp_path / "mine" / "pv.csv").read_text().splitlines()[0]
    assert header == "id,customer,p_max_kw,s_max_kva"


def test_parts_leave_it_whole() -> None:
    day = alone()
    customers = replace(day.customers, shed_steps=np.array([2, 1, 1]))
    parts = split_sheddable(replace(day, customers=customers))
    assert parts.pv.id.tolist() == ["roof/1", "roof/2", "mill"]
    assert parts.pv.kind.tolist() == ["pv", "pv", "wind"]
    assert parts.pv.buses(parts.customers).tolist() == [2, 2, 3]
    assert parts.pv_kw[0].tolist() == [10.0, 10.0, 90.0]


def test_live_controller_knows_its_bus() -> None:
    controller = Controller.of(alone(), RunOptions(horizon_h=2.0))
    decision = controller.step(
        Measurement(controller.times[0], {"big": 0.5, "small": 0.5}, pv_kw={"mill": 15.0})
    )
    assert decision.pv.loc["mill", "bus"] == 3
    assert decision.pv.loc["mill", "p_kw"] == pytest.approx(15.0, abs=1e-6)
