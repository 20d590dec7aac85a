"""A scenario played against a service in this process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.support.asgi import Caller
from tests.support.live_service import client
from vppres.scenario.scenario import Scenario
from vppres.service.client import Answer, Client
from vppres.service.clock import SetClock
from vppres.service.runner import Service
from vppres.service.simulate import Play, Player
from vppres.service.world import World


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
