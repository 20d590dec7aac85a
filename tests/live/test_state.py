"""A controller's state: saved, shown, put into another controller, which goes on to the last bit."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.failing_solvers import BAD_PRICE, Refusing
from tests.support.long_days import repeated
from tests.support.refusals import refusal
from tests.support.same_steps import same
from vppres.core.arrays import Flags, Floats
from vppres.core.errors import InputError
from vppres.core.plain import from_plain, to_plain
from vppres.day.options import RunOptions
from vppres.io.find import load_scenario
from vppres.kinds.customer.data import SwitchingRules
from vppres.live.controller import Controller
from vppres.live.feed import Feed
from vppres.live.measurement import Measurement
from vppres.live.set_points import SetPoints
from vppres.scenario.history import History
from vppres.scenario.outage_warnings import OutageStatistics, OutageWarning
from vppres.scenario.scenario import Scenario

RULES = SwitchingRules(
    min_unserved_h=2.0, min_served_h=2.0, max_actions_per_customer=4, move_weight=0.1
)
COLD = SwitchingRules(min_unserved_h=2.0, cold_load_factor=1.3, cold_load_h=2.0)


def stormy(tiny: Scenario, n_steps: int = 36) -> Scenario:
    """The tiny day over and over, each time with another demand; each has its outage."""
    day = repeated(tiny, n_steps, "2025-07-01T18:00Z")
    return replace(day, load_kw=day.load_kw * (1.0 + 0.2 * np.sin(np.arange(n_steps))[:, None]))


def measured(time: pd.Timestamp, before: SetPoints | None, step: int) -> Measurement:
    """What a plant that follows its set-points shows; in some steps a part of it fails."""
    if before is None:
        return Measurement(time, {"big": 0.4, "small": 0.5})
    soc = dict(before.batteries["soc_end"])
    power = dict(before.batteries["p_kw"])
    now = Measurement(time, soc, battery_kw=power, import_kw=before.import_kw)
    faults: dict[int, dict[str, Any]] = {
        3: {"soc": {"big": soc["big"]}},
        5: {"online": {"small": False}},
        6: {"load_kw": {"homes": np.nan, "shop": 40.0}},
        7: {"load_kw": {"homes": 50.0, "shop": 40.0, "hospital": 60.0}, "pv_kw": {"roof": 20.0}},
        8: {"load_kw": {"homes": 50.0, "shop": 40.0, "hospital": 60.0}, "pv_kw": {"roof": 20.0}},
        9: {"battery_kw": dict.fromkeys(power, 0.0)},
        14: {"soc": None, "import_kw": None},
    }
    return replace(now, **faults.get(step, {}))


def played(day: Scenario, options: RunOptions, relay: bool) -> Iterator[SetPoints]:
    """Decisions of all steps, by one controller or by another one at every step."""
    controller = Controller.of(day, options)
    before = None
    for step, time in enumerate(day.grid.times):
        if relay:
            controller = Controller.of(
                day, options, state=json.loads(json.dumps(controller.state(), allow_nan=False))
            )
        before = controller.step(measured(time, before, step))
        yield before


@pytest.mark.daily
@pytest.mark.parametrize("options", [
    RunOptions(horizon_h=1.0, switching=RULES, protect_critical=True),
    pytest.param(RunOptions(horizon_h=1.0, mode="physical", switching=COLD, soc_end=0.5),
        marks=pytest.mark.nightly),
    pytest.param(RunOptions(horizon_h=1.0, forecaster="seasonal"), marks=pytest.mark.nightly),
    pytest.param(RunOptions("full-horizon", mode="physical"), marks=pytest.mark.nightly),
    pytest.param(RunOptions("reserve"), marks=pytest.mark.nightly),
    RunOptions(outages="belief"),
], ids=["rules", "physical", "seasonal", "full", "reserve", "belief"])  # fmt: skip
def test_a_relay_of_controllers_decides_as_one(tiny: Scenario, options: RunOptions) -> None:
    """Every step by a controller that knows of the ones before only what a file held."""
    day = stormy(tiny, 10 if options.controller == "mpc" else 8)
    if options.forecaster == "seasonal":
        before = repeated(stormy(tiny), 72, "2025-06-28T18:00Z")
        history = History(before.grid.start, 60.0, before.load_kw, before.pv_kw)
        day = replace(day.between(0, 9), history=history)
    if options.outages == "belief":
        often = OutageStatistics(saifi_per_year=300.0)
        told = OutageWarning(day.grid.start, onset_likely=day.grid.times[6], duration_p50_h=9.0)
        day = replace(day, outage_statistics=often, warnings=(told,))
    here = replace(options, isolate=False)
    for one, other in zip(played(day, here, False), played(day, here, True), strict=True):
        assert same(one, other), one.time


def test_fallbacks_are_remembered(tiny: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vppres.day.assembly.WindowSolver", Refusing)
    day = stormy(tiny, 9)
    price = day.price_gbp_per_kwh.copy()
    price[[2, 7]] = BAD_PRICE
    day = replace(day, price_gbp_per_kwh=price)
    options = RunOptions(horizon_h=2.0, isolate=False)
    alone = list(played(day, options, False))
    relay = list(played(day, options, True))
    assert [d.solve["fallback"] for d in alone].count("none") == 7
    for one, other in zip(alone, relay, strict=True):
        assert same(one, other) and one.solve["fallback"] == other.solve["fallback"]


@pytest.mark.nightly
def test_the_packaged_day_goes_on_in_another_process(tmp_path: Path) -> None:
    """The outage begins between the two processes."""
    day = load_scenario("uk-heatwave-2022")
    options = RunOptions(horizon_h=1.0, isolate=False)
    controller = Controller.of(day, options)
    for time in day.grid.times[11:12]:
        controller.step(Measurement(time, dict.fromkeys(day.batteries.id, 0.5)))
    saved = tmp_path / "state.json"
    saved.write_text(json.dumps(controller.state(), allow_nan=False), encoding="utf-8")
    code = f"""
