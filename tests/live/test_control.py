"""The controller behind a plant of one's own: measured values in, set-points out."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pandapower as pp
import pandas as pd
import pytest

import vppres
from tests.support.garbage import MEASUREMENTS, beyond_limits, run_one
from tests.support.refusals import refusal
from tests.support.small_nets import buses_in_a_row
from tests.support.threads import differing
from vppres import Controller, InputError, Measurement, RunOptions, Scenario
from vppres.contract.forecast import ForecastErrors
from vppres.contract.observation import Observation
from vppres.control.mpc import MPCController
from vppres.core.errors import LimitError, SolveError, VerificationError
from vppres.day.assembly import make_controller
from vppres.day.simulate import Day
from vppres.kinds.customer.data import SwitchingRules
from vppres.solve.result import SolveLimits, WindowSolution

SOC = {"big": 0.5, "small": 0.5}


def followed(day: Scenario, options: RunOptions) -> list[vppres.SetPoints]:
    """A day in which the plant is the expectation: each step's SoC is what the last one left."""
    controller = Controller.of(day, options)
    soc = dict(zip(day.batteries.id, day.batteries.soc_initial, strict=True))
    decisions = []
    for time in controller.times:
        decisions.append(controller.step(Measurement(time, soc)))
        soc = dict(decisions[-1].batteries["soc_end"])
    return decisions


@pytest.mark.parametrize("kind", ["mpc", "full-horizon"])
def test_steps_are_those_of_a_run(tiny: Scenario, kind: str) -> None:
    options = RunOptions(controller=kind, horizon_h=3.0)
    run = vppres.run_day(tiny, options)
    decisions = followed(tiny, options)
    for name, column in {
        "customers": "served",
        "batteries": "soc_end",
        "pv": "curtailed_kw",
    }.items():
        found = pd.concat([getattr(d, name) for d in decisions])[column].to_numpy(float)
        assert found == pytest.approx(run.tables[name][column].to_numpy(float), abs=1e-7), name
    net_kw = run.batteries["charge_kw"] - run.batteries["discharge_kw"]
    assert np.concatenate([d.batteries["p_kw"] for d in decisions]) == pytest.approx(
        net_kw, abs=1e-4
    )
    # Reactive power is a tie-breaker, equal only as far as its level is solved.
    assert np.concatenate([d.buses["v_ac_pu"] for d in decisions]) == pytest.approx(
        run.buses["v_ac_pu"], abs=1e-5
    )
    assert [d.import_kw for d in decisions] == pytest.approx(
        run.steps["p_grid_kw"].tolist(), abs=1e-2
    )


def test_switching_rules_reach_over_the_steps(tiny: Scenario) -> None:
    rules = SwitchingRules(min_unserved_h=3.0, cold_load_factor=1.3, cold_load_h=1.0)
    options = RunOptions(horizon_h=1.0, switching=rules)
    run = vppres.run_day(tiny, options)
    shed = ~run.customers["served"].to_numpy(bool).reshape(6, 3)
    assert (shed[4] & shed[5]).any()  # off with the grid back
    served = [d.customers["served"].tolist() for d in followed(tiny, options)]
    assert served == (~shed).tolist()


def test_options_without_meaning_change_nothing(tiny: Scenario) -> None:
    wild = RunOptions(horizon_h=3.0, seed=5, thermal="exact", errors=ForecastErrors(0.5, 0.5))
    plain = followed(tiny, RunOptions(horizon_h=3.0))
    for one, other in zip(plain, followed(tiny, wild), strict=True):
        assert one.batteries["soc_end"].to_numpy() == pytest.approx(
            other.batteries["soc_end"].to_numpy(), abs=1e-7
        )


