"""The route of what is measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse

from vppres.core.errors import InputError
from vppres.service import payloads
from vppres.service.answers import MOST_PROBLEMS, listed, problem_of
from vppres.service.routes.guard import Source
from vppres.service.telemetry.knowledge import WHERE, readings_of
from vppres.service.telemetry.refused import Refusal

router = APIRouter()


@router.post("/v1/telemetry")
def telemetry(by: Source, body: payloads.Telemetry) -> Response:
    """Readings; to send them twice does no harm.

    ``asked_again`` says which of them stand alone, and are to be sent again within seconds.
    """
    now = by.runner.clock.now()
    until = by.runner.begun(now) + 2 * by.runner.length
    read = [one for one in body.each if isinstance(one, payloads.Readings)]
    good, refused = readings_of(read, by.runner.scenario, until)
    refused = [*unread(body, by.actor), *refused]
    by.runner.hearing.refused.note(refused, good, now)
    problems = [one.problem for one in refused]
    if problems and not good:
        raise InputError(problems)
    kept = by.runner.hearing.hear(good, now, by.actor)
    again = by.runner.hearing.asked_again(good)
    return JSONResponse(
        {
            "accepted": kept.accepted,
            "duplicates": kept.duplicates,
            "refused": listed(problems),
            **({"asked_again": again} if again else {}),
        }
    )


def unread(batch: payloads.Telemetry, actor: str) -> Iterator[Refusal]:
    """Series that cannot be read, by the names that they have; of many the first mistakes."""
    return islice(_mistakes(batch, actor), MOST_PROBLEMS)


def _mistakes(batch: payloads.Telemetry, actor: str) -> Iterator[Refusal]:
    for number, one in enumerate(batch.each):
        if isinstance(one, payloads.Readings):
            continue
        given = one.given if isinstance(one.given, dict) else {}
        source, asset, quantity = (
            name[: payloads.LONGEST_NAME] if isinstance(name := given.get(key), str) else ""
            for key in ("source", "asset", "quantity")
        )
        for details in one.error.errors():
            wrong = problem_of(details)
            place = f"series.{number}{'.' if wrong.field else ''}{wrong.field}"
            named = f"{wrong.field} of {asset}" if asset and wrong.field else place
            yield Refusal(
                source or actor, asset, quantity, replace(wrong, where=WHERE, field=named)
            )