import json, vppres
day = vppres.load_scenario("uk-heatwave-2022")
state = json.load(open({str(saved)!r}, encoding="utf-8"))
controller = vppres.Controller.of(
    day, vppres.RunOptions(horizon_h=1.0, isolate=False), state=state
)
step = controller.step(vppres.Measurement(day.grid.times[12]))
print(step.batteries.to_json(double_precision=15), step.import_kw, step.solve["bound"])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    here = controller.step(Measurement(day.grid.times[12]))
    words = f"{here.batteries.to_json(double_precision=15)} {here.import_kw} {here.solve['bound']}"
    assert done.stdout.strip() == words


# Attributes of controllers that are no memory: made anew with them, or read before they are set.
MADE_ANEW = {"_critical", "_solvers", "_sweeps", "_controller_of", "_solver_of", "known", "solver"}


def parts_of(found: object, known: set[int]) -> Iterator[object]:
    """The object and the parts of it that belong to controllers, each once."""
    if isinstance(found, dict):
        for value in found.values():
            yield from parts_of(value, known)
    ours = type(found).__module__.startswith("vppres.control.") and hasattr(found, "__dict__")
    if ours and id(found) not in known:
        known.add(id(found))
        yield found
        for value in list(vars(found).values()):
            yield from parts_of(value, known)


def plain_parts(controller: Controller) -> list[str]:
    """All that the parts of a controller hold, as text, but for what is made anew."""
    found = []
    for part in parts_of(controller._decider, set()):
        values = {k: v for k, v in vars(part).items() if k not in MADE_ANEW}
        for name, value in values.items():
            if type(value).__module__.startswith("vppres.control.") and name != "_soc":
                continue  # a part of its own, or a table of constants
            text = repr(to_plain(value)) if name != "_parts" else str(list(value))
            found.append(f"{type(part).__name__}.{name} = {text}")
    return found


