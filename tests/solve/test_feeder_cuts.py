"""Cuts from each feeder's own search: they hold for every set that the network carries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from tests.support.injections import columns_of, in_network
from tests.support.small_windows import window
from vppres.contract.dispatch import Dispatch
from vppres.io import find_scenario, read_scenario
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario
from vppres.solve.deadline import Deadline
from vppres.solve.netting import net_modes
from vppres.solve.network.cheapest import CheapestDispatch
from vppres.solve.network.large import (
    SHARED,
    Feeders,
    ServiceCuts,
    feeder_of_buses,
    feeder_of_rows,
)
from vppres.solve.network.master import DISCS, NetworkMaster
from vppres.solve.programs import Program, ProgramSolution
from vppres.solve.result import Outcome, Status

TIME_S = 20.0


def three_feeders() -> Scenario:
    """The packaged day of 1.6 times the load, fed at bus 6, where three lines begin."""
    day = read_scenario(find_scenario("uk-heatwave-2022"))
    net = day.network
    ends = net.buses[net.parent], net.buses[1:]
    moved = Network(
        *ends, net.r_ohm, net.x_ohm, slack_bus=6, base_kv=net.base_kv, v_min_pu=net.v_min_pu + 0.03
    )
    return replace(day, network=moved, load_kw=day.load_kw * 1.6)


def test_feeders_are_counted_from_the_slack_bus() -> None:
    """1 - 2 - 3 and 1 - 4, by hand; a row over both belongs to none."""
    r = np.full(3, 0.1)
    net = Network([1, 2, 1], [2, 3, 4], r, r, slack_bus=1, base_kv=11.0)
    at = {bus: int(number) for bus, number in zip(net.buses, feeder_of_buses(net), strict=True)}
    assert at[1] == SHARED
    assert at[2] == at[3] != at[4]
    rows = sp.csr_array(np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0, 0, 0]]))
    assert feeder_of_rows(rows, np.array([0, 0, 1])).tolist() == [0, 1, SHARED, SHARED]


def test_a_feeders_cut_by_hand() -> None:
    """Two feeders share 3 kW; a customer of the first needs 2 of its 1.5 kW, or half of it.

    Most service of shares: 0.75 there. As a whole number it is none, so its search takes 0.75 away.
    """
    program = Program(
        cost=np.array([-1.0, -1.0]),
        x_lower=np.zeros(2),
        x_upper=np.ones(2),
        rows=sp.csc_array(np.array([[2.0, 0.0], [2.0, 1.0]])),
        lower=np.full(2, -np.inf),
        upper=np.array([1.5, 3.0]),
        integer=np.arange(0),
    )
    solution = ProgramSolution.of(program.loaded(), Deadline(TIME_S))
    assert solution.value == pytest.approx(-1.75)
    feeders = Feeders(program, solution, np.array([0, 1]), np.arange(2))
    assert feeders.fractional.tolist() == [0]
    found = feeders.search(0, Deadline(TIME_S))
    assert found.served.tolist() == [0.0]
    assert solution.value + found.raised == pytest.approx(-1.0, abs=1e-3)
    assert solution.value + found.raised <= -1.0


@pytest.mark.parametrize(("hour", "taken"), [(11, 0.5), (18, 0.0)])
def test_cuts_leave_every_set_that_is_carried(
    monkeypatch: pytest.MonkeyPatch, hour: int, taken: float
) -> None:
    day = three_feeders()
    site = Site.of(day)
    data = window(day, slice(hour, hour + 2), 0.35)

    def master() -> NetworkMaster:
        return in_network(site, data)

    usual, best = master().service(0.5)
    assert usual.status == Status.OPTIMAL
    monkeypatch.setattr("vppres.solve.sizes.LARGE", 0)
    large = master()
    root = -large.root[1].value
    assert large.carries(best)
    cuts = ServiceCuts(large.units, large.able)
    assert large._cut(large.root[1], cuts) == pytest.approx(root)
    large._by_feeders(cuts, Deadline(TIME_S))
    assert usual.value - 1e-2 <= cuts.first <= root - taken + 1e-5
    x = best.ravel().astype(float)
    for gain, most in zip(cuts.gains, cuts.most_units, strict=True):
        assert large.units @ x <= most + gain @ x + 1e-5
    outcome, served = master().service(0.5)
    assert served is not None
    assert (outcome.value, outcome.bound) == (usual.value, usual.bound)


def cheapest_of_large(
    site: Site, data: WindowData, monkeypatch: pytest.MonkeyPatch
) -> tuple[NetworkMaster, Dispatch]:
    """The cheapest dispatch of the best schedule, as of a large window."""
    _, served = in_network(site, data).service(0.5)
    assert served is not None
    monkeypatch.setattr("vppres.solve.sizes.LARGE", 0)
    master = in_network(site, data)
    outcome, dispatch = CheapestDispatch(site, data, master.network).of(served, Deadline(TIME_S))
    assert outcome.status == Status.OPTIMAL
    assert dispatch is not None
    return master, dispatch


def test_batteries_go_one_way_where_they_cannot_store_what_they_waste(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A full battery beside more sun than everyone needs, in the dark: nothing has a price."""
    day = three_feeders()
    site = Site.of(day)
    data = window(day, slice(12, 14), 0.35)
    data = replace(data, soc=site.batteries.soc_max, pv_kw=20.0 * data.pv_kw)
    _, dispatch = cheapest_of_large(site, data, monkeypatch)
    assert net_modes(site, data, dispatch)[1]
    assert dispatch.pv_curtailed_kw.sum() > 0.0


