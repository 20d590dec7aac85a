"""Switches of imported networks, open and closed, and the sources that keep theirs."""

from __future__ import annotations

import numpy as np
import pandapower as pp
import pandas as pd
import pytest

from tests.support.small_nets import ring
from vppres.feeders import import_network
from vppres.feeders.feeder import ImportedFeeder


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
    assert found.loc["east", ["from_bus", "to_bus", "kind", "closed"]].tolist() == [
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