def test_nothing_that_a_controller_holds_is_forgotten(tiny: Scenario) -> None:
    """An attribute that is neither remembered nor made anew shows up here."""
    day = stormy(tiny, 12)
    for options in (
        RunOptions(horizon_h=2.0, mode="physical", switching=RULES),
        RunOptions("full-horizon", mode="physical"),
    ):
        options = replace(options, isolate=False)
        controller = Controller.of(day, options)
        before = None
        for step, time in enumerate(day.grid.times[:7]):
            before = controller.step(measured(time, before, step))
        again = Controller.of(day, options, state=controller.state())
        assert plain_parts(again) == plain_parts(controller)
        assert again.state() == controller.state()


def test_the_last_step_may_be_decided_again_after_a_restart(tiny: Scenario) -> None:
    options = RunOptions(horizon_h=2.0, switching=RULES, isolate=False)
    controller = Controller.of(stormy(tiny), options)
    before = None
    for step, time in enumerate(controller.times[:5]):
        before = controller.step(measured(time, before, step))
    restarted = Controller.of(stormy(tiny), options, state=controller.state())
    dark = Measurement(controller.times[4], {"big": 0.3, "small": 0.3})
    assert same(controller.step(dark), restarted.step(dark))
    later = Measurement(controller.times[5])
    assert same(controller.step(later), restarted.step(later))


def test_what_was_fed_and_forgotten_goes_along(tiny: Scenario) -> None:
    truth = stormy(tiny, 18)
    options = RunOptions(horizon_h=2.0, isolate=False)
    controller = Controller.of(truth.between(0, 6), options)
    for time in controller.times[:5]:
        controller.step(Measurement(time))
    controller.extend(Feed.of(truth.between(6, 18)))
    # The scenario of another day: its site counts.
    again = Controller.of(truth.between(12, 18), options, state=controller.state())
    assert again.times.equals(controller.times)
    assert again.times[0] == truth.grid.times[4]
    assert same(
        again.step(Measurement(truth.grid.times[5])),
        controller.step(Measurement(truth.grid.times[5])),
    )


@pytest.mark.parametrize(("change", "text"), [
    ({"version": 99}, "state, version = 99: has another layout than this version's, 8. Go on"),
    ({"kind": "a poem"}, "state: is not the state of a controller."),
    ({"site": "0" * 64}, "state: is damaged: it is not as it was written."),
    (None, "state: is not the state of a controller."),
])  # fmt: skip
def test_what_is_no_state_is_refused(tiny: Scenario, change: Any, text: str) -> None:
    options = RunOptions(horizon_h=0.0, isolate=False)
    state = Controller.of(tiny, options).state()
    assert text in refusal(
        Controller.of, tiny, options, state="x" if change is None else {**state, **change}
    )


def test_a_state_of_another_site_or_controller_is_refused(tiny: Scenario) -> None:
    options = RunOptions(horizon_h=0.0, isolate=False)
    state = Controller.of(tiny, options).state()
    smaller = replace(tiny, batteries=replace(tiny.batteries, energy_kwh=[50.0, 60.0]))
    with pytest.raises(InputError, match="is of another site"):
        Controller.of(smaller, options, state=state)
    with pytest.raises(InputError, match="state, mode = physical: was written with paper"):
        Controller.of(tiny, replace(options, mode="physical"), state=state)
    # What only looks further ahead goes on.
    assert Controller.of(tiny, replace(options, horizon_h=2.0), state=state).state() == state


