"""The day of the paper: every published input, to the digits printed, for the data and ten seeds.

The figures are compared as text, as the paper prints them; they are written down here anew, not
taken from the builder.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pandapower
import pandapower.networks
import pytest

from data.uk_heatwave_2022 import build as builder
from data.uk_heatwave_2022 import series
from data.uk_heatwave_2022.build import build, feeder
from tests.support.offenders import assert_for_all
from vppres.core.arrays import Floats
from vppres.io import find_scenario, read_scenario, scenario_digest
from vppres.scenario.scenario import Scenario

PACKAGED = "uk-heatwave-2022"


@pytest.fixture(scope="module")
def days() -> dict[str, Scenario]:
    """The packaged day, and the day of ten other seeds."""
    return {
        "packaged": read_scenario(find_scenario(PACKAGED)),
        **{f"seed {seed}": build(seed=seed) for seed in range(10)},
    }


def hour_of_peak(day: Scenario, values: Floats) -> str:
    """Hour of the one largest value."""
    assert (values == values.max()).sum() == 1
    return f"{day.grid.times[int(values.argmax())]:%H:%M}"


def low_mean_high(values: Floats, digits: tuple[int, int, int]) -> tuple[str, ...]:
    figures = (values.min(), values.mean(), values.max())
    return tuple(f"{figure:.{n}f}" for figure, n in zip(figures, digits, strict=True))


def total_load(day: Scenario) -> Floats:
    return np.asarray(day.load_kw.sum(axis=1), dtype=np.float64)


def total_pv(day: Scenario) -> Floats:
    return np.asarray(day.pv_kw.sum(axis=1), dtype=np.float64)


# What the paper prints of its inputs, one statement a line, in the names of names_of().
INPUTS = """
I1   str(times[0]) == "2022-07-19 00:00:00+00:00"
I1   str(times[-1]) == "2022-07-19 23:00:00+00:00"
I1   day.grid.dt_h == 1.0
I2   where(day.outage) == [12, 13, 14, 15, 16, 17]
I2   np.isinf(day.grid_limit_kw[~day.outage]).all()
I3   low_mean_high(price, (2, 2, 2)) == ("0.20", "0.36", "0.54")
I3   (peak(price), peak(-price)) == ("18:00", "23:00")
I4   price[2] < min(price[1], price[3]) and price[6] > max(price[5], price[7])
I5   sorted(day.customers.bus) == list(range(2, 34)) and day.network.slack_bus == 1
I5   Counter(day.customers.tier) == {"critical": 12, "high": 10, "low": 10}
I6   low_mean_high(day.customers.power_factor, (2, 3, 2)) == ("0.90", "0.954", "0.98")
I7   (mega(load, 2), mega(load.max(), 3), peak(load)) == ("86.44", "4.068", "17:00")
I8   len(set(day.pv.customer)) == len(day.pv) == 28
I8   mega(day.pv.p_max_kw, 3) == "1.857"
I8   low_mean_high(day.pv.p_max_kw, (2, 2, 2)) == ("24.77", "66.34", "92.87")
I9   set(day.pv.s_max_kva) == {30.0, 40.0, 100.0}
I9   (day.pv.p_max_kw <= day.pv.s_max_kva).all()
I10  (mega(pv, 2), f"{100 * pv.sum() / load.sum():.1f}") == ("15.08", "17.4")
I10  (mega(pv.max(), 3), peak(pv)) == ("1.857", "11:00")
I10  (day.pv_kw <= day.pv.p_max_kw).all()
I11  sorted(b.bus) == list(range(2, 34))
I11  (mega(b.energy_kwh, 3), mega(b.p_max_kw, 3)) == ("2.542", "1.272")
I12  low_mean_high(b.energy_kwh, (2, 2, 1)) == ("38.59", "79.44", "165.5")
I13  low_mean_high(b.p_max_kw, (1, 2, 1)) == ("19.3", "39.74", "82.8")
I14  set(b.s_max_kva) == {25.0, 45.0, 70.0, 90.0} and (b.p_max_kw <= b.s_max_kva).all()
I15  (set(b.soc_initial), set(b.soc_min), set(b.soc_max)) == ({0.15}, {0.15}, {0.85})
I16  (mega((load - pv).max(), 3), peak(load - pv)) == ("3.786", "18:00")
I17  (day.network.v_min_pu, day.network.v_max_pu) == (0.947, 1.053)
I17  day.network.v_min_ac_pu == 0.94
I18  day.tiers == ("critical", "high", "low")
I18  set(zip(day.customers.tier, day.customers.weight)) == {("critical", 1.0), ("high", 0.1), ("low", 0.02)}
I19  set(b.eta_charge) == set(b.eta_discharge) == {0.95}
I20  (day.objective.lambda_grid, day.objective.lambda_curt) == (1e-6, 0.1)
I20  (day.objective.lambda_l, day.objective.lambda_q) == (1e-14, 1e-15)
I20  day.objective.lambda_grid < 0.02 / (price.max() * day.load_kw.max())  # a low one is worth its import
I21  set(b.alpha_charge_per_c2) | set(b.alpha_discharge_per_c2) == {1e-4}
I22  (set(b.r_int_ohm), set(b.beta_per_c), set(b.u_batt_v)) == ({0.0035}, {0.003}, {900.0})
I23  (b.r_theta_c_per_kw.min(), b.r_theta_c_per_kw.max()) == (2.771, 4.486)
I23  (b.c_theta_kwh_per_c.min(), b.c_theta_kwh_per_c.max()) == (0.104, 0.439)
I23  len(set(zip(b.r_theta_c_per_kw, b.c_theta_kwh_per_c, strict=True))) == 4
I24  set(b.t_ref_c) == {25.0} and np.isnan(b.t_initial_c).all()  # cells start as warm as the air
I24  (day.temperature_c[0], day.temperature_c.max()) == (22.0, 40.3)
I24  peak(day.temperature_c) == "15:00" and where(day.temperature_c > 27.0) == list(range(7, 23))
text abs(critical_share(day) - 0.36) < 0.001
""".strip().splitlines()


def names_of(day: Scenario) -> dict[str, object]:
    """What statements on inputs name."""
    return {
        **globals(),
        "Counter": Counter,
        "day": day,
        "b": day.batteries,
        "load": total_load(day),
        "pv": total_pv(day),
        "price": day.price_gbp_per_kwh,
        "times": day.grid.times,
        "peak": lambda values: hour_of_peak(day, values),
        "mega": lambda kilo, digits: f"{np.sum(kilo) / 1e3:.{digits}f}",
        "where": lambda flags: np.flatnonzero(flags).tolist(),
    }


@pytest.mark.parametrize("line", INPUTS)
def test_published_input(days: dict[str, Scenario], line: str) -> None:
    statement = line[5:]

    def check(day: Scenario) -> None:
        assert eval(statement, names_of(day)), statement

    assert_for_all(days, check)


def critical_share(day: Scenario) -> float:
    critical = day.customers.tier == "critical"
    return float(day.load_kw[:, critical].sum() / day.load_kw.sum())


def test_packaged_day_is_what_the_builder_builds() -> None:
    packaged = read_scenario(find_scenario(PACKAGED))
    assert scenario_digest(packaged) == scenario_digest(build())


def test_writing_anew_gives_the_packaged_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(builder, "FOLDER", tmp_path / "anew")
    builder.write()
    builder.write()  # over an older one
    for file in sorted(find_scenario(PACKAGED).iterdir()):
        assert (tmp_path / "anew" / file.name).read_bytes() == file.read_bytes(), file.name


def test_feeder_has_the_known_losses() -> None:
    """AC losses and lowest voltage of case33bw at nominal load with its tie lines open."""
    network, _ = feeder()
    net = pandapower.networks.case33bw()
    r_ohm, x_ohm = (
        dict(zip(network.to_bus, values, strict=True)) for values in (network.r_ohm, network.x_ohm)
    )
    net.line = net.line[net.line["in_service"]]
    net.line["r_ohm_per_km"] = [r_ohm[bus + 1] for bus in net.line["to_bus"]]
    net.line["x_ohm_per_km"] = [x_ohm[bus + 1] for bus in net.line["to_bus"]]
    pandapower.runpp(net, numba=False)
    assert network.n_lines == 32
    assert f"{net.res_line['pl_mw'].sum() * 1e3:.3f}" == "202.677"
    assert f"{net.res_bus['vm_pu'].min():.5f}" == "0.91309"


def test_nominal_load_of_the_feeder() -> None:
    network, nominal_kw = feeder()
    assert nominal_kw.sum() == pytest.approx(3715.0)
    assert (nominal_kw[0], nominal_kw[23], nominal_kw[31]) == (100.0, 420.0, 60.0)
    assert network.base_kv == 12.66


def test_every_customer_has_the_same_shape() -> None:
    day, nominal_kw = build(), feeder()[1]
    share = day.load_kw / total_load(day)[:, None]
    assert share == pytest.approx(np.tile(nominal_kw / 3715.0, (24, 1)), abs=1e-6)


def test_load_stays_near_the_public_shape() -> None:
    """Far less is moved than the load varies over the day (1240 kW)."""
    public = series.public_figures()["gb_transmission_demand_mw"].to_numpy()
    moved_kw = np.abs(series.load_and_pv_kw()[0] - public * 4068.0 / public.max())
    assert moved_kw.mean() < 18.0
    assert moved_kw.max() < 73.0


def test_pv_stays_near_the_public_shape() -> None:
    public = series.public_figures()["gb_embedded_solar_mw"].to_numpy()
    pv_kw = series.load_and_pv_kw()[1]
    moved_kw = np.abs(pv_kw - public * 1857.4 / public.max())
    assert moved_kw.mean() < 7.5
    assert moved_kw.max() < 23.0
    assert (pv_kw[public == 0.0] == 0.0).all()


@pytest.mark.parametrize(("name", "bound_hours"), [
    ("load", [17, 18, 19, 20]),
    ("pv", [11, 12, 18, 19]),
    ("A", [1, 2, 6, 7, 18, 23]),
    ("B", [1, 2, 6, 7, 10, 11, 18, 23]),
])  # fmt: skip
def test_hours_without_a_margin_keep_the_public_shape(name: str, bound_hours: list[int]) -> None:
    """Optimality of the least-squares problem: all free hours are scaled by one factor."""
    load_kw, pv_kw = series.load_and_pv_kw()
    column, values, last_digit = {
        "load": ("gb_transmission_demand_mw", load_kw, 0.1),
        "pv": ("gb_embedded_solar_mw", pv_kw, 0.1),
    }.get(name) or ("gb_day_ahead_eur_per_mwh", series.price_gbp_per_kwh(name), 1e-4)
    public = series.public_figures()[column].to_numpy()
    free = np.setdiff1d(np.arange(24), bound_hours)
    factor = values[free].sum() / public[free].sum()
    assert np.abs(values[free] - factor * public[free]).max() < last_digit
    assert np.abs(values[bound_hours] - factor * public[bound_hours]).max() > 10 * last_digit


def test_price_b_tells_the_story_of_hour_seven() -> None:
    price = series.price_gbp_per_kwh("B")
    assert price[7:12].argmin() == 0
    # 1 kWh sold at hour 6 costs price[7] / 0.95² to put back.
    assert price[7] / 0.95**2 < price[6]


def test_price_a_lacks_it() -> None:
    price = series.price_gbp_per_kwh("A")
    assert price[7:12].argmin() == 4
    assert price[7] / 0.95**2 > price[6]
    assert low_mean_high(price, (2, 2, 2)) == ("0.20", "0.36", "0.54")


def test_seed_changes_the_unpublished_data_only() -> None:
    one, other = build(seed=1), build(seed=2)
    for table, names in (
        ("customers", ("tier", "power_factor")),
        ("pv", ("p_max_kw",)),
        ("batteries", ("energy_kwh",)),
    ):
        for name in names:
            values = [getattr(getattr(day, table), name).tolist() for day in (one, other)]
            assert values[0] != values[1], name
    assert np.array_equal(one.load_kw, other.load_kw)
    assert np.array_equal(one.price_gbp_per_kwh, other.price_gbp_per_kwh)


@pytest.mark.parametrize("share", [0.25, 0.32, 0.40, 0.50])
def test_critical_share_is_an_option_of_its_own(share: float) -> None:
    day, default = build(critical_share=share), build()
    assert critical_share(day) == pytest.approx(share, abs=0.001)
    assert (day.customers.tier == "critical").sum() == 12
    assert np.array_equal(day.batteries.energy_kwh, default.batteries.energy_kwh)
    assert np.array_equal(day.customers.power_factor, default.customers.power_factor)


def test_larger_loads_tend_to_have_larger_assets() -> None:
    nominal_kw = feeder()[1]
    rank = nominal_kw.argsort().argsort()
    for seed in range(10):
        size_rank = build(seed=seed).batteries.energy_kwh.argsort().argsort()
        assert 0.3 < np.corrcoef(rank, size_rank)[0, 1] < 0.95


def test_zone_pairing() -> None:
    """Buses 2, 19, 23 and 33 lie in different zones."""
    default, same_order = build().batteries, build(zone_pairing=(0, 1, 2, 3)).batteries
    at = [list(default.bus).index(bus) for bus in (2, 19, 23, 33)]
    assert default.r_theta_c_per_kw[at].tolist() == [2.771, 3.343, 3.914, 4.486]
    assert default.c_theta_kwh_per_c[at].tolist() == [0.216, 0.104, 0.439, 0.327]
    assert same_order.c_theta_kwh_per_c[at].tolist() == [0.104, 0.216, 0.327, 0.439]
    assert same_order.r_theta_c_per_kw.tolist() == default.r_theta_c_per_kw.tolist()
