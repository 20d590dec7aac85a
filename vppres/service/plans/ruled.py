"""A step that could not be decided otherwise: the guard's rule, on what is known without doubt."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vppres.control.by_part import rule_by_part
from vppres.control.step_state import StepState
from vppres.kinds.customer.physics import Owed
from vppres.kinds.table import parts
from vppres.model.data import WindowData
from vppres.model.linearise import delta_offset
from vppres.model.parts import parts_of
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.service.plans.document import Tables


def ruled(
    now: Scenario,
    soc: Mapping[str, float],
    lost: Mapping[str, str],
    before: Tables,
    needs_former: bool = False,
) -> Tables:
    """Set-points by rule, which needs no solver.

    ``now`` is the step with the import limit that is known, 0 in an outage. A battery without a
    state of charge that was read rests, customers that are ``lost`` are off, and units that are
    started and stopped keep their set-points of ``before``. In physical mode an island
    ``needs_former``: a battery that forms its grid.
    """
    site = Site.of(now)
    b = site.batteries
    held = np.array([soc.get(str(name), np.nan) for name in b.id], dtype=float)
    connected = np.array([str(name) not in lost for name in site.customers.id], dtype=bool)
    held_soc = np.where(np.isfinite(held), np.clip(held, b.soc_min, b.soc_max), b.soc_min)
    known = WindowData(
        now.load_kw[:1] * connected,
        now.pv_kw[:1],
        now.price_gbp_per_kwh[:1],
        now.grid_limit_kw[:1],
        held_soc,
        b.eta_charge,
        b.eta_discharge,
        delta_offset(site.network, None)[np.newaxis],
        parts=parts_of(site, now.out_of_service(range(1)), held_soc, now.outage, needs_former),
        owed=Owed.of(site.customers, site.dt_h),
    )
    nobody = np.zeros(len(site.customers), dtype=bool)  # how long each has been off is not known
    state = StepState(site, known, np.isfinite(held), due=nobody)
    for kind, table in before.items():
        if "running" in table:
            on, given_kw = table["running"].to_numpy(bool), table["p_kw"].to_numpy(float)
            state.taken_kw[kind], state.running[kind] = -given_kw, on
    found = rule_by_part(state, now.tiers)
    columns: dict[str, dict[str, Any]] = {
        "batteries": {
            "p_kw": (found.charge_kw - found.discharge_kw)[0],
            "q_kvar": found.batt_q_kvar[0],
        },
        "pv": {
            "p_kw": found.pv_self_kw[0] + found.pv_export_kw[0],
            "q_kvar": found.pv_q_kvar[0],
            "curtailed_kw": found.pv_curtailed_kw[0],
        },
        "customers": {"served": np.asarray(found.served[0], dtype=bool) & connected},
        **{kind: live.by_rule(now) for kind, live in parts("live").items()},
    }
    return {kind: table.assign(**columns[kind]) for kind, table in before.items()}