def test_what_is_measured_overrules_the_scenario(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=0))
    dark = controller.step(
        Measurement(
            controller.times[0],
            SOC,
            load_kw={"homes": 500.0},
            pv_kw={"roof": 0.0, "field": 25.0},
            grid_limit_kw=0.0,
        )
    )
    assert dark.customers["load_kw"].to_dict() == {"hospital": 60.0, "shop": 40.0, "homes": 500.0}
    assert dark.pv["available_kw"].to_dict() == {"roof": 0.0, "field": 20.0}  # its rating
    # 60 kW of the hospital, 20 kW of PV, and a battery for one hour: 500 kW are out of reach.
    assert dark.customers["served"].to_dict() == {"hospital": True, "shop": False, "homes": False}
    assert dark.import_kw == pytest.approx(0.0, abs=1.0)
    light = controller.step(Measurement(controller.times[0], SOC))
    assert light.customers["served"].all()


def test_an_outage_that_is_expected_is_prepared(tiny: Scenario) -> None:
    empty = {"big": 0.15, "small": 0.15}
    quiet = replace(tiny, grid_limit_kw=np.full(6, np.inf))
    controller = Controller.of(quiet, RunOptions(horizon_h=2.0))
    now = controller.times[0]
    assert list(controller.window(now)) == list(controller.times[:3])
    warned = pd.Series([0.0, 0.0], index=controller.times[1:3])
    assert controller.step(Measurement(now, empty)).batteries["p_kw"].max() <= 1e-6
    decision = controller.step(Measurement(now, empty, grid_limit_kw=warned))
    assert decision.batteries["p_kw"].sum() > 50.0
    assert decision.batteries["soc_end"].min() > 0.15


def test_forecast_is_a_table_by_time(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=2.0))
    ahead = controller.times[2:5]
    load = pd.DataFrame({"shop": [2.0, 10.0, 20.0], "homes": [1.0, 2.0, 3.0]}, index=ahead)
    decision = controller.step(Measurement(ahead[0], SOC, load_kw=load))
    assert decision.time == ahead[0]
    assert decision.customers["load_kw"].to_dict() == {"hospital": 64.0, "shop": 2.0, "homes": 1.0}


def test_state_of_charge_beyond_the_limits_counts_as_the_limit(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=0))
    outside = controller.step(Measurement(controller.times[3], {"big": 0.11, "small": 0.89}))
    assert outside.solve["estimated"] == ""
    at_limit = controller.step(Measurement(controller.times[3], {"big": 0.15, "small": 0.85}))
    assert outside.batteries["soc_end"].to_numpy() == pytest.approx(
        at_limit.batteries["soc_end"].to_numpy(), abs=1e-7
    )


def test_all_mistakes_of_a_measurement_at_once(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(guard=False))
    wrong = Measurement(
        pd.Timestamp("2022-07-19T10:30Z"),
        soc={"bgi": 0.5, "small": 15.0},
        load_kw={"shop": -1.0},
        pv_kw=pd.DataFrame({"roof": [np.nan]}, index=controller.times[:1]),
        grid_limit_kw=pd.Series([5.0], index=[pd.Timestamp("2022-07-20T10:00Z")]),
        price_gbp_per_kwh=float("inf"),
        eta_charge={"big": 0.0},
        online={"small": False},
    )
    steps = "The scenario's steps begin at 2022-07-19T10:00:00+00:00 and last 60 min; there are 6."
    assert refusal(controller.step, wrong).splitlines() == [
        "measurement, time = 2022-07-19 10:30:00+00:00: is not the beginning of a step. " + steps,
        "measurement, load_kw of shop = -1.0: must be a number not below 0. "
        "Correct the measurement.",
        "measurement, pv_kw of roof = nan: must be a number not below 0. Correct the measurement.",
        "measurement, price_gbp_per_kwh = inf: must be a finite number. Correct the measurement.",
        "measurement, grid_limit_kw = 2022-07-20 10:00:00+00:00: is not the beginning of a step. "
        + steps,
        "measurement, soc = bgi: is not in the scenario. Did you mean big?",
        "measurement, soc of small = 15.0: must lie between 0 and 1. "
        "Give a share, for example 0.5.",
        "measurement, eta_charge of big = 0.0: must lie between 0.1 and 1. "
        "Give a share, for example 0.95.",
        "measurement, soc of big: is missing. Give the state of charge of every battery.",
        "measurement, online of small = False: needs a guard, which plans without the battery. "
        "Leave RunOptions.guard as it is.",
    ]
    with pytest.raises(InputError, match="is not the beginning of a step"):
        controller.window(pd.Timestamp("2022-07-19T10:30Z"))


