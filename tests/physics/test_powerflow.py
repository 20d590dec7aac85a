from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import opendssdirect as dss
import pandapower as pp
import pandapower.networks as pp_networks
import pandas as pd
import pytest

import vppres
from tests.support.command_line import call
from tests.support.refusals import refusal
from vppres.core.arrays import Floats
from vppres.core.errors import VerificationError
from vppres.feeders.cross_check import as_pandapower, cross_check
from vppres.io.find import load_scenario
from vppres.physics import nose, powerflow
from vppres.physics.admittances import Admittances, admittances_of
from vppres.physics.newton import Newton
from vppres.physics.powerflow import ACPowerFlow, ACResult, NoSolutionError, NotFoundError
from vppres.scenario.network import Network

Case = tuple[Network, Floats, Floats]

TIE_LINES = (33, 34, 35, 36, 37)
RECONFIGURED = (7, 9, 14, 32, 37)
OPENDSS_AGREEMENT_PU = 1e-6


def _case(lines: pd.DataFrame, loads: pd.DataFrame) -> Case:
    """Network and net injections; tables of lines (ohm) and of loads (kW, kvar) by bus."""
    network = Network(
        lines.from_bus, lines.to_bus, lines.r_ohm, lines.x_ohm, slack_bus=1, base_kv=12.66
    )
    at = network.place(loads.bus.to_numpy())
    return network, -(at @ loads.p_kw.to_numpy()), -(at @ loads.q_kvar.to_numpy())


@cache
def baran_and_wu() -> Any:
    """pandapower's net, which it takes most of a second to read."""
    return pp_networks.case33bw()


@cache
def case33(open_lines: tuple[int, ...] = TIE_LINES) -> Case:
    """Baran and Wu's 33 buses with the given lines (from 1) open."""
    source = baran_and_wu()
    line = source.line[~(source.line.index + 1).isin(open_lines)]
    lines = pd.DataFrame(
        {
            "from_bus": line.from_bus + 1,
            "to_bus": line.to_bus + 1,
            "r_ohm": line.r_ohm_per_km,
            "x_ohm": line.x_ohm_per_km,
        }
    )
    loads = pd.DataFrame(
        {
            "bus": source.load.bus + 1,
            "p_kw": source.load.p_mw * 1e3,
            "q_kvar": source.load.q_mvar * 1e3,
        }
    )
    return _case(lines, loads)


def reconfigured() -> Case:
    """The 33 buses with the lines open that lose least."""
    return case33(RECONFIGURED)


def case69() -> Case:
    file = Path(vppres.__file__).parent / "feeders" / "data" / "case69.csv"
    table = pd.read_csv(file, comment="#")
    return _case(table, table.rename(columns={"to_bus": "bus"}))


def two_bus(v_slack_pu: float = 1.0) -> ACPowerFlow:
    """One line of 2 + 3j ohm at 10 kV: 0.02 + 0.03j pu for 1 MVA."""
    return ACPowerFlow(
        Network(
            ["grid"], ["end"], [2.0], [3.0], slack_bus="grid", base_kv=10.0, v_slack_pu=v_slack_pu
        )
    )


@pytest.mark.parametrize(("case", "load_kw", "load_kvar", "losses_kw", "v_min_pu"), [
    pytest.param(case33, 3715.0, 2300.0, 202.677, 0.91309, id="33 buses"),
    pytest.param(reconfigured, 3715.0, 2300.0, 139.551, 0.93782, id="33 reconfigured"),
    pytest.param(case69, 3802.1, 2694.7, 224.99, 0.90919, id="69 buses"),
])  # fmt: skip
def test_published_feeders(
    case: Callable[[], Case], load_kw: float, load_kvar: float, losses_kw: float, v_min_pu: float
) -> None:
    network, p_kw, q_kvar = case()
    result = ACPowerFlow(network).solve(p_kw, q_kvar)
    assert -p_kw.sum() == pytest.approx(load_kw)
    assert -q_kvar.sum() == pytest.approx(load_kvar)
    assert result.losses_kw == pytest.approx(losses_kw, abs=6e-4 if losses_kw < 220 else 6e-3)
    assert result.v_pu.min() == pytest.approx(v_min_pu, abs=6e-6)
    assert result.converged


