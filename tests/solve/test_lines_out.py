"""Windows in which lines are out: the decomposed method beside the whole problem."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.faulted import faulted_day, faulted_window
from vppres.model.formulas import bus_injections
from vppres.model.site import Site
from vppres.model.violations import broken
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
