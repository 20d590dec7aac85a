"""Why the devices of a step do what they do: its stored plan, replayed and explained.

``python -m vppres.service.replay.explanations`` does so for a
:class:`~vppres.service.replay.export.Replay` that it reads, in a process of its own that may be
killed: shadow prices have to be solved for.
"""

from __future__ import annotations

import json
import os
import pickle
import resource
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.contract.forecast import ForecastErrors
from vppres.core.plain import json_safe
from vppres.core.text import named
from vppres.day.forecasting import PAPER
from vppres.day.outages import KNOWN
from vppres.day.recorder import StepRecord
from vppres.day.trajectory import SHARE
from vppres.explain.day import explain_step
from vppres.kinds.kind import MOVE_KW
from vppres.kinds.table import KINDS as OF_KINDS
from vppres.live.measurement import Measurement
from vppres.scenario.scenario import Scenario
from vppres.service.as_told import expected_by
from vppres.service.of_kind import every, moved
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service
from vppres.service.plans.forming import NOTHING, formers_now, why_dark
from vppres.service.replay.export import Replay, site_of
from vppres.service.storage.records import DECIDED

STEPS_BEFORE = 24
"""Steps that are replayed before the one that is explained: what it follows from."""

KINDS = {
    "customer": "customers",
    "battery": "batteries",
    "pv": "pv",
    **{kind.subject: kind.table for kind in OF_KINDS.values()},
}
"""Kinds by the items of explanations: those of set-points, and vehicles."""

NOT_SERVED = "not_served"
FORMERS_SHOWN = 5

NICE = 5
"""Steps that are decided go first."""

PROCESSOR_S = 30
"""CPU time in s after which the process is ended: it takes three."""


def question(runner: Runner, plan: Mapping[str, Any]) -> Replay:
    """Data that the explanation of a decided step needs.

    It has the steps before it, itself, and those that its plan looked at, as they were expected.
    """
    time = pd.Timestamp(plan["start"])
    end = time + (runner.n_ahead + 1) * runner.length
    if runner.rehearsal:
        end = min(end, runner.scenario.grid.end)
    stored = runner.store.plans(time - STEPS_BEFORE * runner.length, time + runner.length)
    begin = pd.Timestamp(stored[0]["start"])
    service = Service(runner.scenario, runner.options)
    scenario = site_of(service, begin, end)
    replay = Replay.of(scenario, runner.options, stored, runner.store)
    scenario = replay.scenario
    if runner.options.outages != KNOWN:
        scenario = replace(scenario, warnings=tuple(runner.warnings(time)))
    t = round((time - begin) / runner.length)
    options = replace(
        runner.options.on(scenario), errors=ForecastErrors(), forecaster=PAPER, thermal="off"
    )
    expected = _expected(scenario, plan, t, runner.deciding.expected.get(plan["id"]))
    return replace(replay, scenario=expected, options=options, stored=replay.stored[: t + 1])


def _expected(
    scenario: Scenario, plan: Mapping[str, Any], t: int, known: Measurement | None
) -> Scenario:
    """The steps from the explained one on as its plan saw them, the profile where that is lost."""
    limits_kw = scenario.grid_limit_kw.copy()
    said = [plan["expected"]["grid_limit_kw"], *plan["ahead"]["grid_limit_kw"]]
    said = [np.inf if limit is None else limit for limit in said][: len(limits_kw) - t]
    limits_kw[t : t + len(said)] = said
    if not plan["grid"]["available"]:
        limits_kw[t] = 0.0
    series = {"grid_limit_kw": limits_kw}
    for name in ("load_kw", "pv_kw", "price_gbp_per_kwh"):
        table = None if known is None else getattr(known, name)
        if table is None:
            continue
        values = getattr(scenario, name).copy()
        rows = np.asarray(table, dtype=float)[: len(values) - t]
        part = values[t : t + len(rows)]
        part[np.isfinite(rows)] = rows[np.isfinite(rows)]
        series[name] = values
    if "pv_kw" in series:
        series["pv_kw"] = np.minimum(series["pv_kw"], scenario.pv.p_max_kw)
    return replace(scenario, **series)  # type: ignore[arg-type]