@pytest.fixture
def net() -> Any:
    """Three loads behind two buses that a closed switch joins; PV of its own."""
    net = buses_in_a_row(4, 11.0)
    pp.create_bus(net, vn_kv=11.0)
    pp.create_switch(net, 3, 4, et="b")
    for bus, p_mw in ((1, 0.2), (2, 0.1), (4, 0.3), (4, 0.1)):
        pp.create_load(net, bus, p_mw=p_mw, q_mvar=0.3 * p_mw)
    pp.create_load(net, 2, p_mw=9.0, in_service=False)
    pp.create_sgen(net, 2, p_mw=0.08, type="PV", name="old roof")
    return net


def test_set_points_in_a_pandapower_net(net: Any) -> None:
    feeder = vppres.import_network(net)
    day = vppres.new_scenario(
        feeder,
        vppres.NewScenarioOptions(
            step_minutes=240.0,
            draw_tiers=True,
            add_batteries=True,
            outages=((pd.Timestamp("2025-07-01T12:00Z"), pd.Timestamp("2025-07-01T20:00Z")),),
        ),
    )
    controller = Controller.of(day, RunOptions(horizon_h=4.0))
    soc = dict.fromkeys(day.batteries.id, 0.5)
    for time in controller.times:
        decision = controller.step(Measurement(time, soc))
        soc = dict(decision.batteries["soc_end"])
        decision.apply_to(net, feeder)
        pp.runpp(net, numba=False, tolerance_mva=1e-9)
        # Nothing of this net is simplified: both power flows are of the same circuit.
        expected = decision.buses["v_ac_pu"].loc[[feeder.bus_of[i] for i in net.bus.index]]
        assert net.res_bus["vm_pu"].to_numpy() == pytest.approx(expected.to_numpy(), abs=1e-7)
        from_grid = net.res_ext_grid["p_mw"].sum() * 1000
        assert from_grid == pytest.approx(decision.import_kw, abs=1e-3)
        assert net.ext_grid["in_service"][0] == (decision.feeding.grid_bus is not None)
    assert not decision.customers.empty
    # What the scenario stands in for is kept, and off.
    assert (len(net.sgen), len(net.storage)) == (1 + len(day.pv), len(day.batteries))
    assert len(net.load) == 5 + len(day.customers)
    assert net.load["p_mw"].tolist()[:5] == [0.2, 0.1, 0.3, 0.1, 9.0]
    assert not net.load["in_service"][:5].any()
    assert not net.sgen["in_service"][0]


def test_set_points_of_another_net_are_refused(tiny: Scenario, net: Any) -> None:
    feeder = vppres.import_network(net)
    controller = Controller.of(tiny, RunOptions(horizon_h=0))
    decision = controller.step(Measurement(controller.times[0], SOC))
    net.load = net.load[net.load["bus"] != 2]
    before = net.load.copy()
    other = "is not a bus of the net. Give the net and the feeder that the scenario was made from."
    # Bus 4 of the net is one with bus 3.
    assert refusal(decision.apply_to, net, feeder).splitlines() == [
        f"set-points, bus of homes = 4: {other}",
        f"set-points, bus of field = 4: {other}",
        f"set-points, bus of small = 4: {other}",
        "set-points, bus of hospital = 2: the net has no load at this bus. Give the net that the "
        "scenario was made from.",
        "set-points, bus of homes = 4: the net has no load at this bus. Give the net that the "
        "scenario was made from.",
    ]
    pd.testing.assert_frame_equal(net.load, before)


def test_notebooks_show_tables(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=0))
    html = controller.step(Measurement(controller.times[0], SOC))._repr_html_()
    assert "<b>Set-points of 2022-07-19 10:00</b>" in html
    assert "<th>customers on</th><td>3 of 3</td>" in html
    assert html.count("<table") == 4
    assert "<th>batteries</th><td>2, 160 kWh</td>" in tiny._repr_html_()
    run = vppres.run_day(tiny, RunOptions(horizon_h=0))
    assert "<th>controller</th><td>mpc, 0 h</td>" in run._repr_html_()


