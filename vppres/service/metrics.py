"""Figures for Prometheus, read when they are asked for."""

from __future__ import annotations

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
        runner = self.runner
        yield GaugeMetricFamily(
            "vppres_plan_ahead_seconds", "How long the last plan still holds.", runner.ahead_s
        )
        steps = CounterMetricFamily("vppres_steps", "Steps by outcome.", labels=["outcome"])
        for outcome, count in runner.outcomes.items():
            steps.add_metric([outcome], count)
        yield steps
        yield self._mode()
        yield self._alarms()
        yield self._ages()
        yield from self._plan()
        build = GaugeMetricFamily("vppres_build_info", "Version.", labels=["version"])
        build.add_metric([str(vppres.__version__)], 1.0)
        yield build

    def _mode(self) -> Metric:
        """What the operator asked for."""
        mode = GaugeMetricFamily("vppres_mode_info", "What the service does.", labels=["mode"])
        mode.add_metric([self.runner.mode["mode"]], 1.0)
        return mode

    def _alarms(self) -> Metric:
        """How many alarms stand."""
        alarms = GaugeMetricFamily("vppres_alarms", "Alarms that stand.", labels=["kind"])
        standing = [row.kind for row in self.runner.store.standing_alarms()]
        for kind in KINDS:
            alarms.add_metric([kind], standing.count(kind))
        return alarms

    def _ages(self) -> Metric:
        """Since when each source has been silent."""
        ages = GaugeMetricFamily(
            "vppres_telemetry_age_seconds", "Time since the last contact.", labels=["source"]
        )
        now = self.runner.clock.now().timestamp()
        for source, at in self.runner.store.contacts().items():
            ages.add_metric([source], now - at)
        return ages

    def _plan(self) -> Iterator[Metric]:
        """What the last plan says."""
        plan = self.runner.last
        if plan is None:
            return
        yield GaugeMetricFamily(
            "vppres_plan_generated_timestamp_seconds",
            "When the last plan was made.",
            pd.Timestamp(plan["generated_at"]).timestamp(),
        )
        yield self._customers(plan)
        yield self._fallbacks(plan)
        refused = sum(one["reason"].startswith(DEFAULT) for one in plan["setpoints"])
        yield GaugeMetricFamily(
            "vppres_default_set_points", "Set-points that are a default.", refused
        )
        if plan["solve"] is not None and plan["solve"]["relative_gap"] is not None:
            gap = plan["solve"]["relative_gap"]
            yield GaugeMetricFamily("vppres_solve_gap_ratio", "Gap of the last solve.", gap)
        if plan["expected"] is not None:
            yield from _expected(plan)

    def _customers(self, plan: Mapping[str, Any]) -> Metric:
        """Who is on."""
        customers = self.runner.scenario.customers
        tiers = {
            str(name): str(tier) for name, tier in zip(customers.id, customers.tier, strict=True)
        }
        on = dict.fromkeys(self.runner.scenario.tiers, 0)
        for one in plan["setpoints"]:
            if one["kind"] == "customers":
                on[tiers[one["asset"]]] += one["served"]
        served = GaugeMetricFamily(
            "vppres_served_customers", "Customers that are on.", labels=["tier"]
        )
        for tier, count in on.items():
            served.add_metric([tier], count)
        return served

    def _fallbacks(self, plan: Mapping[str, Any]) -> Metric:
        """Which fallback decided."""
        kind = (plan["solve"] or {}).get("fallback") or "none"
        fallback = GaugeMetricFamily(
            "vppres_fallback_info",
            "What decided the last step in the controller's place.",
            labels=["kind"],
        )
        fallback.add_metric([kind], 1.0)
        return fallback


def _expected(plan: Mapping[str, Any]) -> Iterator[Metric]:
    """What the last plan expects of its step."""
    expected = plan["expected"]
    soc = GaugeMetricFamily(
        "vppres_battery_soc_ratio", "Expected at the end of the step.", labels=["asset"]
    )
    for asset, value in expected["soc"].items():
        soc.add_metric([asset], _known(value))
    yield soc
    limit_kw = expected["grid_limit_kw"]
    for name, words, value in (
        ("vppres_import_watts", "Expected import.", W_PER_KW * _known(expected["import_kw"])),
        (
            "vppres_import_limit_watts",
            "Import limit; infinite if there is none.",
            np.inf if limit_kw is None else W_PER_KW * limit_kw,
        ),
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
        (
            "vppres_outage_probability_ratio",
            "Of an outage in the present step.",
            _known((plan.get("outage_probability") or [None])[0]),
        ),
    ):
        yield GaugeMetricFamily(name, words, value)  # fmt: skip


def _known(value: float | None) -> float:
    return np.nan if value is None else value
