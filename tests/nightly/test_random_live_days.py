"""A random day of a live service, and that its judgement can fail."""

from __future__ import annotations

from typing import Any

import pytest

from experiments.studies import random_live_days
from experiments.studies.shedding import Judge, Shed


def test_a_random_live_day_holds_what_it_must(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(random_live_days, "DAYS_IN_A_ROW", 1)
    [day] = random_live_days.run_one(0)
    assert day.wrong == []
    assert day.anew > 0 and day.lost > 0 and day.refused > 0 and day.outage_h > 0.0
    assert day.critical_off > 0  # so that there was something to judge


def test_what_is_avoidable_or_denied_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def avoidably(self: Judge, plan: Any) -> None:
        self.found.append(Shed(now=2, ahead=0, least=1))

    monkeypatch.setattr(Judge, "look", avoidably)
    monkeypatch.setattr(random_live_days, "SOC_APART", -1.0)
    monkeypatch.setattr(random_live_days, "DAYS_IN_A_ROW", 1)
    [day] = random_live_days.run_one(0)
    assert day.avoidable and day.disbelieved and day.denied
