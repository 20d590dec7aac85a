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
from vppres.service.alarms import KINDS
from vppres.service.plans import DEFAULT
from vppres.service.runner import Runner

BUCKETS_S = (0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 300.0)


class Figures(Collector):
    """What a service is at."""

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
        yield GaugeMetricFamily(
            "vppres_plan_ahead_seconds", "How long the last plan still holds.", runner.ahead_s
        )
        yield _by(
            "vppres_steps", "Steps by outcome.", "outcome", runner.outcomes, CounterMetricFamily
        )
        mode = {runner.mode["mode"]: 1.0}
        yield _by("vppres_mode_info", "What the service does.", "mode", mode)
        alarms = {kind: standing[kind] for kind in KINDS}
        yield _by("vppres_alarms", "Alarms that stand.", "kind", alarms)
        age_words = "Time since the last contact."
        yield _by("vppres_telemetry_age_seconds", age_words, "source", ages_s)
        if runner.last is not None:
            yield from self._plan(runner.last)
        version = {str(vppres.__version__): 1.0}
        yield _by("vppres_build_info", "Version.", "version", version)

    def _plan(self, plan: Mapping[str, Any]) -> Iterator[Metric]:
        """What the last plan says."""
        solve = plan["solve"] or {}
        made = pd.Timestamp(plan["generated_at"]).timestamp()
        words = "When the last plan was made."
        yield GaugeMetricFamily("vppres_plan_generated_timestamp_seconds", words, made)
        yield _by("vppres_served_customers", "Customers that are on.", "tier", self._on(plan))
        fallback = {solve.get("fallback") or "none": 1.0}
        words = "What decided the last step in the controller's place."
        yield _by("vppres_fallback_info", words, "kind", fallback)
        refused = sum(one["reason"].startswith(DEFAULT) for one in plan["setpoints"])
        words = "Set-points that are a default."
        yield GaugeMetricFamily("vppres_default_set_points", words, refused)
        if solve.get("relative_gap") is not None:
            gap = solve["relative_gap"]
            yield GaugeMetricFamily("vppres_solve_gap_ratio", "Gap of the last solve.", gap)
        if plan["expected"] is not None:
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


def _by(
    name: str, words: str, label: str, values: Mapping[str, float], kind: Any = GaugeMetricFamily
) -> Metric:
    """A figure for each value of a label."""
    found = kind(name, words, labels=[label])
    for each, value in values.items():
        found.add_metric([each], value)
    return found


def _expected(plan: Mapping[str, Any]) -> Iterator[Metric]:
    """What the last plan expects of its step."""
    expected = plan["expected"]
    soc = {asset: _known(value) for asset, value in expected["soc"].items()}
    yield _by("vppres_battery_soc_ratio", "Expected at the end of the step.", "asset", soc)
    limit_kw = expected["grid_limit_kw"]
    limit_w = np.inf if limit_kw is None else W_PER_KW * limit_kw
    likely = (plan.get("outage_probability") or [None])[0]
    for name, words, value in (
        ("vppres_import_watts", "Expected import.", W_PER_KW * _known(expected["import_kw"])),
        ("vppres_import_limit_watts", "Import limit; infinite if there is none.", limit_w),
        (
            "vppres_voltage_min_ratio",
            "Lowest voltage, of the nominal.",
            _known(expected["v_min_pu"]),
        ),
        (
            "vppres_voltage_max_ratio",
            "Highest voltage, of the nominal.",
            _known(expected["v_max_pu"]),
        ),
        ("vppres_grid_available", "Whether there is grid.", float(limit_kw != 0.0)),
        ("vppres_outage_probability_ratio", "Of an outage in the present step.", _known(likely)),
    ):
        yield GaugeMetricFamily(name, words, value)


def _known(value: float | None) -> float:
    return np.nan if value is None else value
