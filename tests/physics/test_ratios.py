"""Ratios, charging, shunts and fixed demand: the network and its power flow against pandapower."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandapower as pp
import pytest

from benchmarks.frame.random_feeders import Window, random_window
from tests.support.agreement import assert_agree, both_methods
from tests.support.dispatch_check import check_dispatch
from tests.support.injections import in_network
from tests.support.made_up_runs import without_devices
from tests.support.small_windows import CHECKER_TOLERANCE
from vppres.control.guard.relax import widened
from vppres.core.errors import InputError
from vppres.core.units import mw_to_kw
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.model.beyond_paper.losses import Sweeps
from vppres.model.linearise import drawn_by
from vppres.model.site import Site
from vppres.physics.nose import follow
from vppres.physics.powerflow import ACPowerFlow
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario
from vppres.solve.deadline import Deadline
from vppres.solve.ladder import WindowSolver
from vppres.solve.network.cheapest import CheapestDispatch
from vppres.solve.result import Status

BASE_KV = 10.0
B_US, G_US = 30.0, 4.0
TAP = 1.04
LOAD = {"c": (300.0, 120.0), "d": (500.0, -80.0)}
# A source behind the tap holds the middle of what keeps both sides within 0.947 and 1.053 pu.
HELD_PU = {"a": 1.02, "d": (0.947 + 1.053 / TAP) / 2}


def tapped(turned: bool = False) -> Network:
    """a - b, b - c over a tap, c - d; charging on a - b, a capacitor at d, a fixed load at b."""
    ends = ["a", "b", "c"], ["b", "c", "d"]
    start, end = reversed(ends) if turned else ends
    ratio = np.array([1.0, TAP, 1.0])
    # Seen from the other end, the impedance behind the tap is larger by its square.
    other = ratio**2 if turned else np.ones(3)
    return Network(
        start,
        end,
        np.array([0.4, 0.8, 0.5]) * other,
        np.array([0.3, 2.0, 0.4]) * other,
        slack_bus="a",
        base_kv=BASE_KV,
        v_slack_pu=1.02,
        ratio=1.0 / ratio if turned else ratio,
        b_us=np.array([B_US, B_US, 0.0]) / other,
        g_us=np.array([0.0, G_US, 0.0]) / other,
        drawing_bus=["d", "b"],
        p_shunt_kw=[10.0, 0.0],
        q_shunt_kvar=[-150.0, 0.0],
        p_fixed_kw=[0.0, 60.0],
        q_fixed_kvar=[0.0, -20.0],
    )


def source_net(slack: str = "a") -> pp.pandapowerNet:
    """The same as pandapower has it: a tap as an impedance between buses of other voltages."""
    net = pp.create_empty_network(f_hz=50.0, sn_mva=1.0)
    # Behind the tap pandapower counts in pu of a base that is smaller by the ratio.
    kv = {"a": BASE_KV, "b": BASE_KV, "c": BASE_KV / TAP, "d": BASE_KV / TAP}
    at = {name: pp.create_bus(net, vn_kv=level, name=name) for name, level in kv.items()}
    pp.create_ext_grid(net, at[slack], vm_pu=HELD_PU[slack] * BASE_KV / kv[slack])
    base_ohm = {name: level**2 for name, level in kv.items()}

    def line(start: str, end: str, z_ohm: complex, y_us: complex) -> None:
        # The impedance is given at the side of `end`, in ohm of its nominal BASE_KV.
        z = z_ohm / BASE_KV**2 * base_ohm["a"] / base_ohm[end]
        y = y_us * 1e-6 * BASE_KV**2 / base_ohm["a"] * base_ohm[end]
        pp.create_impedance(
            net,
            at[start],
            at[end],
            z.real,
            z.imag,
            sn_mva=1.0,
            gf_pu=y.real / 2,
            bf_pu=y.imag / 2,
        )

    line("a", "b", 0.4 + 0.3j, 1j * B_US)
    line("b", "c", 0.8 + 2.0j, G_US + 1j * B_US)
    line("c", "d", 0.5 + 0.4j, 0j)
    for name, (p_kw, q_kvar) in {**LOAD, "b": (60.0, -20.0)}.items():
        pp.create_load(net, at[name], p_mw=p_kw / 1e3, q_mvar=q_kvar / 1e3)
    pp.create_shunt(net, at["d"], p_mw=0.01, q_mvar=-0.15, vn_kv=BASE_KV)
    return net


def injections(net: Network) -> tuple[np.ndarray, np.ndarray]:
    """The loads of devices at the buses."""
    p, q = np.zeros(net.n_buses), np.zeros(net.n_buses)
    for name, (p_kw, q_kvar) in LOAD.items():
        p[net.bus_index[name]], q[net.bus_index[name]] = -p_kw, -q_kvar
    return p, q


@pytest.mark.parametrize(("turned", "slack"), [
    (False, "d"),
    (True, "a"),
    *(pytest.param(*case, marks=pytest.mark.nightly) for case in [(False, "a"), (True, "d")]),
])  # fmt: skip
def test_the_power_flow_is_that_of_pandapower(turned: bool, slack: str) -> None:
    net = tapped(turned)
    source = source_net(slack)
    pp.runpp(source, tolerance_mva=1e-10, numba=False)
    found = ACPowerFlow(net).solve(*injections(net), reference=net.bus_index[slack])
    wanted_pu = source.res_bus["vm_pu"] * source.bus["vn_kv"] / BASE_KV
    assert found.v_pu == pytest.approx(wanted_pu.to_numpy(), abs=1e-8)
    grid = source.res_ext_grid.iloc[0]
    assert found.p_slack_kw == pytest.approx(float(mw_to_kw(grid["p_mw"])), abs=1e-4)
    assert found.q_slack_kvar == pytest.approx(float(mw_to_kw(grid["q_mvar"])), abs=1e-4)
    used_kw = mw_to_kw(source.res_impedance["pl_mw"]).sum() + mw_to_kw(source.res_shunt["p_mw"])[0]
    assert found.losses_kw == pytest.approx(float(used_kw), abs=1e-4)


@pytest.mark.parametrize("slack", ["a", "d"])
def test_the_curve_and_the_sweeps_agree_with_newton(slack: str) -> None:
    net = tapped()
    p, q = injections(net)
    reference = net.bus_index[slack]
    newton = ACPowerFlow(net).solve(p, q, reference)
    followed = ACPowerFlow(net)._followed(p, q, reference)
    swept = Sweeps(net, reference).solve(p[None, :], q[None, :])
    assert swept.converged.all()
    for name in ("v_pu", "p_from_kw", "q_to_kvar", "losses_kw", "p_slack_kw", "q_slack_kvar"):
        assert getattr(followed, name) == pytest.approx(getattr(newton, name), abs=1e-5), name
    assert swept.v_pu[0] == pytest.approx(newton.v_pu, abs=1e-8)
    assert swept.p_flow_kw[0] == pytest.approx(newton.p_from_kw, abs=1e-4)


def test_the_curve_without_load_has_the_voltages_of_the_shunts() -> None:
    """A capacitor of 1 Mvar behind 1 ohm at 10 kV: V = 1 / (1 - 0.01)."""
    net = Network(
        [1], [2], [1e-6], [1.0], slack_bus=1, base_kv=10.0, drawing_bus=[2], q_shunt_kvar=[-1000.0]
    )
    found = follow(net, np.zeros(2), np.zeros(2))
    assert abs(found.v[1]) == pytest.approx(1.0 / 0.99, abs=1e-9)


def test_a_network_with_ratios_is_the_same_after_a_round_of_orientation() -> None:
    net = tapped()
    there = replace(net, slack_bus="d")
    back = replace(there, slack_bus="a")
    assert there.ratio[there.bus_index["b"] - 1] == pytest.approx(1 / TAP)
    for name in ("r_ohm", "x_ohm", "ratio", "b_us", "g_us", "q_shunt_kvar", "p_fixed_kw"):
        assert getattr(back, name) == pytest.approx(getattr(net, name), rel=1e-12), name


def test_a_network_without_ratios_has_the_arithmetic_it_had() -> None:
    net = Network([1, 2], [2, 3], [0.1, 0.7], [0.2, 0.3], slack_bus=1, base_kv=11.0)
    assert not (net.draws or net.has_ratios)
    assert (net.bus_ratio == 1.0).all() and (net.u_min_pu2 == net.v_min_pu**2).all()
    assert (net.referred_r_ohm == net.r_ohm).all()


@pytest.mark.parametrize(("wrong", "words"), [
    ({"ratio": [0.0]}, "row 0, ratio = 0.0: must be positive"),
    ({"ratio": [1.0, 1.0]}, "one value for each of the 1 lines"),
    ({"drawing_bus": [2], "p_fixed_kw": [1.0, 2.0]}, "for each of the 1 buses"),
    ({"drawing_bus": [7], "p_fixed_kw": [1.0]}, "bus = 7: is not a bus of the network"),
])  # fmt: skip
def test_what_no_network_has_is_named(wrong: dict[str, list[float]], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Network([1], [2], [0.1], [0.1], slack_bus=1, base_kv=11.0, **wrong)


# Plans on a network with ratios and shunts.


def with_transformers(case: Window, seed: int) -> Window:
    """The window on the same tree with taps, charging, a capacitor and a fixed demand."""
    net = case.scenario.network
    draw = np.random.default_rng(seed)
    load_kw = float(case.scenario.load_kw.sum(axis=1).max())
    ratio = np.ones(net.n_lines)
    ratio[draw.integers(net.n_lines, size=2)] = [0.985, 1.02]
    tapped = replace(
        net,
        ratio=ratio,
        b_us=draw.uniform(0.0, 2e3, net.n_lines) * load_kw / net.base_kv**2 / 100,
        p_shunt_kw=draw.uniform(0.0, 0.01, net.n_buses) * load_kw,
        q_shunt_kvar=draw.uniform(-0.05, 0.02, net.n_buses) * load_kw,
        p_fixed_kw=np.eye(net.n_buses)[-1] * 0.03 * load_kw,
    )
    customers = case.scenario.customers
    leading = replace(
        customers,
        power_factor=np.where(draw.random(len(customers)) < 0.3, -1, 1) * customers.power_factor,
    )
    island = case.data.grid_limit_kw <= 0.0
    drawn = drawn_by(tapped, None, island, case.data.parts.of_bus)
    data = replace(case.data, drawn=drawn)
    return Window(replace(case.scenario, network=tapped, customers=leading), data)


@pytest.mark.monolith
@pytest.mark.parametrize("seed", range(6))
def test_masters_and_monolith_agree_on_a_network_with_ratios_and_shunts(seed: int) -> None:
    case = with_transformers(random_window(seed, stressed=seed % 2 == 1), seed)
    site = Site.of(case.scenario)
    answers = both_methods(site, case.data)
    assert_agree(case.scenario, case.data, answers)


@pytest.mark.parametrize("seed", [0, 1, 5, 8])  # with weights on a grid
def test_the_network_master_sees_ratios_and_shunts(seed: int) -> None:
    case = with_transformers(random_window(seed), seed)
    site = Site.of(case.scenario)
    answer = WindowSolver(site).solve(case.data).dispatch
    master = in_network(site, case.data)
    outcome, dispatch = CheapestDispatch(site, case.data, master.network).of(
        answer.served, Deadline(20.0)
    )
    assert outcome.status == Status.OPTIMAL and dispatch is not None
    assert check_dispatch(*case, dispatch).worst[1] <= CHECKER_TOLERANCE
    assert outcome.value <= case.data.price_gbp_per_kwh @ answer.p_grid_kw * site.dt_h + 1e-5


@pytest.mark.nightly
def test_an_island_behind_a_regulator_is_lit(tiny: Scenario) -> None:
    """At 0.98 pu behind a tap of 6 % the empty bus before it would be at 0.925 pu."""
    network = replace(tiny.network, v_slack_pu=0.98, ratio=[1 / 1.06, 1.0, 1.0])
    assert network.held_pu.tolist() == pytest.approx([0.98] + 3 * [(0.947 * 1.06 + 1.053) / 2])
    run = run_day(replace(tiny, network=network), RunOptions(mode="physical"))
    lit = run.steps[run.steps["outage"]]
    assert not lit["dark"].any()
    assert (run.steps["fallback"] == "none").all()
    assert lit["v_min_ac_pu"].min() > 0.947
    assert lit["v_max_ac_pu"].max() < 1.053


def test_a_dark_island_behind_a_tap_needs_no_fallback(tiny: Scenario) -> None:
    """At rest the tap would raise the voltage above its limit; in the dark there is none."""
    network = replace(
        tiny.network,
        v_slack_pu=1.04,
        ratio=[1.0, 1 / 1.03, 1.0],
        b_us=[0.0, 50.0, 0.0],
        drawing_bus=[3],
        p_shunt_kw=[5.0],
        q_shunt_kvar=[120.0],
        p_fixed_kw=[0.0],
        q_fixed_kvar=[9000.0],
        island=[True],
    )
    day = replace(tiny, network=network, batteries=without_devices(tiny).batteries)
    run = run_day(day, RunOptions(mode="physical"))
    assert run.steps["dark"].sum() == day.outage.sum() > 0
    assert (run.steps["fallback"] == "none").all()
    assert run.steps["v_error_pu"].max() < 1e-3


def test_limits_give_way_as_far_as_a_bus_behind_a_tap_needs() -> None:
    """Slack is of voltages referred to the slack bus: behind this tap 0.01 are 0.0108 pu²."""
    net = Network(["a"], ["b"], [0.4], [0.3], slack_bus="a", base_kv=BASE_KV, ratio=[1.0 / TAP])
    wide = widened(net, 0.01)
    assert (wide.v_min_pu, wide.v_max_pu) == (0.941, 1.059)