def explained(asked: Replay) -> dict[str, Any]:
    """Phase, reasons and prices of the step that a question is about."""
    scenario = asked.scenario
    recorder = asked.recorder()
    for record in asked.records():
        recorder.add(record)
    for ahead in _foreseen(record, asked.stored[-1], scenario):
        recorder.add(ahead)
    trajectory = recorder.finish(asked.options.as_record())
    explanations, shadow_prices = explain_step(trajectory, len(asked.stored) - 1)
    step, *actions = explanations
    prices = [
        {
            "asset": row["item"],
            **{name: json_safe(float(row[name])) for name in ("weighted_h", "gbp")},
        }
        for row in shadow_prices
        if row["constraint"] == "stored_energy"
    ]
    reasons = [
        _of_device(KINDS[row["item"]], row["id"], row["action"], _reason(row)) for row in actions
    ]
    return _answer(step["phase"], _reason(step), reasons, "The step has no shadow prices.", prices)


def _answer(
    phase: str | None,
    step: Mapping[str, Any],
    reasons: Sequence[Mapping[str, Any]],
    why_no_price: str,
    prices: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Phase, reason and prices of a step, and reasons of its devices."""
    return {
        "phase": phase,
        "step": step,
        "reasons": reasons,
        "price": prices or None,
        "price_reason": None if prices else why_no_price,
    }


def _of_device(kind: str, asset: str, action: str, reason: Mapping[str, Any]) -> dict[str, Any]:
    """Reason of what a device does."""
    return {"kind": kind, "asset": asset, "action": action, **reason}


def _foreseen(
    record: StepRecord, plan: Mapping[str, Any], scenario: Scenario
) -> Iterator[StepRecord]:
    """Steps after the explained one with the customers that its plan means to supply.

    What was expected of them otherwise is the scenario's.
    """
    served = (plan.get("ahead") or {}).get("served") or {}
    customers = record.customers
    for k in range(scenario.grid.n_steps - record.t - 1):
        told = [on for name in scenario.customers.id for on in served.get(str(name), ())[k : k + 1]]
        if len(told) == len(scenario.customers):
            on = np.array(told, dtype=bool)
            shares = {SHARE: on.astype(float)} if SHARE in customers else {}
            customers = {**record.customers, "served": on, **shares}
        yield replace(record, t=record.t + 1 + k, customers=customers)


def _reason(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: row[name] for name in ("driver", "binding", "words")}


def blacked_out(plan: Mapping[str, Any], scenario: Scenario) -> dict[str, Any]:
    """Of an island that was blacked out: no price explains it, and no other problem does."""
    held = {name: soc for name, soc in expected_by(plan)["soc_start"].items() if soc is not None}
    formers = formers_now(scenario, plan, held, {})
    words = why_dark(plan, formers, island=True)
    if words == NOTHING and formers:
        each = [f"{one.asset} ({one.why_not})" for one in formers]
        words = f"{words}: not {named(each, FORMERS_SHOWN)}"
    told = {"driver": "dark", "binding": ""}
    off = {**told, "words": f"Not supplied: {words}."}
    reasons = [
        _of_device(one["kind"], one["asset"], NOT_SERVED, off)
        for one in plan["setpoints"]
        if _action(one) == NOT_SERVED
    ]
    step = {**told, "words": f"The island is blacked out: {words}."}
    return _answer("island", step, reasons, "The island is blacked out.")


def unsolved(plan: Mapping[str, Any], why_no_price: str) -> dict[str, Any]:
    """Explanation from the plan alone, where no window can be solved again."""
    reasons = [
        _of_device(one["kind"], one["asset"], action, _told(one["reason"], plan["status"]))
        for one in plan["setpoints"]
        if (action := _action(one))
    ]
    step = _told(plan.get("reason") or plan["status"], plan["status"])
    return _answer(None, step, reasons, why_no_price)


def _told(words: str, status: str) -> dict[str, Any]:
    return {"driver": "plan" if status in DECIDED else status, "binding": "", "words": words}


def _action(one: Mapping[str, Any]) -> str:
    """Action of a set-point in the words of explanations; empty if there is none."""
    if one["kind"] == "customers":
        if not one["served"]:
            return NOT_SERVED
        return "dimmed" if one.get("share", 1.0) < 1.0 else ""
    if one["kind"] == "pv":
        return "curtail" if one["curtailed_kw"] > MOVE_KW else ""
    kind = every().get(one["kind"])
    return kind.action(one) if kind else moved(one)


def main() -> None:
    """Explain what stands at the input."""
    os.nice(NICE)
    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_S, PROCESSOR_S + 1))
    asked = pickle.load(sys.stdin.buffer)
    out = sys.stdout
    sys.stdout = sys.stderr  # whatever a library prints is no answer
    json.dump(explained(asked), out)


if __name__ == "__main__":
    main()
