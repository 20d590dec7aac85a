"""A scenario played against a service in this process."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.support.asgi import Caller
from tests.support.homes import homes
from tests.support.live_service import client
from tests.support.sets import gensets
from tests.support.vans import van
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.http.client import Answer, Client
from vppres.service.operation.site import Service
from vppres.service.plans.world import World
from vppres.service.simulate import Play, Player


class Here(Client):
    """A client of a service in this process."""

    def __init__(self, http: Caller) -> None:
        self.http = http

    def ask(self, method: str, path: str, body: Any = None) -> Answer:
        answer = self.http.ask(method, path, body, {})
        self.url = "here"
        return Answer(answer.status, answer.json() if answer.content else None, 0.01)


def played(
    service: Service, scenario: Scenario, folder: Path, play: Play, clock: SetClock | None = None
) -> Player:
    """A player that has played."""
    with client(service, folder, clock) as http:
        player = Player(World(scenario, service.options), Here(http), play)
        player.play()
        return player


def crowded(tiny: Scenario) -> Scenario:
    """The tiny day with a set, a van and a home that is cooled."""
    charger, vehicle = van(tiny.grid.start, tiny.grid.end)
    return replace(
        tiny,
        gensets=gensets(bus=[4], p_min_kw=10.0),
        chargers=charger,
        sessions=vehicle,
        thermal_loads=homes("homes", c_kwh_per_c=1.0),
        objective=replace(tiny.objective, lambda_grid=1e-7),
    )