def test_set_points_say_when_they_are_a_fallback(
    tiny: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=2.0, isolate=False))
    first = controller.step(Measurement(controller.times[0], SOC))
    assert (first.solve["fallback"], first.solve["fallback_reason"]) == ("none", "")

    def fails(*_: object) -> None:
        raise LimitError("the solver ran out of time")

    monkeypatch.setattr("vppres.solve.ladder.WindowSolver.solve", fails)
    second = controller.step(Measurement(controller.times[1], SOC))
    assert second.solve["fallback"] == second.solve["status"] == "previous_plan"
    assert "the solver ran out of time" in second.solve["fallback_reason"]
    assert "the solver ran out of time" in second._repr_html_()


# The door.


def refused(controller: Controller, **given: Any) -> list[str]:
    """What is said of a measurement of the first step."""
    measured = Measurement(**{"time": controller.times[0], "soc": SOC, **given})
    return refusal(controller.step, measured).splitlines()


LEAVE = "Give a number; leave out what was not measured, or give NaN."
WRITE = "Write it with an offset, for example 2022-07-19T12:00:00Z."


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"load_kw": {"shop": "40"}}, f"load_kw of shop = 40: is not a number. {LEAVE}"),
        ({"load_kw": {"shop": [40.0]}}, f"load_kw of shop = [40.0]: is not a number. {LEAVE}"),
        ({"load_kw": {"shop": pd.NA}}, f"load_kw of shop = <NA>: is not a number. {LEAVE}"),
        ({"load_kw": {"shop": None}}, f"load_kw of shop = None: is not a number. {LEAVE}"),
        (
            {"load_kw": {"shop": {"homes": 1.0}}},
            f"load_kw of shop = {{'homes': 1.0}}: is not a number. {LEAVE}",
        ),
        ({"load_kw": {"shop": True}}, f"load_kw of shop = True: is not a number. {LEAVE}"),
        (
            {"load_kw": {"\x1b": 1.0}},
            "load_kw = '\\x1b': is not in the scenario. Correct the "
            "identifier. Known: hospital, shop, homes.",
        ),
        (
            {"load_kw": 40.0},
            "load_kw = float 40.0: is not a mapping, a Series or a DataFrame by time. "
            "Give values by identifier, for example {'a': 1}.",
        ),
        (
            {"load_kw": pd.Series([1.0, 2.0], index=["shop", "shop"])},
            "load_kw = shop: is given more than once. Give each identifier once.",
        ),
        (
            {
                "pv_kw": pd.DataFrame(
                    [[1.0, 2.0]],
                    columns=["roof", "roof"],
                    index=[pd.Timestamp("2022-07-19T10:00Z")],
                )
            },
            "pv_kw = roof: is given more than once. Give each identifier once.",
        ),
        (
            {"pv_kw": pd.DataFrame({"roof": [1.0]}, index=["2022-07-19T10:00"])},
            f"pv_kw = 2022-07-19T10:00: has no time zone. {WRITE}",
        ),
        (
            {
                "pv_kw": pd.DataFrame(
                    {"roof": [1.0, np.nan]},
                    index=pd.to_datetime(["2022-07-19T10:00Z", "2022-07-19T11:00Z"]),
                )
            },
            "pv_kw of roof = nan: must be a number not below 0. Correct the measurement.",
        ),
        (
            {"grid_limit_kw": pd.Series([1.0, 2.0], index=["2022-07-19T10:00Z"] * 2)},
            "grid_limit_kw = 2022-07-19 10:00:00+00:00: is given more than once. Give each time once.",
        ),
        ({"price_gbp_per_kwh": [0.3]}, f"price_gbp_per_kwh = [0.3]: is not a number. {LEAVE}"),
        ({"soc": {"big": 0.5, "small": "half"}}, f"soc of small = half: is not a number. {LEAVE}"),
        (
            {"soc": [0.5, 0.5]},
            "soc = list [0.5, 0.5]: is not a mapping or a Series. Give values by "
            "identifier, for example {'a': 1}.",
        ),
        (
            {"online": {"big": 1}},
            "online of big = 1: is neither true nor false. Give True or False.",
        ),
        ({"import_kw": "much"}, f"import_kw = much: is not a number. {LEAVE}"),
        ({"time": "2022-07-19T10:00"}, f"time = 2022-07-19T10:00: has no time zone. {WRITE}"),
        ({"time": "now"}, f"time = now: is not a date and time. {WRITE}"),
        ({"time": pd.NaT}, f"time = NaT: is not a date and time. {WRITE}"),
    ],
)
def test_each_mistake_names_quantity_value_and_cure(
    tiny: Scenario, given: dict[str, Any], text: str
) -> None:
    assert refused(Controller.of(tiny), **given) == [f"measurement, {text}"]


