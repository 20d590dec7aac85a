"""Figure 1c: energy in all batteries, and the import price."""

from __future__ import annotations

from matplotlib.figure import Figure

from experiments import ideal
from experiments.config import Config
from experiments.drawing import FULL, MPC, PRICE, day_axis, outage_hours, panels
from experiments.ideal import jobs as jobs
from experiments.jobs import Day, scenario
from experiments.results import DayResult
from experiments.rows import Row, asserted, measured, numbers
from experiments.runner import Results
from vppres.report import plot

LABEL = "fig:1c"
TITLE = "Total battery energy and electricity price"
PAPER = (
    "Batteries charge in hours 0 to 2, most at hour 2, and discharge in hours 3 to 6, at hour "
    "6 against the local price peak. At hour 7 the MPC sees the outage; from then on both "
    "controllers charge fast and are near the maximum by hour 11. In the outage the discharge "
    "is modest at first, faster in hours 16 to 18, and ends near the minimum."
)

ALERT_HOUR = 7
NEAR = 0.05
"""Share of the usable energy that counts as near the maximum or the minimum."""
NOISE_KW = 1.0


def figure(config: Config, results: Results) -> Figure:
    """Stored energy above, price below."""
    days = ideal.days(config, results)
    picture, (energy, price) = panels((3, 1.3), 5.6, "Battery energy and price, ideal conditions")
    plot.energy(days, energy)
    lowest, highest = energy_limits_kwh()
    plot.limit(energy, highest, "upper SoC limit, 0.85")
    plot.limit(energy, lowest, "lower SoC limit, 0.15")
    energy.axvline(ALERT_HOUR, color="#888888", linewidth=0.8, linestyle=":")
    energy.text(
        ALERT_HOUR - 0.1,
        0.04,
        "alert",
        rotation=90,
        ha="right",
        fontsize=8,
        transform=energy.get_xaxis_transform(),
    )
    plot.steps(price, days[MPC], days[MPC].series("price_gbp_per_kwh"), PRICE)
    price.set_ylabel("Price\n(GBP/kWh)")
    day_axis([energy, price], days[MPC])
    return picture


def rows(config: Config, results: Results) -> list[Row]:
    """R8 to R11 for each controller."""
    days = ideal.days(config, results)
    each = [
        row
        for name, day in days.items()
        for row in (*_before_the_alert(name, day), *_from_the_alert_on(name, day))
    ]
    return [*each, _side_by_side(days[MPC], days[FULL])]


def _side_by_side(mpc: DayResult, full: DayResult) -> Row:
    """How far the trajectories from the alert to the outage are apart."""
    first, _ = outage_hours(mpc)
    lowest, highest = energy_limits_kwh()
    charged = slice(ALERT_HOUR + 1, first + 1)
    apart_kwh = mpc.series("energy_kwh")[charged] - full.series("energy_kwh")[charged]
    share = float(abs(apart_kwh).max()) / (highest - lowest)
    return measured(
        "R10b",
        share,
        ".3f",
        reason=f"MPC less full horizon at the end of hours 7 to 11: {numbers(apart_kwh, ',.0f')} "
        "kWh. The MPC waits for the cheaper hours 10 and 11 with a part of its energy.",
    )


def ours(config: Config, results: Results) -> str:
    """What our figure shows."""
    days = ideal.days(config, results)
    mpc = days[MPC].series("energy_kwh")
    full = days[FULL].series("energy_kwh")
    first, last = outage_hours(days[MPC])
    return (
        f"Both charge to {mpc[3]:,.0f} and {full[3]:,.0f} kWh by the end of hour 2 and sell at "
        f"hour 6. The MPC enters the outage with {mpc[first]:,.0f} kWh and leaves it with "
        f"{mpc[last]:,.0f} kWh, the full horizon with {full[first]:,.0f} and "
        f"{full[last]:,.0f} kWh; the limits are "
        f"{numbers(energy_limits_kwh(), ',.0f').replace(', ', ' and ')} kWh."
    )


def energy_limits_kwh() -> tuple[float, float]:
    """Least and most energy that the batteries may hold together."""
    batteries = scenario(Day()).batteries
    return (
        float(batteries.energy_kwh @ batteries.soc_min),
        float(batteries.energy_kwh @ batteries.soc_max),
    )


def _before_the_alert(name: str, day: DayResult) -> list[Row]:
    charge_kw = day.series("charge_kw")
    night = charge_kw[:3]
    morning = charge_kw[3:7]
    return [
        asserted(
            "R8",
            {
                "every hour charges": bool((night > NOISE_KW).all()),
                "most at hour 2": int(night.argmax()) == 2,
            },
            f"{numbers(night, ',.0f')} kW in hours 0 to 2",
            name,
            day.evidence,
        ),
        asserted(
            "R9",
            {
                "every hour discharges": bool((morning < -NOISE_KW).all()),
                "largest at hour 6": int(morning.argmin()) == 3,
            },
            f"{numbers(morning, ',.0f')} kW in hours 3 to 6",
            name,
            day.evidence,
        ),
    ]


def _from_the_alert_on(name: str, day: DayResult) -> list[Row]:
    charge_kw = day.series("charge_kw")
    energy_kwh = day.series("energy_kwh")
    first, last = outage_hours(day)
    lowest, highest = energy_limits_kwh()
    near = NEAR * (highest - lowest)
    early = charge_kw[first : first + 4]
    late = charge_kw[first + 4 : last]
    alert = charge_kw[ALERT_HOUR:first]
    return [
        asserted(
            "R10",
            {
                "charges at hour 7": alert[0] > NOISE_KW,
                "hour 7 is the fastest": int(alert.argmax()) == 0,
                "near the maximum at the end of hour 11": energy_kwh[first] > highest - near,
            },
            f"{numbers(alert, ',.0f')} kW in hours 7 to 11; {energy_kwh[first]:,.0f} of "
            f"{highest:,.0f} kWh",
            name,
            day.evidence,
        ),
        asserted(
            "R11",
            {
                "slower in hours 12 to 15 than after": -early.mean() < -late.mean(),
                "near the minimum at the end": energy_kwh[last] < lowest + near,
            },
            f"{numbers(-charge_kw[first:last], ',.0f')} kW from hour 12 on; "
            f"{energy_kwh[last]:,.0f} kWh at the end (least: {lowest:,.0f})",
            name,
            day.evidence,
        ),
    ]
