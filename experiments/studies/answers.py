"""How much longer a step's answer takes than its solver.

``python -m experiments.studies.answers`` plays the packaged day over HTTP, with all readings, and
takes the solver's own time from the time of each answer. Then it plays the day without a network in
between, where the time of the processor outside of the solver can be told whatever else the machine
does. It prints JSON, times in ms.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import vppres
from experiments.studies.within import Within
from vppres.day.options import RunOptions
from vppres.service.access import Access
from vppres.service.clock import written
from vppres.service.http.app import make_app
from vppres.service.http.serve import opened
from vppres.service.operation.site import Service
from vppres.service.plans.world import World
from vppres.service.simulate import Place, Play, simulate

DAY = "uk-heatwave-2022"


def over_http(service: Service) -> dict[str, Any]:
    """Answers beside their solver's time, by the clock on the wall."""
    found = simulate(service, service.scenario, Play(announced=False), Place())
    return {name: round(1e3 * value, 1) for name, value in found["overhead_s"].items()}


def of_a_processor(service: Service) -> dict[str, Any]:
    """What a step's answer takes of a processor: its solver works in another process."""
    scenario = service.scenario
    world = World(scenario, service.options)
    steps_s = []
    readings_s = []
    with (
        TemporaryDirectory() as folder,
        opened(service, Path(folder)) as runner,
        closing(Within(make_app(runner, Access()))) as client,
    ):
        for t, now in enumerate(scenario.grid.times):
            readings = {"series": world.readings(t)}
            readings_s.append(client.wanted("POST", "/v1/telemetry", readings).seconds)
            step = client.wanted("POST", "/v1/steps", {"time": written(now)})
            steps_s.append(step.seconds)
            world.obey(t, step.body["setpoints"])
    return {"step": _percentiles(steps_s), "telemetry": _percentiles(readings_s)}


def _percentiles(values_s: Sequence[float]) -> dict[str, float]:
    p50, p95 = np.percentile(values_s, [50, 95])
    return {"median": round(1e3 * float(p50), 1), "p95": round(1e3 * float(p95), 1)}


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--horizon", type=float, default=5.0, help="horizon in h")
    parser.add_argument("--processor", action="store_true", help="without HTTP alone")
    chosen = parser.parse_args(arguments)
    scenario = vppres.load_scenario(DAY)
    service = Service(scenario, RunOptions(horizon_h=chosen.horizon), rehearsal=True)
    isolated = replace(service, options=replace(service.options, isolate=True))
    found = {"processor_ms": of_a_processor(isolated)}
    if not chosen.processor:
        found["beside_the_solver_ms"] = over_http(service)
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
