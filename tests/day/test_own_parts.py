"""A controller, a forecaster and weights of one's own in a run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

import vppres
from vppres.contract.decision import Decision
from vppres.contract.observation import Observation
from vppres.control.baselines import IdleController
from vppres.control.mpc import MPCController
from vppres.day.options import RunOptions
from vppres.day.recorder import ROTATED
from vppres.forecasts.interface import LoadAndPV
from vppres.model import problem
from vppres.model.site import Site
from vppres.scenario.history import History
from vppres.scenario.scenario import Scenario

HERE = RunOptions(horizon_h=1.0)
PLAN = ["charge_kw", "discharge_kw", "q_kvar", "soc_end"]


def test_a_controller_of_ones_own_decides_each_step(tiny: Scenario) -> None:
    """One that does what the package's does gives its run, to the last bit, and is asked once."""
    asked: list[int] = []

    class Idle(IdleController):
        def __init__(self, site: Site) -> None:
            super().__init__(site, tiny.tiers)

        def decide(self, observation: Observation) -> Decision:
            asked.append(observation.t0)
            return super().decide(observation)

    options = replace(HERE, guard=False)
    run = vppres.run_day(tiny, options, controller=Idle)
    same = vppres.run_day(tiny, replace(options, controller="idle"))
    assert asked == list(range(tiny.grid.n_steps))
    for name in ("customers", "batteries", "pv"):
        pd.testing.assert_frame_equal(run.tables[name], same.tables[name])
    assert run.options["own"]["controller"].endswith("Idle")