def test_two_buses_by_hand() -> None:
    # Load 1 + 0.5j pu. With a = r p + x q = 0.02 + 0.015 and b = |z|² |s|² the receiving voltage
    # solves u² - (1 - 2 a) u + b = 0; the losses are r |s|² / u.
    a, b = 0.02 * 1.0 + 0.03 * 0.5, (0.02**2 + 0.03**2) * (1.0**2 + 0.5**2)
    u = ((1 - 2 * a) + np.sqrt((1 - 2 * a) ** 2 - 4 * b)) / 2
    loss_kw, loss_kvar = 1000 * 0.02 * 1.25 / u, 1000 * 0.03 * 1.25 / u
    result = two_bus().solve([0.0, -1000.0], [0.0, -500.0])
    assert result.v_pu == pytest.approx([1.0, np.sqrt(u)], abs=1e-9)
    assert result.losses_kw == pytest.approx(loss_kw, abs=1e-5)
    assert result.p_from_kw == pytest.approx([1000.0 + loss_kw], abs=1e-5)
    assert result.q_from_kvar == pytest.approx([500.0 + loss_kvar], abs=1e-5)
    assert result.p_to_kw == pytest.approx([1000.0], abs=1e-5)
    assert result.q_to_kvar == pytest.approx([500.0], abs=1e-5)
    assert result.p_slack_kw == pytest.approx(1000.0 + loss_kw, abs=1e-5)


def test_without_load_every_voltage_is_the_slack_voltage() -> None:
    result = two_bus(v_slack_pu=1.02).solve([0.0, 0.0], [0.0, 0.0])
    assert result.v_pu == pytest.approx([1.02, 1.02], abs=1e-12)
    assert (result.losses_kw, result.p_slack_kw) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_injection_raises_the_voltage_and_exports() -> None:
    result = two_bus().solve([0.0, 800.0], [0.0, 0.0])
    assert result.v_pu[1] > 1.0
    assert result.p_slack_kw == pytest.approx(-800.0 + result.losses_kw, abs=1e-5)
    assert result.p_to_kw == pytest.approx([-800.0], abs=1e-5)


def test_injection_at_the_slack_bus_changes_the_import_only() -> None:
    network, p_kw, q_kvar = case33()
    flow = ACPowerFlow(network)
    before = flow.solve(p_kw, q_kvar)
    at_slack = np.eye(network.n_buses)[0]
    after = flow.solve(p_kw + 300.0 * at_slack, q_kvar - 70.0 * at_slack)
    assert after.p_slack_kw == pytest.approx(before.p_slack_kw - 300.0, abs=1e-5)
    assert after.q_slack_kvar == pytest.approx(before.q_slack_kvar + 70.0, abs=1e-5)
    assert after.v_pu == pytest.approx(before.v_pu, abs=1e-10)


@pytest.mark.parametrize("seed", range(4))
def test_power_balances_at_every_bus(seed: int) -> None:
    network, p_kw, q_kvar = case69()
    share = np.random.default_rng(seed).uniform(-1.0, 1.2, network.n_buses)
    result = ACPowerFlow(network).solve(p_kw * share, q_kvar * share)
    slack = np.eye(network.n_buses)[0]
    for injection, sent, arrived, from_slack in [
        (p_kw * share, result.p_from_kw, result.p_to_kw, result.p_slack_kw),
        (q_kvar * share, result.q_from_kvar, result.q_to_kvar, result.q_slack_kvar),
    ]:
        leaving = np.bincount(network.parent, sent, network.n_buses)
        balance = injection + from_slack * slack + np.append(0.0, arrived) - leaving
        assert np.abs(balance).max() < 1e-5
    assert result.losses_kw == pytest.approx((result.p_from_kw - result.p_to_kw).sum(), abs=1e-9)
    assert result.losses_kw > 0


