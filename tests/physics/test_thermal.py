from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.refusals import refusal
from vppres.physics.thermal import (
    Power,
    Step,
    ThermalScheme,
    ThermalState,
    advance,
    efficiencies,
    heat_kw,
    initial_state,
    internal_resistance_ohm,
    step_euler,
    step_exact,
)
from vppres.scenario.assets import Batteries


def batteries(r_theta_c_per_kw: list[float], c_theta_kwh_per_c: list[float]) -> Batteries:
    """Batteries with the published electric constants and the given thermal ones."""
    n = len(r_theta_c_per_kw)
    rest = {
        "energy_kwh": 80.0, "p_max_kw": 40.0, "s_max_kva": 45.0, "soc_min": 0.15, "soc_max": 0.85,
        "soc_initial": 0.15, "eta_charge": 0.95, "eta_discharge": 0.9, "alpha_charge_per_c2": 1e-4,
        "alpha_discharge_per_c2": 2e-4, "r_int_ohm": 0.0035, "beta_per_c": 0.003,
        "u_batt_v": 900.0, "t_ref_c": 25.0, "t_initial_c": np.nan,
    }  # fmt: skip
    return Batteries(
        id=[f"b{i}" for i in range(n)],
        bus=[2] * n,
        r_theta_c_per_kw=r_theta_c_per_kw,
        c_theta_kwh_per_c=c_theta_kwh_per_c,
        **{name: np.full(n, value) for name, value in rest.items()},
    )


ONE = batteries([4.0], [0.25])
PAPER_ZONES = batteries([2.771, 3.5, 4.486], [0.104, 0.25, 0.439])


def state(t_cell_c: float, n: int = 1) -> ThermalState:
    return ThermalState(np.full(n, t_cell_c), np.full(n, 0.95), np.full(n, 0.9))


def power(charge_kw: float, discharge_kw: float, n: int = 1) -> Power:
    return Power(np.full(n, charge_kw), np.full(n, discharge_kw))


# Resistance and heat


@pytest.mark.parametrize(("t_cell_c", "expected_ohm"), [
    (25.0, 0.0035),
    (15.0, 0.0035 * 1.03),
    (125.0, 0.0035 * 0.7),
    (25.0 + 1 / 0.003, 0.0),
    (1000.0, 0.0),
])  # fmt: skip
def test_resistance_falls_with_temperature_down_to_zero(
    t_cell_c: float, expected_ohm: float
) -> None:
    assert internal_resistance_ohm(ONE, t_cell_c) == pytest.approx([expected_ohm], abs=1e-15)


def test_heat_by_hand() -> None:
    # At 45 °C R = 0.0035 * 0.94 = 0.00329 ohm; 36 kW at 900 V are 40 A, so 1600 * 0.00329 W.
    joule_kw = 1600 * 0.00329 / 1000
    assert heat_kw(ONE, power(36.0, 0.0), state(45.0)) == pytest.approx([36 * 0.05 + joule_kw])
    assert heat_kw(ONE, power(0.0, 36.0), state(45.0)) == pytest.approx([36 / 9 + joule_kw])


def test_joule_loss_is_that_of_the_net_power() -> None:
    # 40 kW in and 4 kW out leave the 36 kW of the case above in the cell's current.
    heat = heat_kw(ONE, power(40.0, 4.0), state(45.0))
    assert heat == pytest.approx([40 * 0.05 + 4 / 9 + 1600 * 0.00329 / 1000], abs=1e-9)


# Steps


def test_exact_step_by_hand() -> None:
    # R C = 1 h, so after 1 h the distance to 20 + 4 * 2 = 28 °C has shrunk by e: 28 + 12 / e.
    assert step_exact(40.0, 2.0, 20.0, 4.0, 0.25, 1.0) == pytest.approx(28 + 12 / np.e)


def test_euler_step_by_hand() -> None:
    # (2 kW - 20 / 4 kW) for a quarter of an hour into 0.25 kWh/°C: 3 °C less.
    assert step_euler(40.0, 2.0, 20.0, 4.0, 0.25, 0.25) == pytest.approx(37.0)


def test_without_heat_loss_both_steps_store_all_heat() -> None:
    # R to infinity: 2 kW over 0.5 h into 0.25 kWh/°C are 4 °C.
    assert step_exact(30.0, 2.0, 20.0, 1e9, 0.25, 0.5) == pytest.approx(34.0, abs=1e-5)
    assert step_euler(30.0, 2.0, 20.0, 1e9, 0.25, 0.5) == pytest.approx(34.0, abs=1e-5)


def test_euler_is_the_first_order_of_the_exact_step() -> None:
    # The difference of a step is (dt / R C)² / 2 times the distance to the settled temperature.
    for dt_h in (1e-2, 1e-3):
        args = (40.0, 2.0, 20.0, 4.0, 0.25, dt_h)
        difference_c = step_exact(*args) - step_euler(*args)
        assert difference_c == pytest.approx(12.0 * dt_h**2 / 2, rel=dt_h)


@pytest.mark.parametrize(("dt_over_time_constant", "grows"), [(1.9, False), (2.1, True)])
def test_euler_is_unstable_beyond_twice_the_time_constant(
    dt_over_time_constant: float, grows: bool
) -> None:
    # The distance to ambient is multiplied by 1 - dt / (R C) in every step; R C = 1 h.
    t_c = np.array(21.0)
    for _ in range(100):
        t_c = step_euler(t_c, 0.0, 20.0, 4.0, 0.25, dt_over_time_constant)
    assert (abs(t_c - 20.0) > 1.0) == grows