@pytest.mark.parametrize("part", ["objective", "constraint", "controller", "forecaster"])
def test_a_typo_of_ones_own_is_raised(
    tiny: Scenario, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    """No step is decided by rule for it: the error names the step and the function."""

    class Mistaken(IdleController):
        def __init__(self, site: Site) -> None:
            super().__init__(site, tiny.tiers)

        def decide(self, observation: Observation) -> Decision:
            return typo(observation)

        def forecast(self, history: History, issued_at: pd.Timestamp, steps: int) -> Any:
            return typo(history)

    def typo(first: Any, v: Any = None, p: Any = None) -> Any:
        return (first if v is None else v).serverd

    name = {"objective": "paper_objective", "constraint": "paper_constraints"}.get(part)
    if name is not None:
        monkeypatch.setattr(problem, name, typo)
    own: dict[str, Any] = {
        "controller": {"controller": Mistaken},
        "forecaster": {"forecaster": Mistaken(Site.of(tiny))},
    }.get(part, {})
    # A site of its own: problems that were compiled before have no typo in them.
    customers = replace(tiny.customers, weight=tiny.customers.weight * 1.01)
    with pytest.raises(AttributeError, match=r"(?s)serverd.*step 0 of the day, in .*typo"):
        vppres.run_day(replace(tiny, customers=customers), HERE, **own)


def test_a_forecaster_of_ones_own_is_asked_for_what_comes(tiny: Scenario) -> None:
    seen: list[int] = []

    class Nothing:
        def forecast(self, history: History, issued_at: pd.Timestamp, steps: int) -> LoadAndPV:
            seen.append(len(history.load_kw))
            load_kw = np.zeros((1, steps, len(tiny.customers)))
            return LoadAndPV(
                issued_at, history.step_minutes, load_kw, np.zeros((1, steps, len(tiny.pv)))
            )

    run = vppres.run_day(tiny, HERE, forecaster=Nothing())
    # Of what was measured by then, and nothing later; the last step has nothing ahead.
    assert seen == list(range(1, tiny.grid.n_steps))
    assert run.options["own"]["forecaster"].endswith("Nothing")


@pytest.mark.parametrize("priority", ["weights", "strict"])
def test_weights_of_the_scenario_change_nothing(tiny: Scenario, priority: str) -> None:
    options = replace(HERE, priority=priority)
    plain = vppres.run_day(tiny, options)
    run = vppres.run_day(tiny, options, weights=lambda _: tiny.customers.weight)
    pd.testing.assert_frame_equal(plain.batteries[PLAN], run.batteries[PLAN])
    assert (plain.customers["served"] == run.customers["served"]).all()


def test_weights_decide_who_is_on(tiny: Scenario) -> None:
    """In the outage the one that weighs most is on longest, whichever it is."""
    dark = tiny.grid.times[tiny.outage]
    for favourite in ("hospital", "homes"):
        weight = np.where(tiny.customers.id == favourite, 100.0, 0.01)
        by_step = np.tile(weight, (tiny.grid.n_steps, 1))
        run = vppres.run_day(tiny, replace(HERE, priority="weights"), weights=by_step)
        on = run.customers[run.customers["time"].isin(dark)].groupby("id")["served"].mean()
        assert on[favourite] == on.max() > 0.0
        np.testing.assert_array_equal(run.customers[ROTATED], by_step.ravel())


def test_what_a_controller_remembers_goes_on_with_other_weights(
    tiny: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    before: list[bool] = []
    really = MPCController._planned_moves

    def noted(self: Any, observation: Observation) -> Any:
        found = really(self, observation)
        before.append(found is not None)
        return found

    monkeypatch.setattr(MPCController, "_planned_moves", noted)
    rows = tiny.customers.weight * (1.0 + np.arange(tiny.grid.n_steps) % 2)[:, np.newaxis]
    vppres.run_day(tiny, replace(HERE, priority="weights"), weights=rows)
    assert before == [False, *[True] * (tiny.grid.n_steps - 1)]


class Incomplete:
    def __init__(self, site: object = None) -> None:
        self.site = site

    def horizon_steps(self, t0: int) -> range:
        return range(t0, t0 + 1)

    def forecast(self, history: History, issued_at: pd.Timestamp, steps: int) -> LoadAndPV:
        return LoadAndPV(issued_at, history.step_minutes, history.load_kw, history.pv_kw)


ONCE = np.ones(3)


@pytest.mark.parametrize(("part", "options", "words"), [
    ({"controller": Incomplete()}, {}, "run_day, controller = .*Give the class"),
    ({"controller": Incomplete}, {}, "run_day, controller = .*lacks the method decide"),
    ({"controller": Incomplete}, {"move_switches": True}, "controller = .*leaves the switches as they"),
    ({"forecaster": Incomplete}, {}, "forecaster = .*Give an object"),
    ({"forecaster": Incomplete()}, {}, r"load_kw = \(\d, 3\): must have the shape \(paths, 1, 3\)"),
    ({"forecaster": object()}, {}, "forecaster = .*must have a method forecast"),
    ({"forecaster": Incomplete()}, {"errors": vppres.ForecastErrors(load_bias=0.1)},
        "run_day, forecaster: makes its own errors"),
    ({"weights": ONCE}, {"rotation": 0.2}, "run_day, weights: .*Leave out the weights, or rotation"),
    ({"weights": ONCE}, {"controller": "full-horizon"}, "run_day, weights: are for the controller mpc"),
    ({"weights": ONCE, "controller": Incomplete}, {}, "run_day, weights: are for the controller mpc"),
    ({"weights": "critical"}, {}, "weights of step 0: must be 3 numbers above 0"),
    ({"weights": [[1.0, 1.0, 1.0]]}, {}, "weights of step 1: must be 3 numbers above 0"),
    *(({"weights": lambda _, row=row: row}, {}, "weights of step 0: must be 3 numbers above 0")
        for row in ([1.0, 2.0], [1.0, 2.0, 0.0], [1.0, 2.0, np.nan], [[1.0, 2.0, 3.0]])),
])  # fmt: skip
def test_a_part_that_has_no_effect_or_does_not_fit_is_refused(
    tiny: Scenario, part: dict[str, Any], options: dict[str, Any], words: str
) -> None:
    with pytest.raises(vppres.InputError, match=words):
        vppres.run_day(tiny, replace(HERE, **options), **part)


class Odd(IdleController):
    """Decides nothing, or with an array that is not one of the site."""

    kind = ""

    def decide(self, observation: Observation) -> Any:
        found = super().decide(observation)
        if self.kind == "nothing":
            return None
        given = found.dispatch.charge_kw
        changed = np.full_like(given, np.nan) if self.kind == "nan" else given[:, :0]
        return replace(found, dispatch=replace(found.dispatch, charge_kw=changed))


@pytest.mark.parametrize(
    ("kind", "words"),
    [("nothing", "is no Decision"), ("nan", "charge_kw is not finite"), ("less", "has shape")],
)
def test_a_decision_that_is_none_is_refused(tiny: Scenario, kind: str, words: str) -> None:
    """24 of 24 steps by rule would look like the figures of the controller."""
    made = type("Mine", (Odd,), {"kind": kind})
    with pytest.raises(vppres.InputError, match=f"decision of step 0, controller = .*{words}"):
        vppres.run_day(tiny, HERE, controller=lambda site: made(site, tiny.tiers))


@pytest.mark.parametrize("power_kw", [-3.0, np.inf])
def test_a_forecast_of_what_cannot_be_is_refused(tiny: Scenario, power_kw: float) -> None:
    class Wild:
        def forecast(self, history: History, issued_at: pd.Timestamp, steps: int) -> LoadAndPV:
            load_kw, pv_kw = (
                np.repeat(values[-1:], steps, axis=0)[np.newaxis].astype(float)
                for values in (history.load_kw, history.pv_kw)
            )
            load_kw[0, 0, 0] = power_kw
            return LoadAndPV(issued_at, history.step_minutes, load_kw, pv_kw)

    with pytest.raises(vppres.InputError, match=r"forecast after step 0, load_kw = .*finite"):
        vppres.run_day(tiny, HERE, forecaster=Wild())