def _opendss(network: Network, p_kw: Floats, q_kvar: Floats) -> tuple[Floats, float]:
    """Voltages in pu in the network's bus order and the losses in kW, by OpenDSS."""
    run = dss.Text.Command
    run("clear")
    run(
        f"new circuit.feeder basekv={network.base_kv} pu={network.v_slack_pu} phases=3 "
        f"bus1={network.buses[0]} isc3=1e9 isc1=1e9"
    )
    for line in range(network.n_lines):
        r, x = network.r_ohm[line], network.x_ohm[line]
        run(
            f"new line.l{line} bus1={network.from_bus[line]} bus2={network.to_bus[line]} phases=3 "
            f"r1={r} x1={x} r0={r} x0={x} c1=0 c0=0 length=1 units=none"
        )
    for bus, p, q in zip(network.buses, p_kw, q_kvar, strict=True):
        # The wide band keeps the load a constant power at every voltage met here.
        run(
            f"new load.d{bus} bus1={bus} phases=3 kv={network.base_kv} kw={-p} kvar={-q} model=1 "
            "vminpu=0.5 vmaxpu=1.5"
        )
    run(f"set voltagebases=[{network.base_kv}]")
    run("calcvoltagebases")
    run("set tolerance=1e-10 maxiterations=200")
    run("solve")
    assert dss.Solution.Converged()
    by_name = {}
    for bus in network.buses:
        dss.Circuit.SetActiveBus(str(bus))
        by_name[bus] = np.mean(dss.Bus.puVmagAngle()[0::2])
    return np.array([by_name[bus] for bus in network.buses]), dss.Circuit.Losses()[0] / 1e3


@pytest.mark.parametrize("case", [
    pytest.param(case33, id="33 buses"),
    pytest.param(reconfigured, id="33 reconfigured"),
    pytest.param(case69, id="69 buses"),
])  # fmt: skip
@pytest.mark.parametrize(
    ("lowest", "highest"), [(1.0, 1.0), (0.5, 0.5), (1.2, 1.2), (-1.5, 1.5), (-1.2, -0.8)]
)
def test_agrees_with_opendss(case: Callable[[], Case], lowest: float, highest: float) -> None:
    network, p_kw, q_kvar = case()
    share = np.random.default_rng(5).uniform(lowest, highest, network.n_buses)
    ours = ACPowerFlow(network).solve(p_kw * share, q_kvar * share)
    v_pu, losses_kw = _opendss(network, p_kw * share, q_kvar * share)
    assert np.abs(ours.v_pu - v_pu).max() < OPENDSS_AGREEMENT_PU
    assert ours.losses_kw == pytest.approx(losses_kw, rel=1e-5)


# Newton's method here and pandapower's.

LAST_BIT = 0.0 if platform.machine() in ("x86_64", "AMD64") else 1e-9
"""Elsewhere compilers may fuse a multiplication with an addition."""


def pandapower_net(network: Network, reference: int) -> pp.pandapowerNet:
    """The network as pandapower's elements, a load at each bus."""
    net = pp.create_empty_network()
    buses = pp.create_buses(net, network.n_buses, vn_kv=network.base_kv)
    pp.create_ext_grid(net, buses[reference], vm_pu=network.v_slack_pu)
    for line in range(network.n_lines):
        pp.create_line_from_parameters(
            net,
            buses[network.parent[line]],
            buses[line + 1],
            length_km=1.0,
            r_ohm_per_km=network.referred_r_ohm[line],
            x_ohm_per_km=network.referred_x_ohm[line],
            c_nf_per_km=0.0,
            max_i_ka=1.0,
        )
    for bus, (p_kw, q_kvar) in enumerate(zip(network.shunt_kw, network.shunt_kvar, strict=True)):
        if p_kw or q_kvar:
            pp.create_shunt(net, buses[bus], p_mw=p_kw / 1e3, q_mvar=q_kvar / 1e3)
    pp.create_loads(net, buses, p_mw=0.0, q_mvar=0.0)
    return net