def as_in_version_7(state: dict[str, Any], day: Scenario) -> dict[str, Any]:
    """As an earlier version wrote it: the step before in five pieces, none before the first."""

    def older(old: dict[str, Any]) -> dict[str, Any]:
        if "before" not in old.get("series", ()):
            return old
        now = dict(old["series"]["before"])
        began = now["t"] >= 0
        share = None if set(now["share"]) == {1.0} else now["share"]
        said = {name: now.pop(name) for name in ("served", "pv_curtailed_kw", "battery_kw")}
        pair = {name: now.pop(name) for name in ("load_kw", "pv_kw")}
        series = {
            "_far": now.pop("far"),
            "_frozen": {name: now.pop(f"frozen_{name}") for name in ("load", "pv")},
            "_usual": {name: now.pop(name) for name in ("least_kw", "most_kw")},
        }
        expected = {name: now.pop(f"expected_{name}") for name in pair}
        del now["share"]
        before = {**now, "seen": pair, "expected": expected} if began else None
        commanded = {**said, "share": share} if began else None
        return {**old, "_commanded": commanded, "series": {"_before": before, **series}}

    return signed({**everywhere(state, older), "version": 7})


def as_in_version_6(state: dict[str, Any], day: Scenario) -> dict[str, Any]:
    """As an earlier version wrote it, of a site without rules.

    It had no table where nothing matters, and vehicles and rooms were those after their step.
    """

    def older(old: dict[str, Any]) -> dict[str, Any]:
        if "owed" not in old:
            return old
        owed = None if isinstance(old["owed"]["kw"], dict) else old["owed"]  # no rows
        limited = any(each != "inf" for each in old["switching"]["longest_off_h"])
        online = {"online": None} if "online" in old else {}
        return {**old, "owed": owed, "switching": old["switching"] if limited else None, **online}

    state = as_in_version_7(state, day)
    for moment in filter(None, (state["now"], state["before"])):
        after_their_step(moment["past"]["kinds"], day)
    return signed({**everywhere(state, older), "version": 6})


def after_their_step(kinds: dict[str, Any], day: Scenario) -> None:
    """Vehicles and rooms as they are after their step, in place."""
    for kind, later in (("chargers", "end_kwh"), ("thermal_loads", "rests_at_c")):
        one = kinds.get(kind)
        if one is None:
            continue
        del one["at_h"]
        after = one.pop(later)
        if kind == "chargers":
            one["kwh"] = after
            continue
        kept = np.exp(
            -day.grid.dt_h / (day.thermal_loads.r_c_per_kw * day.thermal_loads.c_kwh_per_c)
        )
        rests_c, t_c = np.array(after), np.array(one["reckoned_c"])
        one["reckoned_c"] = (rests_c + (t_c - rests_c) * kept).tolist()
        one["lowest_c"] = np.minimum(one["lowest_c"], one["reckoned_c"]).tolist()
        one["highest_c"] = np.maximum(one["highest_c"], one["reckoned_c"]).tolist()


def as_in_version_4(state: dict[str, Any], day: Scenario) -> dict[str, Any]:
    """As an earlier version wrote it, in which nothing said which lines are out."""

    def older(old: dict[str, Any]) -> dict[str, Any]:
        old = old | dict.fromkeys({"lines_out"} & old.keys())
        if isinstance(old.get("out"), dict):
            old["out"] = None
        return {name: each for name, each in old.items() if name != "faults"}

    return signed({**everywhere(as_in_version_6(state, day), older), "version": 4})


