"""Switches of imported networks, open and closed, and the sources that keep theirs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandapower as pp
import pandas as pd
import pytest

from tests.support.small_nets import ring
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.feeders import import_network
from vppres.feeders.feeder import ImportedFeeder
from vppres.feeders.new.scenario import new_scenario


def table(feeder: ImportedFeeder) -> pd.DataFrame:
    """Switches of a feeder by name."""
    found = feeder.switches
    columns = ("from_bus", "to_bus", "kind", "closed", "r_ohm", "x_ohm", "i_max_a")
    return pd.DataFrame({name: getattr(found, name) for name in columns}, found.id)


def test_switches_on_lines_are_closed_or_open() -> None:
    found = table(import_network(ring()))
    assert found.loc["feeder", ["from_bus", "to_bus", "kind", "closed"]].tolist() == [
        0, 1, "breaker", True,
    ]  # fmt: skip
    # Two switches of one line are one row: its state is one.
    assert found.loc["east", ["kind", "closed"]].tolist() == ["sectionaliser", True]
    assert found.loc["link", ["from_bus", "to_bus", "kind", "closed"]].tolist() == [
        2, 3, "tie", False,
    ]  # fmt: skip
    assert found.loc["link", ["r_ohm", "x_ohm"]].tolist() == pytest.approx([0.4, 0.2])
    assert found.loc["link", "i_max_a"] == pytest.approx(300.0)
    assert found.loc[["feeder", "east"], ["r_ohm", "x_ohm"]].isna().all(axis=None)
    assert [*found.index] == ["link", "feeder", "east"]


def test_bus_switches_stand_on_the_line_that_they_cut_off() -> None:
    """A busbar at 1 with bays: 4 has the line to 2, 5 the load of 3, and 6 ends at an open one."""
    net = ring()
    net.switch = net.switch.iloc[[0]].copy()
    bays = pp.create_buses(net, 3, vn_kv=10.0)
    net.line.loc[1, "from_bus"] = bays[0]
    net.line.loc[3, "to_bus"] = bays[2]
    net.load.loc[0, "bus"] = bays[1]
    pp.create_switch(net, 1, bays[0], "b", True, "CB", name="bay 4")
    pp.create_switch(net, 1, bays[1], "b", True, "CB", name="bay 5")
    pp.create_switch(net, 3, bays[2], "b", False, "LBS", name="bay 6")
    found = table(import_network(net))
    assert found.loc["bay 4", ["from_bus", "to_bus", "kind", "closed"]].tolist() == [
        1, 2, "breaker", True,
    ]  # fmt: skip
    assert found.loc["bay 6", ["from_bus", "to_bus", "kind", "closed"]].tolist() == [
        3, 6, "tie", False,
    ]  # fmt: skip
    assert found.loc["bay 6", "r_ohm"] == pytest.approx(1e-7)
    assert "bay 5" not in found.index  # what it cuts off is no line


def test_switches_change_no_feeder() -> None:
    """A net whose switches are taken out, and its open line out of service, is the same feeder."""
    plain = ring()
    plain.switch = plain.switch.iloc[:0]
    plain.line.loc[3, "in_service"] = False
    one, other = import_network(ring()).network, import_network(plain).network
    for name in ("buses", "parent", "r_ohm", "x_ohm", "i_max_a"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_open_transformers_of_nominal_ratio_are_ties() -> None:
    """The second of two parallel transformers is open by its switch, and a third has a tap."""
    net = ring()
    net.bus.loc[0, "vn_kv"] = 20.0
    net.line.loc[0, "in_service"] = False
    for name, closed, tap in (("T1", True, 0), ("T2", False, 0), ("T3", False, 2)):
        made = pp.create_transformer_from_parameters(
            net, 0, 1, 10.0, 20.0, 10.0, 0.5, 10.0, 0.0, 0.0, name=name, tap_side="hv",
            tap_neutral=0, tap_pos=tap, tap_step_percent=2.5, tap_changer_type="Ratio",
        )  # fmt: skip
        pp.create_switch(net, 0, made, "t", closed, "CB")
    feeder = import_network(net)
    found = table(feeder)
    assert found.loc["T1", ["kind", "closed"]].tolist() == ["breaker", True]
    assert found.loc["T2", ["from_bus", "to_bus", "closed"]].tolist() == [0, 1, False]
    base_ohm = feeder.network.base_kv**2 / 10.0
    assert found.loc["T2", "r_ohm"] == pytest.approx(0.005 * base_ohm)
    assert "T3" not in found.index
    assert "Open transformers with a ratio are no open switches here: T3." in feeder.notes


def test_loops_that_are_opened_are_ties() -> None:
    net = ring()
    net.switch.loc[3, "closed"] = True
    feeder = import_network(net, open_loops=True)
    found = table(feeder)
    assert found.index[~found["closed"]].tolist() == ["link"]
    assert found.loc["link", "r_ohm"] == pytest.approx(0.4)


def test_a_switch_of_one_of_two_parallel_lines_is_none_of_both() -> None:
    net = ring()
    pp.create_line_from_parameters(net, 1, 2, 2.0, 0.2, 0.1, 0.0, 0.3, name="beside")
    assert "east" not in table(import_network(net)).index


CIRCUIT = """clear
new circuit.ring basekv=12.47 pu=1 mvasc3=2000 mvasc1=2100
new line.l1 bus1=sourcebus bus2=a r1=0.3 x1=0.4 r0=0.6 x0=1.2 c1=0 c0=0 length=1
new line.s1 bus1=a bus2=as switch=yes r1=1e-5 x1=0 r0=1e-5 x0=0 c1=0 c0=0 length=0.001
new line.l2 bus1=as bus2=b r1=0.2 x1=0.3 r0=0.6 x0=1.2 c1=0 c0=0 length=1
new line.s2 bus1=a bus2=c switch=yes r1=0.1 x1=0.2 r0=0.1 x0=0.2 c1=0 c0=0 length=1
new line.tie bus1=b bus2=c r1=0.5 x1=0.6 r0=0.5 x0=0.6 c1=0 c0=0 length=2 normamps=200
new line.n1 bus1=c bus2=b r1=0.7 x1=0.8 r0=0.7 x0=0.8 c1=0 c0=0 length=1
new load.a bus1=a phases=3 kv=12.47 kw=100 kvar=30
new load.b bus1=b phases=3 kv=12.47 kw=100 kvar=30
new load.c bus1=c phases=3 kv=12.47 kw=100 kvar=30
new swtcontrol.n1 switchedobj=line.n1 switchedterm=1 normal=open state=open lock=yes
open line.tie 1
set voltagebases=[12.47]
calcvoltagebases
solve
"""


def test_switches_of_opendss_have_the_impedance_of_their_lines(tmp_path: Path) -> None:
    """Those of next to no impedance stand on the line behind them; a control may lock one."""
    (tmp_path / "ring.dss").write_text(CIRCUIT, encoding="utf-8")
    feeder = import_network(tmp_path / "ring.dss")
    found = table(feeder)
    assert {*found.index} == {"tie", "n1", "s1", "s2"}
    assert found["closed"].to_dict() == {"tie": False, "n1": False, "s1": True, "s2": True}
    assert found.loc["tie", ["r_ohm", "x_ohm", "i_max_a"]].tolist() == pytest.approx(
        [1.0, 1.2, 200]
    )
    assert found.loc["n1", ["r_ohm", "x_ohm"]].tolist() == pytest.approx([0.7, 0.8])
    assert found.loc["s2", ["from_bus", "to_bus"]].tolist() == ["a", "c"]
    assert {*found.loc["s1", ["from_bus", "to_bus"]]} == {"a", "b"}
    locked = dict(zip(feeder.switches.id, feeder.switches.locked, strict=True))
    assert locked == {"tie": "", "n1": "locked in the source", "s1": "", "s2": ""}


CASE = """function mpc = ring
mpc.version = '2';
mpc.baseMVA = 1;
mpc.bus = [
1 3 0 0 0 0 1 1 0 10 1 1.1 0.9;
2 1 0.1 0.05 0 0 1 1 0 10 1 1.1 0.9;
3 1 0.1 0.05 0 0 1 1 0 10 1 1.1 0.9;
];
mpc.gen = [1 0 0 9 -9 1 1 1 9 0];
mpc.branch = [
1 2 0.01 0.02 0 0 0 0 0 0 1 -360 360;
1 3 0.01 0.02 0 0 0 0 0 0 1 -360 360;
2 3 0.03 0.04 0 2 0 0 0 0 0 -360 360;
];
"""


def test_rows_of_status_0_are_ties(tmp_path: Path) -> None:
    (tmp_path / "ring.m").write_text(CASE, encoding="utf-8")
    found = table(import_network(tmp_path / "ring.m"))
    assert found.index.tolist() == ["2-3"]
    assert found.loc["2-3", ["r_ohm", "x_ohm", "i_max_a"]].tolist() == pytest.approx(
        [3.0, 4.0, 2000 / np.sqrt(3) / 10]
    )


def test_a_step_that_is_put_back_moves_no_switch() -> None:
    """The source's switches and branches are as they were."""
    net = ring()
    feeder = import_network(net)
    run = run_day(new_scenario(feeder), RunOptions(controller="idle"), steps=1)
    run.apply_to(net, feeder, run.steps["time"].iloc[0])
    before = ring()
    pd.testing.assert_frame_equal(net.switch, before.switch)
    pd.testing.assert_frame_equal(net.line, before.line)
