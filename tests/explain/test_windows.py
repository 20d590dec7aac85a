"""Windows of a record are those that the controller saw in the run."""

from __future__ import annotations

import numpy as np

from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.simulate import Day, run_day
from vppres.explain.windows import Windows
from vppres.scenario.scenario import Scenario

STEPS = 3


def test_observations_of_a_record_are_those_of_its_run(tiny: Scenario) -> None:
    options = RunOptions(horizon_h=1.0, soc_end=0.5, thermal="exact")
    day, controller = Day(tiny, options), make_controller(tiny, options)
    told = []
    for t in range(STEPS):
        told.append(day.observe(controller, t))
        day.step(controller, t)
    windows = Windows(day.recorder.finish(day.options.as_record()))
    for t, of_run in enumerate(told):
        seen = windows.observation(t)
        ahead = slice(len(seen.forecast.load_kw))  # the record ends before the day
        for name in ("load_kw", "pv_kw", "price_gbp_per_kwh", "grid_limit_kw"):
            of_forecast = getattr(of_run.forecast, name)[ahead]
            np.testing.assert_array_equal(getattr(seen.forecast, name), of_forecast, err_msg=name)
        for name in ("soc", "eta_charge", "eta_discharge"):
            np.testing.assert_array_equal(getattr(seen, name), getattr(of_run, name), err_msg=name)
        np.testing.assert_array_equal(seen.owed.kw, of_run.owed.kw)
        assert (seen.operating_point is None) == (of_run.operating_point is None) == (t == 0)
        if seen.operating_point is not None and of_run.operating_point is not None:
            for name in ("v_pu", "p_flow_kw", "p_injection_kw", "q_injection_kvar"):
                point = getattr(of_run.operating_point, name)
                np.testing.assert_allclose(getattr(seen.operating_point, name), point, atol=1e-9)


def test_the_last_window_of_a_run_that_stops_before_its_day_does_not_end_it(tiny: Scenario) -> None:
    options = RunOptions(controller="idle", horizon_h=1.0, soc_end=0.5)
    whole, part = (Windows(run_day(tiny, options, steps=n)) for n in (None, STEPS))
    last = tiny.grid.n_steps - 1
    assert whole.observation(last).ends and whole.observation(last).end is not None
    stopped = part.observation(STEPS - 1)
    assert not stopped.ends and stopped.end is None
