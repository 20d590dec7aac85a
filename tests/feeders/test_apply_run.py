"""A finished run in the net that it came from: the power flow of the net is that of the record."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandapower as pp
import pandapower.networks
import pandas as pd
import pytest

import vppres
from vppres.core.errors import InputError
from vppres.day.trajectory import Trajectory
from vppres.report.run_folder import write_run

OUTAGE = (pd.Timestamp("2025-07-01T08:00Z"), pd.Timestamp("2025-07-01T16:00Z"))
TOLERANCE_PU = 1e-6


def crowded_net() -> Any:
    """A feeder whose elements of every kind the scenario takes over, and a shunt that stays."""
    net = pandapower.networks.case33bw()
    net.line.loc[net.line["in_service"], "c_nf_per_km"] = 0.0
    pp.create_sgen(net, 10, p_mw=0.2, type="PV", name="roof")
    pp.create_sgen(net, 20, p_mw=0.15, type="WP", name="mill")
    pp.create_storage(
        net, 17, p_mw=0.05, max_e_mwh=2.0, sn_mva=1.2, name="old", soc_percent=50.0
    )  # fmt: skip
    return net


@cache
def day_of(make: Callable[[], Any], mode: str, **options: Any) -> tuple[Any, Trajectory]:
    """The feeder of a net, and six steps on it, two of them without grid."""
    feeder = vppres.import_network(make())
    day = vppres.new_scenario(
        feeder,
        vppres.NewScenarioOptions(
            step_minutes=240.0, draw_tiers=True, outages=(OUTAGE,), **options
        ),
    )
    return feeder, vppres.run_day(day, vppres.RunOptions("idle", mode=mode))


def agrees(net: Any, feeder: Any, run: Trajectory, t: int) -> None:
    """The net's voltages are the record's."""
    pp.runpp(net, numba=False, tolerance_mva=1e-10, calculate_voltage_angles=False)
    count = run.scenario.network.n_buses
    recorded = dict(
        zip(run.scenario.network.buses, run.buses["v_ac_pu"].iloc[t * count :], strict=False)
    )
    expected = np.array([recorded[feeder.bus_of[bus]] for bus in feeder.bus_of])
    found = net.res_bus["vm_pu"].loc[[*feeder.bus_of]].to_numpy()
    assert np.abs(found - expected).max() < TOLERANCE_PU


@pytest.mark.daily
@pytest.mark.parametrize("mode", [pytest.param("paper", marks=pytest.mark.nightly), "physical"])
def test_every_step_agrees_with_the_record(mode: str) -> None:
    net = crowded_net()
    feeder, run = day_of(crowded_net, mode, add_batteries=True)
    for t, time in enumerate(run.steps["time"]):
        run.apply_to(net, feeder, time)
        agrees(net, feeder, run, t)
        outage = bool(run.steps["outage"].iloc[t])
        assert net.ext_grid["in_service"].iloc[0] == (not outage)
        given_kw = 1000 * net.res_ext_grid["p_mw"].sum()
        assert given_kw == pytest.approx(run.steps["p_grid_kw"].iloc[t], abs=0.01)
    assert not net.load["in_service"].iloc[:32].any()
    assert not net.sgen.loc[net.sgen["vppres"] != "put", "in_service"].any()
    assert not net.storage.loc[net.storage["vppres"] != "put", "in_service"].any()
    for no_step in ("2025-07-01T08:30Z", "yesterday", "2025-07-01T08:00"):
        with pytest.raises(InputError, match="is not the beginning of a step"):
            run.apply_to(net, feeder, no_step)


@pytest.mark.nightly
def test_a_run_folder_read_back_does_the_same(tmp_path: Path) -> None:
    net = crowded_net()
    feeder, run = day_of(crowded_net, "physical", add_batteries=True)
    write_run(run, tmp_path / "run", figures=False)
    read = vppres.read_run(tmp_path / "run")
    read.apply_to(net, feeder, "2025-07-01T08:00Z")
    agrees(net, feeder, run, 2)


@pytest.mark.nightly
def test_in_the_dark_nothing_is_left_on() -> None:
    net = pandapower.networks.case33bw()
    feeder, run = day_of(pandapower.networks.case33bw, "physical")
    run.apply_to(net, feeder, "2025-07-01T12:00Z")
    assert not net.ext_grid["in_service"].any()
    assert net.load.loc[net.load["in_service"], "p_mw"].sum() == 0.0
    run.apply_to(net, feeder, "2025-07-01T16:00Z")
    agrees(net, feeder, run, 4)


def test_transformers_and_charging_stay_as_they_are() -> None:
    net = pandapower.networks.simple_four_bus_system()
    feeder, run = day_of(pandapower.networks.simple_four_bus_system, "paper", add_batteries=True)
    for t, time in enumerate(run.steps["time"]):
        run.apply_to(net, feeder, time)
        agrees(net, feeder, run, t)
