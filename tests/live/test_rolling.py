"""A controller that rolls: fed as time goes, it decides as one that knew everything."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.long_days import repeated
from tests.support.refusals import refusal
from tests.support.same_steps import same
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.kinds.customer.data import SwitchingRules
from vppres.live.controller import Controller
from vppres.live.feed import Feed
from vppres.live.measurement import Measurement
from vppres.live.set_points import SetPoints
from vppres.scenario.scenario import Scenario

HOUR = pd.Timedelta("1h")


def rolled(tiny: Scenario, n_steps: int = 30) -> Scenario:
    """Hours from six in the evening on, each six like the tiny day with demand of their own."""
    day = repeated(tiny, n_steps, "2025-07-01T18:00Z")
    return replace(day, load_kw=day.load_kw * (1.0 + 0.2 * np.sin(np.arange(n_steps))[:, None]))


def played(controller: Controller, pieces: list[Scenario], ahead: int) -> Iterator[SetPoints]:
    """Decisions of all steps; a piece is fed when less than ``ahead`` steps are known."""
    soc = dict(zip(controller.scenario.batteries.id, (0.4, 0.5), strict=True))
    now = controller.times[0]
    while now < controller.scenario.grid.end or pieces:
        while pieces and now + ahead * HOUR > controller.scenario.grid.end:
            controller.extend(pieces.pop(0))
        decision = controller.step(Measurement(now, soc))
        yield decision
        soc = dict(decision.batteries["soc_end"])
        now += HOUR


@pytest.mark.nightly
@pytest.mark.parametrize(("options", "piece"), [
    ({"horizon_h": 3.0}, 5),
    pytest.param({"horizon_h": 2.0, "mode": "physical"}, 12, marks=pytest.mark.nightly),
    ({"controller": "reserve"}, 9),
])  # fmt: skip
def test_fed_in_pieces_it_decides_as_one_that_knew_everything(
    tiny: Scenario, options: dict[str, Any], piece: int
) -> None:
    truth = rolled(tiny)
    truth = replace(truth, batteries=replace(truth.batteries, grid_forming=[True, False]))
    rules = SwitchingRules(min_unserved_h=2.0, max_actions_per_customer=2, cold_load_factor=1.2)
    chosen = RunOptions(**options, switching=rules, isolate=False)
    whole = list(played(Controller.of(truth, chosen), [], 0))
    cuts = [*range(piece, 30, piece), 30]
    rolling = Controller.of(truth.between(0, piece), chosen)
    fed = list(played(rolling, [truth.between(a, b) for a, b in pairwise(cuts)], ahead=7))
    assert len(whole) == len(fed) == 30
    assert [same(one, other) for one, other in zip(whole, fed, strict=True)] == [True] * 30
    assert any(not decision.customers["served"].all() for decision in fed)
    # Of what is over, the last decided step at the time of the last piece is kept.
    assert rolling.scenario.grid.n_steps < 30
    assert rolling.times[-1] == truth.grid.times[-1]


def test_a_window_is_cut_where_what_is_known_ends(tiny: Scenario) -> None:
    truth = rolled(tiny, 12)
    controller = Controller.of(truth.between(0, 6), RunOptions(horizon_h=3.0, isolate=False))
    now = controller.times[4]
    assert controller.window(now).tolist() == truth.grid.times[4:6].tolist()
    controller.extend(truth.between(6, 12))
    assert controller.window(now).tolist() == truth.grid.times[4:8].tolist()


def test_full_horizon_plans_anew_when_its_plan_is_over(tiny: Scenario) -> None:
    truth = rolled(tiny, 12)
    options = RunOptions(controller="full-horizon", isolate=False)
    controller = Controller.of(truth.between(0, 6), options)
    made = list(played(controller, [truth.between(6, 12)], ahead=1))
    # The first day's plan is as good as that of a controller of this day alone.
    alone = list(played(Controller.of(truth.between(0, 6), options), [], 0))
    assert [same(one, other) for one, other in zip(made[:6], alone, strict=True)] == [True] * 6
    planned = [t for t, decision in enumerate(made) if np.isfinite(decision.solve["objective"])]
    assert (planned[0], 6 in planned) == (0, True)
    assert len(made) == 12


def test_the_last_step_may_be_decided_again_after_history_was_dropped(tiny: Scenario) -> None:
    truth = rolled(tiny, 12)
    controller = Controller.of(truth.between(0, 6), RunOptions(horizon_h=1.0, isolate=False))
    soc = {"big": 0.4, "small": 0.5}
    for time in controller.times[:4]:
        first = controller.step(Measurement(time, soc))
    controller.extend(truth.between(6, 12))
    assert controller.times[0] == truth.grid.times[3]
    assert same(first, controller.step(Measurement(truth.grid.times[3], soc)))
    with pytest.raises(InputError, match="is not the beginning of a step"):
        controller.step(Measurement(truth.grid.times[2], soc))


def test_history_may_be_kept(tiny: Scenario) -> None:
    truth = rolled(tiny, 12)
    controller = Controller.of(truth.between(0, 6), RunOptions(horizon_h=0.0, isolate=False))
    controller.step(Measurement(controller.times[5]))
    controller.extend(truth.between(6, 12), forget=False)
    assert controller.times.equals(truth.grid.times)
    assert (controller.scenario.load_kw == truth.load_kw).all()


def test_forecasts_are_replaced_for_a_step_or_for_good(tiny: Scenario) -> None:
    """A measurement's forecast holds for its step; what is fed holds until it is fed again."""
    truth = rolled(tiny, 6)
    dark = replace(truth, grid_limit_kw=np.zeros(6))
    controller = Controller.of(truth, RunOptions(horizon_h=2.0, isolate=False))
    soc = {"big": 0.2, "small": 0.2}
    now = controller.times[0]
    ahead = pd.Series([0.0, 0.0], controller.window(now)[1:])
    calm = controller.step(Measurement(now, soc)).batteries["p_kw"].sum()
    told = controller.step(Measurement(now, soc, grid_limit_kw=ahead)).batteries["p_kw"].sum()
    again = controller.step(Measurement(now, soc)).batteries["p_kw"].sum()
    assert again == calm < told
    controller.extend(dark.between(1, 6), replacing=True)
    assert controller.step(Measurement(now, soc)).batteries["p_kw"].sum() == told
    assert controller.scenario.grid_limit_kw.tolist() == [np.inf, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_series_alone_may_be_fed(tiny: Scenario) -> None:
    truth = rolled(tiny, 12)
    feed = Feed.of(truth.between(6, 12))
    shuffled = replace(
        feed,
        load_kw=feed.load_kw[["homes", "hospital", "shop"]].iloc[::-1],
        grid_limit_kw=None,
        temperature_c=None,
    )
    controller = Controller.of(truth.between(0, 6), RunOptions(isolate=False))
    controller.extend(shuffled)
    known = controller.scenario
    assert (known.load_kw == truth.load_kw).all() and (known.pv_kw == truth.pv_kw).all()
    assert np.isinf(known.grid_limit_kw[6:]).all()
    assert known.temperature_c[6:].tolist() == [truth.temperature_c[5]] * 6


def wrong(feed: Feed, name: str) -> Feed | Scenario | None:
    """A feed of six hours with one thing wrong."""
    load = feed.load_kw
    if name == "gap":
        return replace(feed, load_kw=load.iloc[1:])
    if name == "hole":
        return replace(feed, load_kw=load.drop(load.index[2]))
    if name == "column":
        return replace(feed, load_kw=load.rename(columns={"homes": "home"}))
    if name == "left out":
        return replace(feed, pv_kw=None)
    if name == "negative":
        return replace(feed, load_kw=-load)
    if name == "naive":
        return replace(feed, load_kw=load.tz_localize(None))
    if name == "half":
        return replace(feed, price_gbp_per_kwh=feed.price_gbp_per_kwh.shift(freq="30min"))
    return None


@pytest.mark.parametrize(("name", "text"), [
    ("gap", "feed, load_kw = 2025-07-02 01:00:00+00:00: leaves a gap: what is known ends at"),
    ("hole", "feed, load_kw = 2025-07-02 02:00:00+00:00: has no value for a step."),
    ("column", "feed, load_kw = home: is not in the scenario. Did you mean homes?"),
    ("left out", "feed, pv_kw of roof: is missing. Give every identifier a column."),
    ("negative", "feed, load_kw of hospital = -"),
    ("naive", "feed, load_kw: has no row with a time and a time zone."),
    ("half", "feed, price_gbp_per_kwh = 2025-07-02 00:30:00+00:00: is not the beginning"),
    ("nothing", "feed, more = NoneType: is neither a Scenario nor a Feed"),
])  # fmt: skip
def test_what_does_not_fit_is_refused_by_name_and_changes_nothing(
    tiny: Scenario, name: str, text: str
) -> None:
    truth = rolled(tiny, 12)
    controller = Controller.of(truth.between(0, 6), RunOptions(isolate=False))
    before = controller.scenario
    assert text in refusal(controller.extend, wrong(Feed.of(truth.between(6, 12)), name))
    assert controller.scenario is before


def test_steps_that_are_known_or_over_are_refused(tiny: Scenario) -> None:
    truth = rolled(tiny, 12)
    controller = Controller.of(truth.between(0, 6), RunOptions(horizon_h=0.0, isolate=False))
    controller.step(Measurement(controller.times[2]))
    with pytest.raises(InputError, match="overlaps with what is known until 2025-07-02T00:00"):
        controller.extend(truth.between(5, 12))
    with pytest.raises(InputError, match="goes back: the next step is 2025-07-01T21:00"):
        controller.extend(truth.between(2, 12), replacing=True)
    another = replace(truth.between(6, 12), batteries=replace(truth.batteries, bus=[3, 4]))
    with pytest.raises(InputError, match="is the scenario of another site"):
        controller.extend(another)