def test_many_mistakes_of_a_kind_are_counted(tiny: Scenario) -> None:
    lines = refused(Controller.of(tiny), load_kw={f"x{i}": 1.0 for i in range(5000)})
    assert len(lines) == 21
    assert lines[-1] == "measurement, load_kw: has 4980 more problems. Fix those above first."


class Liar(dict[str, float]):
    """A mapping that raises what it likes."""

    def items(self) -> Any:
        raise LookupError("not today")


def test_what_cannot_be_read_is_an_input_error(tiny: Scenario) -> None:
    controller = Controller.of(tiny)
    assert refused(controller, load_kw=Liar()) == [
        "measurement: cannot be read: LookupError, not today. Give plain dictionaries, numbers, "
        "Series and DataFrames."
    ]
    [line] = refused(controller, foretold=5)
    assert line.startswith("measurement: cannot be read: AttributeError")
    with pytest.raises(InputError, match="observation = 5: is not a Measurement"):
        controller.step(5)  # type: ignore[arg-type]


def test_time_may_be_text_and_never_goes_back(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=0))
    assert list(controller.window("2022-07-19T13:00:00+01:00")) == [controller.times[2]]
    decision = controller.step(Measurement("2022-07-19T13:00:00+01:00", SOC))
    assert decision.time == controller.times[2]
    assert refused(controller, time=controller.times[1]) == [
        "measurement, time = 2022-07-19 11:00:00+00:00: lies before the step that was decided "
        "last, 2022-07-19T12:00:00+00:00. Decide steps in their order; to begin again, make "
        "another Controller."
    ]


@pytest.mark.parametrize(("given", "text"), [
    ({"gap_rel": 0.0}, "gap_rel = 0.0"),
    ({"gap_abs": float("nan")}, "gap_abs = nan"),
    ({"time_s": float("inf")}, "time_s = inf"),
    ({"time_s": "long"}, "time_s = long"),
    ({"time_s": True}, "time_s = True"),
])  # fmt: skip
def test_limits_of_a_solve_are_checked(given: dict[str, Any], text: str) -> None:
    with pytest.raises(
        InputError, match=f"^options, limits.{text}: must be positive. Give a number above 0.$"
    ):
        SolveLimits(**given)


# What the guard promises is there live.


def test_missing_readings_are_estimated(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=2.0))
    first = controller.step(Measurement(controller.times[0], SOC))
    left = dict(first.batteries["soc_end"])
    second = controller.step(
        Measurement(controller.times[1], load_kw={"shop": -3.0}, pv_kw={"roof": float("nan")})
    )
    known = Controller.of(tiny, RunOptions(horizon_h=2.0))
    known.step(Measurement(known.times[0], SOC))
    told = known.step(Measurement(known.times[1], left))
    assert second.solve["estimated"] == (
        f"soc big {left['big']:.4f} +-0.010 (missing); "
        f"soc small {left['small']:.4f} +-0.010 (missing); "
        "load shop 41.00 kW (missing); pv roof 28.00 kW (missing)"
    )
    assert second.customers.equals(told.customers)
    assert second.batteries.to_numpy() == pytest.approx(told.batteries.to_numpy(), abs=1e-5)


