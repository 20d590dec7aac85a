"""Figures for Prometheus, read when they are asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from prometheus_client import CollectorRegistry, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

import vppres
from vppres.core.units import W_PER_KW
from vppres.service.alarms.conditions import KINDS
from vppres.service.operation.runner import Runner
from vppres.service.plans.document import DEFAULT

BUCKETS_S = (0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 300.0)


class Figures(Collector):
    """Figures of a running service."""

    def __init__(self, runner: Runner) -> None:
        self.runner = runner
        self.registry = CollectorRegistry()
        self.registry.register(self)
        seconds = Histogram(
            "vppres_step_duration_seconds",
            "From the beginning of a step's decision to its stored plan.",
            buckets=BUCKETS_S,
            registry=self.registry,
        )
        runner.on_step = seconds.observe

    def text(self) -> bytes:
        """All figures in Prometheus's text format."""
        text: bytes = generate_latest(self.registry)
        return text

    def collect(self) -> Iterator[Metric]:
        """Figures of now."""
        runner, store = self.runner, self.runner.store
        standing = Counter(row.kind for row in store.standing_alarms())
        now = runner.clock.now().timestamp()
        ages_s = {source: now - at for source, at in store.contacts().items()}
        yield _figure("plan_ahead_seconds", "How long the last plan still holds.", runner.ahead_s)
        steps = CounterMetricFamily("vppres_steps", "Steps by outcome.", labels=["outcome"])
        yield _with(steps, runner.outcomes)
        yield _by("mode_info", "What the service does.", "mode", {runner.mode["mode"]: 1.0})
        alarms = {kind: standing[kind] for kind in KINDS}
        yield _by("alarms", "Alarms that stand.", "kind", alarms)
        yield _by("telemetry_age_seconds", "Time since the last contact.", "source", ages_s)
        if runner.last:
            yield from self._plan(runner.last)
        yield _by("build_info", "Version.", "version", {str(vppres.__version__): 1.0})

    def _plan(self, plan: Mapping[str, Any]) -> Iterator[Metric]:
        """Document of the last plan."""
        solve = plan["solve"] or {}
        made = pd.Timestamp(plan["generated_at"]).timestamp()
        yield _figure("plan_generated_timestamp_seconds", "When the last plan was made.", made)
        yield _by("served_customers", "Customers that are on.", "tier", self._on(plan))
        words = "What decided the last step in the controller's place."
        yield _by("fallback_info", words, "kind", {solve.get("fallback") or "none": 1.0})
        refused = sum(one["reason"].startswith(DEFAULT) for one in plan["setpoints"])
        yield _figure("default_set_points", "Set-points that are a default.", refused)
        if solve.get("relative_gap") is not None:
            yield _figure("solve_gap_ratio", "Gap of the last solve.", solve["relative_gap"])
        if plan["expected"]:
            yield from _expected(plan)

    def _on(self, plan: Mapping[str, Any]) -> dict[str, float]:
        """Customers of each tier that are on."""
        customers = self.runner.scenario.customers
        tiers = dict(zip(map(str, customers.id), map(str, customers.tier), strict=True))
        on = dict.fromkeys(self.runner.scenario.tiers, 0.0)
        for one in plan["setpoints"]:
            if one["kind"] == "customers":
                on[tiers[one["asset"]]] += one["served"]
        return on


def _expected(plan: Mapping[str, Any]) -> Iterator[Metric]:
    """Values that the last plan expects of its step."""
    expected = plan["expected"]
    limit_kw = expected["grid_limit_kw"]
    limit_w = np.inf if limit_kw is None else W_PER_KW * limit_kw
    import_w = W_PER_KW * _known(expected["import_kw"])
    likely = (plan.get("outage_probability") or [None])[0]
    low, high = expected["v_min_pu"], expected["v_max_pu"]
    soc = expected["soc"]
    yield _by("battery_soc_ratio", "Expected at the end of the step.", "asset", soc)
    yield _figure("import_watts", "Expected import.", import_w)
    yield _figure("import_limit_watts", "Import limit; infinite if there is none.", limit_w)
    yield _figure("voltage_min_ratio", "Lowest voltage, of the nominal.", low)
    yield _figure("voltage_max_ratio", "Highest voltage, of the nominal.", high)
    yield _figure("grid_available", "Whether there is grid.", float(limit_kw != 0.0))
    yield _figure("outage_probability_ratio", "Of an outage in the present step.", likely)


def _figure(name: str, words: str, value: float | None) -> Metric:
    """A figure without a label."""
    return GaugeMetricFamily(f"vppres_{name}", words, _known(value))


def _by(name: str, words: str, label: str, values: Mapping[str, float | None]) -> Metric:
    """A figure for each value of a label."""
    return _with(GaugeMetricFamily(f"vppres_{name}", words, labels=[label]), values)


def _with(found: Any, values: Mapping[str, float | None]) -> Metric:
    for each, value in values.items():
        found.add_metric([each], _known(value))
    return found


def _known(value: float | None) -> float:
    return np.nan if value is None else value