def test_what_exceeds_the_discs_is_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two batteries beyond their discs, in directions that cancel."""
    day = three_feeders()
    site = Site.of(day)
    master, dispatch = cheapest_of_large(site, window(day, slice(18, 20), 0.6), monkeypatch)
    columns = master.model.at("Q_batt")
    x = columns_of(master.model, dispatch)
    x[columns[:, 0]] += 2.0 * site.batteries.s_max_kva[0]
    x[columns[:, 1]] -= 2.0 * site.batteries.s_max_kva[0]
    clipped = master.model.clipped(x, 1e-2)
    assert clipped is not None
    assert not master.model.disc_rows(clipped, 1e-6)
    given = np.column_stack([master.model.at(name) for name in ("Q_batt", "Q_pv", "Q_grid")])
    before, after = (z[given].sum(axis=1) for z in (x, clipped))
    np.testing.assert_allclose(after, before, atol=1e-6)


def test_sets_of_so_many_units_by_hand() -> None:
    """Four customers of 3, 2, 2 and 1 units; whoever is off costs the first bound of 8 units 0.4.

    The search of the feeder of the first two takes 1.5 units, and their absence is no loss before
    that. None has 7 units, since one absence more than the two of 6 units would be needed.
    """
    cuts = ServiceCuts(np.array([3.0, 2.0, 2.0, 1.0]), np.ones(4))
    cuts.add(np.full(4, -0.4), 8.0 - 4 * 0.4)
    assert cuts.first == pytest.approx(8.0, abs=1e-5)
    cuts.lower(np.array([1.5, 1.5, 0.0, 0.0]), 1.5)
    assert cuts.first == pytest.approx(6.5, abs=1e-5)
    shares = np.ones(4)
    free = np.full(4, np.nan)
    end = Deadline(TIME_S)
    assert cuts.with_units(7.0, shares, free, end).status == Status.INFEASIBLE
    six = cuts.with_units(6.0, shares, free, end)
    assert six.status.has_answer
    # One of 2 units is off: the third would leave 8 - 1.5 - 0.4 = 6.1 units, the second 6.5.
    assert cuts.units @ np.round(six.x) == 6.0
    held = np.array([np.nan, 1.0, 1.0, np.nan])
    assert cuts.with_units(6.0, shares, held, end).status == Status.INFEASIBLE
    five = cuts.with_units(5.0, shares, held, end)
    np.testing.assert_array_equal(np.round(five.x), [0.0, 1.0, 1.0, 1.0])


def test_a_set_without_a_dispatch_well_within_is_put_to_the_discs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    day = three_feeders()
    site = Site.of(day)
    data = window(day, slice(11, 13), 0.35)
    monkeypatch.setattr("vppres.solve.sizes.LARGE", 0)

    def service() -> tuple[Outcome, NetworkMaster, np.ndarray | None]:
        master = in_network(site, data)
        outcome, served = master.service(0.5)
        return outcome, master, served

    usual, exact, served = service()
    assert served is not None
    monkeypatch.setattr("vppres.solve.network.master.DISCS", (0.1, *DISCS[1:]))
    outcome, rough, same = service()
    assert same is not None
    assert outcome.bound == usual.bound
    assert outcome.value == usual.value
    for master, found in ((exact, served), (rough, same)):
        assert (
            CheapestDispatch(site, data, master.network).of(found, Deadline(TIME_S))[0].status
            == Status.OPTIMAL
        )