def with_shunts() -> Case:
    """The 69 buses with capacitors at two of them."""
    network, p_kw, q_kvar = case69()
    shunts_kvar = np.zeros(network.n_buses)
    shunts_kvar[[20, 60]] = [-300.0, -450.0]
    return replace(network, q_shunt_kvar=shunts_kvar), p_kw, q_kvar


@pytest.mark.parametrize(("case", "reference"), [
    (case33, 0),
    (with_shunts, 20),
    pytest.param(case33, 20, marks=pytest.mark.nightly),
    pytest.param(with_shunts, 0, marks=pytest.mark.nightly),
])  # fmt: skip
def test_answers_are_pandapower_s_to_the_last_bit(case: Callable[[], Case], reference: int) -> None:
    network, p_kw, q_kvar = case()
    flow = ACPowerFlow(network)
    net = pandapower_net(network, reference)
    rng = np.random.default_rng(1)
    for solve in range(5):
        p = p_kw * rng.uniform(-0.5, 1.0, len(p_kw))
        q = q_kvar * rng.uniform(-0.5, 1.0, len(q_kvar))
        net.load["p_mw"] = -p / 1e3
        net.load["q_mvar"] = -q / 1e3
        # As every solve but the first starts from the one before, so does pandapower.
        kept = {"bus_pq": True, "trafo": False, "gen": False} if solve else None
        pp.runpp(
            net,
            init="results" if solve else "flat",
            recycle=kept,
            tolerance_mva=1e-9,
            calculate_voltage_angles=False,
            numba=False,
        )
        ours = flow.solve(p, q, reference)
        for found, theirs in (
            (ours.v_pu, net.res_bus.vm_pu),
            (ours.p_from_kw, 1e3 * net.res_line.p_from_mw),
            (ours.q_from_kvar, 1e3 * net.res_line.q_from_mvar),
            (ours.p_to_kw, -1e3 * net.res_line.p_to_mw),
            (ours.q_to_kvar, -1e3 * net.res_line.q_to_mvar),
            (ours.p_slack_kw, 1e3 * net.res_ext_grid.p_mw),
            (ours.q_slack_kvar, 1e3 * net.res_ext_grid.q_mvar),
        ):
            assert np.abs(found - np.asarray(theirs)).max() <= LAST_BIT


