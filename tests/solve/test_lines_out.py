"""Windows in which lines are out: the decomposed method beside the whole problem."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from benchmarks.cut_feeders import CASES, LIMIT_S, cut_day, decided
from tests.support.faulted import faulted_day, faulted_window
from vppres.model.formulas import bus_injections
from vppres.model.site import Site
from vppres.model.violations import broken
from vppres.solve.cache import ModelCache
from vppres.solve.ladder import METHODS, WindowSolver


@pytest.mark.parametrize("seed", range(30))
def test_each_part_has_its_balance_and_both_methods_agree(seed: int) -> None:
    """Of parts only powers are compared, not the rows that made them."""
    day = faulted_day(seed)
    site, data = Site.of(day), faulted_window(day)
    assert not data.parts.whole
    answers = [WindowSolver(site, method).solve(data) for method in METHODS]
    for answer in answers:
        plan = answer.dispatch
        assert answer.status == "optimal"
        assert not broken(site, data, plan)
        given = {
            "pv": plan.pv_self_kw + plan.pv_export_kw,
            "customers": -data.load_kw * plan.served,
        }
        p_kw = bus_injections(site, given | {"batteries": plan.discharge_kw - plan.charge_kw})
        for t, numbers in enumerate(data.parts.of_bus):
            sums = np.bincount(numbers, p_kw[t], site.network.n_buses)
            assert np.abs(sums[1:]).max() < 1e-3
        at = [site.network.bus_index[bus] for bus in site.customers.bus]
        assert not plan.served[data.parts.dead[:, at]].any()
    decomposed, whole = answers
    gap = 1e-4 * max(abs(whole.objective), 0.01) + 1e-6
    assert decomposed.objective == pytest.approx(whole.objective, abs=gap)
    assert min(one.bound for one in answers) >= max(one.objective for one in answers) - 1e-6


SUNNY = ((21, 3.0), (7, 3.0), (13, 3.0), (34, 3.0), (6, 3.0))
"""Days whose parts have more sun than they can use, and how much more PV there is."""


@pytest.mark.daily
@pytest.mark.parametrize(("seed", "pv"), [*SUNNY, *((seed, 1.0) for seed in range(12))])
def test_a_window_of_a_wide_feeder_agrees_with_the_whole_problem(seed: int, pv: float) -> None:
    """As large windows are decided: in the network at once, each part by its own balance."""
    day = faulted_day(seed)
    more = replace(day.pv, p_max_kw=pv * day.pv.p_max_kw, s_max_kva=pv * day.pv.s_max_kva)
    day = replace(day, pv=more, pv_kw=pv * day.pv_kw)
    site, data = Site.of(day), faulted_window(day)
    whole = WindowSolver(site, "monolithic").solve(data)
    with patch("vppres.solve.sizes.LARGE", 0), patch("vppres.solve.sizes.WIDE", 0):
        solver = WindowSolver(site)
        solver.cache = ModelCache(site)
        answer = solver.solve(data)
    assert any(stage.startswith("network_service") for stage in answer.stages)
    assert not broken(site, data, answer.dispatch)
    assert answer.objective <= whole.bound + 1e-5
    assert answer.bound >= whole.objective - 1e-5
    assert answer.objective >= whole.objective - 1e-4 * max(abs(whole.objective), 1.0)


@pytest.mark.daily
def test_a_feeder_of_a_thousand_buses_with_a_line_out_has_a_plan_with_a_bound() -> None:
    cut = next(each for each in CASES if each.name == "one line, with grid")
    decision = decided(cut)
    assert decision.fallback == "none"
    assert decision.info.solve_s < LIMIT_S
    assert decision.info.gap < 1e-4
    day = cut_day(cut)
    ((copy, bus),) = cut.lines
    (line,) = np.flatnonzero(day.network.to_bus == bus + 69 * copy)
    flow_kva = np.hypot(decision.dispatch.p_flow_kw, decision.dispatch.q_flow_kvar)[:, line]
    assert (flow_kva > 1.0).tolist() == [True] * 2 + [False] * (len(flow_kva) - 2)