def test_state_of_charge_far_outside_is_a_reading_as_any_other(tiny: Scenario) -> None:
    """It counts as the limit that it is beyond."""
    found = []
    for big in (0.95, float(tiny.batteries.soc_max[0])):
        controller = Controller.of(tiny, RunOptions(horizon_h=0))
        controller.step(Measurement(controller.times[3], SOC))
        found.append(controller.step(Measurement(controller.times[4], {**SOC, "big": big})))
    assert found[0].solve["estimated"] == ""
    assert found[0].batteries.equals(found[1].batteries)


def test_set_points_are_held_over_steps_that_were_left_out(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=0))
    first = controller.step(Measurement(controller.times[3], SOC))
    change = first.batteries["soc_end"]["big"] - 0.5
    later = controller.step(Measurement(controller.times[5], {"small": 0.5}))
    assert change < -0.1
    left, band = max(0.5 + 2 * change, 0.15), 2 * (0.01 - 0.1 * change)
    assert later.solve["estimated"] == f"soc big {left:.4f} +-{band:.3f} (missing)"


def test_silent_battery_and_one_that_reports_to_be_out(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=0))
    first = controller.step(Measurement(controller.times[3], SOC))
    assert first.batteries["p_kw"]["big"] < -1.0
    silent = controller.step(
        Measurement(
            controller.times[4],
            SOC,
            battery_kw={"big": 0.0, "small": first.batteries["p_kw"]["small"]},
        )
    )
    assert silent.solve["estimated"] == "battery big is out"
    assert silent.batteries["p_kw"]["big"] == silent.batteries["q_kvar"]["big"] == 0.0
    told = Controller.of(tiny, RunOptions(horizon_h=0)).step(
        Measurement(controller.times[4], SOC, online={"small": False})
    )
    assert told.solve["estimated"] == "battery small is out"
    assert told.batteries["p_kw"]["small"] == 0.0


def test_frozen_demand_shows_in_the_import(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=1.0))
    frozen = {"hospital": 60.0, "shop": 40.0, "homes": 50.0}
    rise_kw = np.array([0.0, 30.0, 35.0])  # what customers really take beyond the readings
    words = []
    soc: dict[str, float] = SOC
    came: dict[str, Any] = {}
    for t in range(3):
        decision = controller.step(Measurement(controller.times[t], soc, load_kw=frozen, **came))
        words.append(decision.solve["estimated"])
        soc = dict(decision.batteries["soc_end"])
        came = {
            "battery_kw": dict(decision.batteries["p_kw"]),
            "import_kw": decision.import_kw + rise_kw[t],
        }
    assert words == ["", "", "load of all 3, 153.0 kW (frozen)"]


# A step that fails or is decided again.