def everywhere(value: Any, changed: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    """A plain value of which every dictionary is changed."""
    if isinstance(value, list):
        return [everywhere(each, changed) for each in value]
    if not isinstance(value, dict):
        return value
    return changed({name: everywhere(each, changed) for name, each in value.items()})


def signed(state: dict[str, Any]) -> dict[str, Any]:
    """The state with the digest of what it says."""
    body = {name: each for name, each in state.items() if name != "digest"}
    text = json.dumps(body, sort_keys=True, allow_nan=False, separators=(",", ":"))
    return {**body, "digest": hashlib.sha256(text.encode()).hexdigest()}


def as_in_version_3(state: dict[str, Any], day: Scenario) -> dict[str, Any]:
    """As an earlier version wrote it: a field for each kind, and powers of all as one."""
    old = {**as_in_version_4(state, day), "version": 3}
    for moment in (old["now"], old["before"]):
        kinds = moment["past"].pop("kinds")
        own = {"vehicles": "chargers", "rooms": "thermal_loads", "sets": "gensets"}
        for name, kind in own.items():
            moment["past"][name] = kinds.get(kind)
            if name != "sets":
                del moment["past"][name]["taken_kw"]
        cold_load = {"served": [True], "steps_left": [0]}  # the switching state says it too
        moment["past"] |= {"flexible_kw": 0.0, "flexible_off_kw": 0.0, "cold_load": cold_load}
    return signed(old)


EARLIER = [as_in_version_3, as_in_version_4, as_in_version_6, as_in_version_7]


def test_the_step_before_is_put_together_of_its_five_pieces(tiny: Scenario) -> None:
    """Also before the first step, and with a customer that was dimmed."""
    options = RunOptions("reserve", isolate=False)
    controller = Controller.of(tiny, options)
    judge = controller._decider._estimator.series  # type: ignore[attr-defined]
    some, rng = judge.before, np.random.default_rng(8)
    values = {
        name: rng.random(len(each)) < 0.5 if each.dtype == bool else rng.random(len(each))
        for name, each in vars(some).items()
        if isinstance(each, np.ndarray)
    }
    values["share"] = np.where(values["served"], values["share"], 1.0)
    for before in (some, replace(some, t=4, most_import_kw=0.5, **values)):
        judge.before = before
        state = json.loads(json.dumps(controller.state()))
        old = as_in_version_7(state, tiny)
        assert Controller.of(tiny, options, state=old).state() == state


@pytest.mark.parametrize("earlier", EARLIER)
def test_a_state_of_a_version_before_is_gone_on_from(
    earlier: Callable[[Any, Scenario], Any],
) -> None:
    day = load_scenario("village-hot-week").between(80, 86)
    soc = {str(name): 0.5 for name in day.batteries.id}
    options = RunOptions(horizon_h=0.0, isolate=False)
    controller = Controller.of(day, options)
    for time in day.grid.times[:2]:
        points = controller.step(Measurement(time, soc))
    assert points.chargers is not None and points.thermal_loads is not None
    old = earlier(json.loads(json.dumps(controller.state())), day)
    again = Controller.of(day, options, state=old)
    for time in day.grid.times[2:4]:
        assert same(again.step(Measurement(time, soc)), controller.step(Measurement(time, soc)))


def test_a_state_without_tables_of_what_does_not_matter_is_gone_on_from(tiny: Scenario) -> None:
    options = RunOptions(horizon_h=0.0, isolate=False)
    controller = Controller.of(tiny, options)
    first, second = (Measurement(time, {"big": 0.5, "small": 0.5}) for time in tiny.grid.times[:2])
    controller.step(first)
    old = as_in_version_6(json.loads(json.dumps(controller.state())), tiny)
    assert old["now"]["past"]["switching"] is old["now"]["past"]["owed"] is None
    assert same(Controller.of(tiny, options, state=old).step(second), controller.step(second))


def test_plain_values_come_back_to_the_bit() -> None:
    numbers = np.array([0.1 + 0.2, -0.0, np.inf, -np.inf, np.nan, 5e-324, 1e308])
    back = from_plain(Floats, json.loads(json.dumps(to_plain(numbers))), "x")
    assert back.tobytes() == np.where(np.isnan(numbers), np.nan, numbers).tobytes()
    for shape in ((3, 0), (0, 3), (0,)):
        assert from_plain(Floats, to_plain(np.zeros(shape)), "x").shape == shape
    with pytest.raises(InputError, match="x: holds other values than expected"):
        from_plain(Flags, [1.0, 0.5], "x")
    with pytest.raises(InputError, match="x: is of the type bool"):
        from_plain(int, True, "x")