def test_fastest_published_zone_is_unstable_with_hourly_euler_and_not_with_exact() -> None:
    zone = batteries([2.771], [0.104])
    run: dict[ThermalScheme, list[float]] = {"euler": [], "exact": []}
    for scheme, temperatures in run.items():
        s = state(30.0)
        for _ in range(8):
            s = advance(zone, scheme, s, power(0.0, 0.0), 22.0, 1.0)
            temperatures.append(abs(s.t_cell_c[0] - 22.0))
    assert run["euler"][-1] > 1e3
    assert run["exact"][-1] < 1e-6


@given(
    st.floats(-20, 60),
    st.floats(0, 10),
    st.floats(-20, 45),
    st.floats(0.5, 10),
    st.floats(0.05, 1),
    st.floats(0.01, 24),
)
def test_exact_step_never_passes_the_settled_temperature(
    t_cell_c: float, heat: float, t_ambient_c: float, r: float, c: float, dt_h: float
) -> None:
    settled_c = t_ambient_c + r * heat
    after_c = float(step_exact(t_cell_c, heat, t_ambient_c, r, c, dt_h))
    low, high = sorted((t_cell_c, settled_c))
    assert low - 1e-9 <= after_c <= high + 1e-9


# Efficiencies


def test_efficiencies_by_hand() -> None:
    # 20 °C off the reference: 1 - 1e-4 * 400 = 0.96 and 1 - 2e-4 * 400 = 0.92.
    for t_cell_c in (5.0, 45.0):
        charge, discharge = efficiencies(ONE, t_cell_c)
        assert charge == pytest.approx([0.95 * 0.96])
        assert discharge == pytest.approx([0.9 * 0.92])


@pytest.mark.parametrize("t_cell_c", [-200.0, 130.0, 1e6])
def test_efficiencies_have_a_floor(t_cell_c: float) -> None:
    charge, discharge = efficiencies(ONE, t_cell_c)
    assert (charge[0], discharge[0]) == (0.475, 0.45)
    charge, discharge = efficiencies(ONE, t_cell_c, eta_floor=0.8)
    assert (charge[0], discharge[0]) == pytest.approx((0.76, 0.72))


# State


def test_initial_temperature_is_the_ambient_where_none_is_given() -> None:
    two = replace(batteries([4.0, 4.0], [0.25, 0.25]), t_initial_c=[np.nan, 35.0])
    start = initial_state(two, 15.0)
    assert start.t_cell_c.tolist() == [15.0, 35.0]
    # The paper starts from nominal efficiencies, whatever the temperature.
    assert start.eta_charge.tolist() == [0.95] * 2
    assert start.eta_discharge.tolist() == [0.9] * 2


def test_off_keeps_nominal_efficiencies_and_the_temperature() -> None:
    start = initial_state(ONE, 5.0)
    assert (start.eta_charge[0], start.eta_discharge[0]) == (0.95, 0.9)
    after = advance(ONE, "off", start, power(40.0, 0.0), 35.0, 1.0)
    assert [v.tolist() for v in after] == [[5.0], [0.95], [0.9]]


@pytest.mark.parametrize(("scheme", "step", "joule_unit"), [
    ("exact", step_exact, "w"),
    ("euler", step_euler, "w"),
    ("exact-joule-kw", step_exact, "kw"),
    ("euler-joule-kw", step_euler, "kw"),
])  # fmt: skip
def test_advance_heats_with_the_old_state_and_rates_the_new_temperature(
    scheme: ThermalScheme, step: Step, joule_unit: str
) -> None:
    before = state(30.0)
    after = advance(ONE, scheme, before, power(36.0, 0.0), 22.0, 0.5)
    kilowatts = {"w": 1e-3, "kw": 1.0}[joule_unit]
    heat = 36 * 0.05 + 1600 * 0.0035 * (1 - 0.003 * 5) * kilowatts
    t_cell_c = step(30.0, heat, 22.0, 4.0, 0.25, 0.5)
    assert after.t_cell_c == pytest.approx([float(t_cell_c)])
    assert after.eta_charge == pytest.approx([0.95 * (1 - 1e-4 * (t_cell_c - 25) ** 2)])
    assert after.eta_discharge == pytest.approx([0.9 * (1 - 2e-4 * (t_cell_c - 25) ** 2)])


@pytest.mark.parametrize("scheme", ["exact", "euler"])
def test_a_fleet_is_its_batteries_one_by_one(scheme: ThermalScheme) -> None:
    charge, discharge = np.array([30.0, 0.0, 5.0]), np.array([0.0, 20.0, 0.0])
    start = ThermalState(
        np.array([30.0, 40.0, 20.0]), *efficiencies(PAPER_ZONES, [30.0, 40.0, 20.0])
    )
    fleet = advance(PAPER_ZONES, scheme, start, Power(charge, discharge), 28.0, 1.0)
    for b in range(3):
        single = Batteries(
            **{f.name: getattr(PAPER_ZONES, f.name)[b : b + 1] for f in fields(Batteries)}
        )
        alone = advance(
            single,
            scheme,
            ThermalState(*(v[b : b + 1] for v in start)),
            Power(charge[b : b + 1], discharge[b : b + 1]),
            28.0,
            1.0,
        )
        for whole, part in zip(fleet, alone, strict=True):
            assert whole[b] == part[0]


def test_no_battery_is_a_fleet_of_length_zero() -> None:
    none = batteries([], [])
    start = initial_state(none, 20.0)
    after = advance(none, "exact", start, power(0.0, 0.0, 0), 20.0, 1.0)
    assert [len(v) for v in after] == [0, 0, 0]


def test_unknown_scheme_is_named() -> None:
    assert refusal(advance, ONE, "runge", state(30.0), power(1.0, 0.0), 22.0, 1.0) == (
        "options, thermal = runge: is not known. Use one of: off, exact, euler, exact-joule-kw, "
        "euler-joule-kw."
    )