@pytest.mark.parametrize("kind", ["mpc", "full-horizon"])
def test_step_that_fails_leaves_the_controller_as_it_was(
    tiny: Scenario, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rules = SwitchingRules(min_unserved_h=2.0)
    options = RunOptions(controller=kind, horizon_h=2.0, switching=rules)
    plain = followed(tiny, options)
    controller = Controller.of(tiny, options)
    soc = dict(zip(tiny.batteries.id, tiny.batteries.soc_initial, strict=True))
    for time, expected in zip(controller.times, plain, strict=True):
        for error, raised in (
            (VerificationError("no solution"), VerificationError),
            (ZeroDivisionError("oh"), SolveError),
            (KeyboardInterrupt(), KeyboardInterrupt),
        ):
            with monkeypatch.context() as patch:

                def fails(*_: object, error: BaseException = error) -> None:
                    raise error

                patch.setattr("vppres.day.simulate.Day.settle", fails)
                with pytest.raises(raised):
                    controller.step(Measurement(time, {"big": 0.4, "small": 0.4}))
        with pytest.raises(InputError):
            controller.step(Measurement(time, {"bgi": 0.4}))
        decision = controller.step(Measurement(time, soc))
        soc = dict(decision.batteries["soc_end"])
        for name in ("customers", "batteries", "pv", "buses"):
            assert getattr(decision, name).equals(getattr(expected, name)), name
        for now in (time, time + pd.Timedelta("10min")):  # the step again, and the rest of it
            with pytest.raises(InputError):
                controller.step(Measurement(time, {"bgi": 0.4}, now=now))
        last = controller.last  # the decision of the set-points
        assert last is not None
        assert last.dispatch.served[last.row].tolist() == decision.customers["served"].tolist()
        assert last.seen is not None
        assert last.seen.soc.tolist() == decision.batteries["soc"].tolist()


def test_step_decided_again_takes_the_place_of_the_first(tiny: Scenario) -> None:
    rules = SwitchingRules(min_unserved_h=2.0, max_actions_per_customer=2)
    options = RunOptions(horizon_h=1.0, switching=rules)
    plain = followed(tiny, options)
    controller = Controller.of(tiny, options)
    soc = dict(zip(tiny.batteries.id, tiny.batteries.soc_initial, strict=True))
    for time, expected in zip(controller.times, plain, strict=True):
        controller.step(Measurement(time, soc, load_kw={"shop": 500.0}, grid_limit_kw=0.0))
        decision = controller.step(Measurement(time, soc))
        soc = dict(decision.batteries["soc_end"])
        assert decision.customers.equals(expected.customers)
        assert decision.batteries.equals(expected.batteries)


# Threads.


@pytest.mark.daily
def test_two_threads_answer_as_one_does(nightly: bool) -> None:
    seeds = range(20 if nightly else 1)
    assert differing(seeds) == (20 * len(seeds), 0)


@pytest.mark.nightly
def test_days_in_two_threads_are_those_of_one(tiny: Scenario) -> None:
    options = RunOptions(horizon_h=2.0)
    days = [tiny, replace(tiny, load_kw=0.5 * tiny.load_kw)] * 2
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda day: vppres.run_day(day, options), days))
    for run, alone in zip(
        together, [vppres.run_day(day, options) for day in days[:2]] * 2, strict=True
    ):
        for name in ("customers", "batteries", "pv", "buses"):
            assert run.tables[name].equals(alone.tables[name]), name


# Garbage.


@pytest.mark.daily
def test_garbage_is_refused_by_name_or_answered_within_ratings(nightly: bool) -> None:
    outcomes = [run_one(seed) for seed in range(40 if nightly else 2)]
    assert [text for _, wrong in outcomes for text in wrong] == []
    refused = sum(each for each, _ in outcomes) / len(outcomes)
    assert 6 < refused < MEASUREMENTS - 6


def test_set_points_beyond_a_limit_are_seen(tiny: Scenario) -> None:
    done = Controller.of(tiny, RunOptions(horizon_h=0)).step(Measurement(tiny.grid.times[3], SOC))
    assert beyond_limits(tiny, done) == []
    done.batteries.loc["big", ["p_kw", "q_kvar", "soc_end"]] = [51.0, 40.0, 0.9]
    done.pv.loc["roof", ["p_kw", "q_kvar"]] = [np.nan, 0.0]
    assert beyond_limits(tiny, done) == [
        "battery rating by 1",
        f"battery disc by {np.hypot(51, 40) - 60:g}",
        "state of charge by 0.05",
        "pv disc by nan",
        "pv sign by nan",
    ]


def test_rounding_loses_nobody_of_the_plan_before(tiny: Scenario) -> None:
    """A state of charge as planned may miss the need of the last customer by a tolerance."""
    options = RunOptions(horizon_h=1.0, guard=False).on(tiny)
    controller = make_controller(tiny, options)
    assert isinstance(controller, MPCController)
    day = Day(tiny, options)
    day.step(controller, 0)
    really = controller.planner
    now = day.observe(controller, 1)

    class Missing:
        """Plans nobody with the state of charge as it is."""

        def plan(self, observation: Observation, n_steps: int | None = None) -> WindowSolution:
            found = really.plan(observation, n_steps)
            if not np.array_equal(observation.soc, now.soc):
                return found
            nobody = replace(found.dispatch, served=np.zeros_like(found.dispatch.served))
            return replace(found, dispatch=nobody, terms=replace(found.terms, f1=0.0))

    controller.planner = Missing()
    assert controller.decide(now).dispatch.served[0].all()
    controller._last = None
    assert not controller.decide(now).dispatch.served[0].any()