def with_transformers(n_buses: int, seed: int) -> Network:
    """A random feeder with taps, charging, leakage, capacitors, fixed demand and a series capacitor."""
    rng = np.random.default_rng(seed)
    n_lines = n_buses - 1
    parent = np.array([int(rng.integers(max(0, i - 6), i)) for i in range(1, n_buses)])
    x_ohm = rng.uniform(0.05, 0.8, n_lines)
    x_ohm[n_lines // 2] *= -0.1
    return Network(
        parent,
        np.arange(1, n_buses),
        rng.uniform(0.02, 0.5, n_lines),
        x_ohm,
        slack_bus=0,
        base_kv=20.0,
        v_slack_pu=1.02,
        ratio=np.where(rng.random(n_lines) < 0.2, rng.uniform(0.95, 1.05, n_lines), 1.0),
        b_us=rng.uniform(0.0, 40.0, n_lines),
        g_us=rng.uniform(0.0, 2.0, n_lines),
        drawing_bus=np.arange(0, n_buses, 5),
        p_shunt_kw=rng.uniform(0.0, 3.0, len(range(0, n_buses, 5))),
        q_shunt_kvar=rng.uniform(-80.0, 20.0, len(range(0, n_buses, 5))),
        p_fixed_kw=rng.uniform(0.0, 20.0, len(range(0, n_buses, 5))),
        q_fixed_kvar=rng.uniform(-5.0, 5.0, len(range(0, n_buses, 5))),
    )


@pytest.mark.parametrize("make_network", [
    pytest.param(lambda: reconfigured()[0], id="33 reconfigured"),
    pytest.param(lambda: with_shunts()[0], id="69 with shunts"),
    pytest.param(lambda: with_transformers(12, 0), id="12 with transformers"),
    pytest.param(lambda: with_transformers(150, 1), id="150 with transformers"),
    pytest.param(lambda: load_scenario("uk-heatwave-2022").network, id="packaged, 33 buses"),
    pytest.param(lambda: load_scenario("two-outages-cigre-mv").network, id="packaged, CIGRE"),
])  # fmt: skip
def test_admittances_are_pandapower_s_to_the_last_bit(
    make_network: Callable[[], Network],
) -> None:
    network = make_network()
    net = as_pandapower(network)
    pp.runpp(net, tolerance_mva=np.inf, calculate_voltage_angles=False, numba=False)
    theirs = net._ppc["internal"]
    ours = admittances_of(network)
    for found, name in ((ours.bus, "Ybus"), (ours.sending, "Yf"), (ours.receiving, "Yt")):
        assert np.abs((found - theirs[name]).toarray()).max() <= LAST_BIT
        # Sums over a row are rounded in the order in which it is kept.
        assert found.indices.tolist() == theirs[name].indices.tolist()


@pytest.mark.parametrize("seed", range(3))
def test_transformers_charging_and_shunts_are_pandapower_s(seed: int) -> None:
    network = with_transformers(60, seed)
    rng = np.random.default_rng(seed)
    p_kw = rng.uniform(-80.0, 60.0, network.n_buses)
    q_kvar = rng.uniform(-30.0, 10.0, network.n_buses)
    net = pandapower_net(network, 0)
    net.load["p_mw"] = (network.p_fixed_kw - p_kw) / 1e3
    net.load["q_mvar"] = (network.q_fixed_kvar - q_kvar) / 1e3
    pp.runpp(net, tolerance_mva=1e-9, calculate_voltage_angles=False, numba=False)
    ours = ACPowerFlow(network).solve(p_kw, q_kvar)
    assert ours.v_pu == pytest.approx(net.res_bus.vm_pu * network.bus_ratio, abs=1e-9)
    assert ours.p_from_kw == pytest.approx(1e3 * net.res_line.p_from_mw, abs=1e-4)
    source_kw = 1e3 * net.res_ext_grid.p_mw[0]
    assert ours.p_slack_kw == pytest.approx(source_kw, abs=1e-4)


@pytest.mark.parametrize("scenario", ["uk-heatwave-2022", "two-outages-cigre-mv"])
def test_the_cross_check_agrees(scenario: str) -> None:
    found = cross_check(load_scenario(scenario))
    assert found.agrees
    assert found.steps >= 2
    assert found.difference_pu is not None
    assert found.difference_pu < 1e-9


def test_the_cross_check_notices_a_wrong_impedance(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(network: Network) -> Admittances:
        return admittances_of(replace(network, r_ohm=1.001 * network.r_ohm))

    monkeypatch.setattr(powerflow, "admittances_of", wrong)
    found = cross_check(load_scenario("uk-heatwave-2022"))
    assert not found.agrees
    assert str(found).startswith("The AC power flow differs from pandapower's by 7e-05 pu in 4 ")
    done = call("validate", "uk-heatwave-2022", "--power-flow")
    assert done.exit_code == 1
    assert str(found) in done.stdout


def test_a_solve_does_not_depend_on_the_one_before() -> None:
    network, p_kw, q_kvar = case33()
    fresh = ACPowerFlow(network).solve(p_kw, q_kvar)
    used = ACPowerFlow(network)
    used.solve(-2.0 * p_kw, q_kvar)
    again = used.solve(p_kw, q_kvar)
    _assert_same(again, fresh)


def test_divergence_names_the_load_and_the_next_solve_is_sound() -> None:
    network, p_kw, q_kvar = case33()
    flow = ACPowerFlow(network)
    first = flow.solve(p_kw, q_kvar)
    with pytest.raises(VerificationError) as caught:
        flow.solve(5.0 * p_kw, 5.0 * q_kvar)
    assert str(caught.value) == (
        "the AC power flow has no solution: net load 18575.0 kW and 11500.0 kvar, the largest "
        "2100.0 kW at bus 24, and voltages collapse at 72.4% of it. The lines cannot carry it: "
        "check the units of loads and impedances, or serve less."
    )
    _assert_same(flow.solve(p_kw, q_kvar), first)


def _assert_same(one: ACResult, other: ACResult) -> None:
    assert one.v_pu == pytest.approx(other.v_pu, abs=1e-9)
    assert one.p_from_kw == pytest.approx(other.p_from_kw, abs=1e-5)
    assert one.q_from_kvar == pytest.approx(other.q_from_kvar, abs=1e-5)


def test_two_buses_diverge_just_beyond_the_largest_load() -> None:
    # With q = 0 the square root of the hand solution vanishes at
    # p = 1 / (2 (r + |z|)) pu, here 8.9 MW.
    limit_kw = 1000.0 / (2 * (0.02 + np.hypot(0.02, 0.03)))
    assert two_bus().solve([0.0, -0.99 * limit_kw], [0.0, 0.0]).v_pu[1] > 0.5
    with pytest.raises(NoSolutionError, match="at bus end") as caught:
        two_bus().solve([0.0, -1.01 * limit_kw], [0.0, 0.0])
    assert caught.value.share == pytest.approx(1 / 1.01, abs=2e-3)


# Where a line is almost a switch, and where there is no solution.


def with_switches(ohm: float, n_buses: int = 40) -> tuple[Network, Floats, Floats]:
    """A feeder of 12.47 kV in which every third line is a switch; kW and kvar by bus."""
    rng = np.random.default_rng(3)
    parent = np.array([int(rng.integers(max(0, i - 4), i)) for i in range(1, n_buses)])
    r = rng.uniform(0.02, 0.1, n_buses - 1)
    x = rng.uniform(0.02, 0.1, n_buses - 1)
    r[1::3] = x[1::3] = ohm
    network = Network(parent, np.arange(1, n_buses), r, x, slack_bus=0, base_kv=12.47)
    return network, -rng.uniform(0.0, 300.0, n_buses), -rng.uniform(0.0, 150.0, n_buses)


@pytest.mark.parametrize("ohm", [1e-4, 1e-5, 1e-6, 1e-9, 1e-14])
def test_a_line_that_is_almost_a_switch(ohm: float) -> None:
    # Merging its ends is the truth to some 1e-4 times the drop of voltage over 1e-4 ohm.
    network, p_kw, q_kvar = with_switches(ohm)
    coarse = ACPowerFlow(with_switches(1e-3)[0])
    flow = ACPowerFlow(network)
    for seed in range(6):
        share = np.random.default_rng(seed).uniform(0.3, 1.2, network.n_buses)
        result = flow.solve(p_kw * share, q_kvar * share)
        near = coarse.solve(p_kw * share, q_kvar * share)
        assert result.converged
        # 1e-3 ohm at 20 MVA and 12.47 kV are 1.3e-4 pu.
        assert result.v_pu == pytest.approx(near.v_pu, abs=1e-3)
        assert result.p_slack_kw == pytest.approx(
            result.losses_kw - (p_kw * share).sum(), abs=1e3 * len(p_kw) * flow.tolerance_kva
        )


def test_the_curve_in_currents_is_newton_s_answer() -> None:
    for network, p_kw, q_kvar in (case33(), case69()):
        newton = ACPowerFlow(network).solve(p_kw, q_kvar)
        found = nose.follow(network, p_kw / 1e3, q_kvar / 1e3)
        assert found.outcome == "solved"
        assert np.abs(found.v) == pytest.approx(newton.v_pu, abs=1e-9)
        sent = found.v[network.parent] * np.conj(found.i)
        assert 1e3 * sent.real == pytest.approx(newton.p_from_kw, abs=1e-5)
        assert 1e3 * sent.imag == pytest.approx(newton.q_from_kvar, abs=1e-5)


@pytest.mark.parametrize("reference", [0, 20])
def test_without_newton_all_results_are_the_same(
    reference: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    network, p_kw, q_kvar = case33()
    newton = ACPowerFlow(network).solve(0.2 * p_kw, 0.2 * q_kvar, reference)
    monkeypatch.setattr(Newton, "solve", lambda *_: None)
    curve = ACPowerFlow(network).solve(0.2 * p_kw, 0.2 * q_kvar, reference)
    _assert_same(curve, newton)
    assert (curve.p_slack_kw, curve.q_slack_kvar, curve.losses_kw) == pytest.approx(
        (newton.p_slack_kw, newton.q_slack_kvar, newton.losses_kw), abs=1e-5
    )
    assert curve.p_to_kw == pytest.approx(newton.p_to_kw, abs=1e-5)
    assert curve.q_to_kvar == pytest.approx(newton.q_to_kvar, abs=1e-5)


@pytest.mark.parametrize("seed", range(6))
def test_up_to_the_nose_there_is_a_solution_and_beyond_there_is_none(seed: int) -> None:
    network, p_kw, q_kvar = case33()
    share = np.random.default_rng(seed).uniform(0.2, 1.5, network.n_buses)
    nose_at = nose.follow(network, 9e-3 * p_kw * share, 9e-3 * q_kvar * share)
    assert nose_at.outcome == "none"
    flow = ACPowerFlow(network)
    below = 9.0 * nose_at.share * 0.999 * share
    assert flow.solve(p_kw * below, q_kvar * below).converged
    beyond = 9.0 * nose_at.share * 1.001 * share
    with pytest.raises(NoSolutionError, match="voltages collapse at 9"):
        flow.solve(p_kw * beyond, q_kvar * beyond)


def test_not_found_is_not_no_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    network, p_kw, q_kvar = case33()
    monkeypatch.setattr(Newton, "solve", lambda *_: None)
    monkeypatch.setattr(nose, "MAX_POINTS", 1)
    with pytest.raises(NotFoundError) as caught:
        ACPowerFlow(network).solve(20.0 * p_kw, 20.0 * q_kvar)
    message = str(caught.value)
    assert message.startswith("the AC power flow was not found: net load 74300.0 kW and 46000.0 ")
    assert "; the best answer misses " in message
    assert message.endswith(
        " Nothing shows that there is no solution: check the impedances of the lines."
    )
    assert not caught.value.best.converged
    assert np.isfinite(caught.value.best.v_pu).all()


def test_results_are_read_only() -> None:
    result = two_bus().solve([0.0, -10.0], [0.0, 0.0])
    with pytest.raises(ValueError, match="read-only"):
        result.v_pu[0] = 0.0


@pytest.mark.parametrize(("p_kw", "message"), [
    ([0.0, -1.0, -1.0],
        "power flow, p_kw = (3,): has the wrong shape. Give one injection for each "
        "of the 2 buses."),
    ([0.0, np.nan], "power flow, p_kw = nan: is not a finite number. Correct the load, PV or "
        "battery power at bus end."),
])  # fmt: skip
def test_wrong_injections_are_named(p_kw: list[float], message: str) -> None:
    assert refusal(two_bus().solve, p_kw, [0.0, 0.0]) == message
