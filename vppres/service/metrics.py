"""Figures for Prometheus, read when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd
from prometheus_client import CollectorRegistry, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

import vppres
from vppres.service.runner import Runner

BUCKETS_S = (0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 300.0)


class Figures(Collector):
    """What a service is at.

    Parameters
    ----------
    runner : Runner
        The service.
    """

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
        yield self._ages()
        yield from self._plan()
        build = GaugeMetricFamily("vppres_build_info", "Version.", labels=["version"])
        build.add_metric([str(vppres.__version__)], 1.0)
        yield build

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
        served = sum(bool(s.get("served")) for s in plan["setpoints"])
        yield GaugeMetricFamily("vppres_served_customers", "Customers that are on.", served)
        if plan["solve"] is not None and plan["solve"]["relative_gap"] is not None:
            gap = plan["solve"]["relative_gap"]
            yield GaugeMetricFamily("vppres_solve_gap_ratio", "Gap of the last solve.", gap)
        if plan["expected"] is not None:
            soc = GaugeMetricFamily(
                "vppres_battery_soc_ratio", "Expected at the end of the step.", labels=["asset"]
            )
            for asset, value in plan["expected"]["soc"].items():
                soc.add_metric([asset], value)
            yield soc
