"""Errors as problem+json (RFC 9457), each mistake with its cure."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from vppres.core.errors import InputError, Problem, StorageError, VppresError
from vppres.core.text import visible
from vppres.io.messages import did_you_mean
from vppres.service.access import Denied
from vppres.service.storage.records import ChangedError, UnknownError

PROBLEM = "application/problem+json"
MOST_PROBLEMS = 50
STATUSES = {StorageError: 503, ChangedError: 412, UnknownError: 404}

SEE = "The fields are described in /openapi.json."
SHOULD = re.compile(r"^\w+ should ")
QUOTED = re.compile(r"'([^']*)'")
SHORT = {
    "missing": "is missing",
    "union_tag_not_found": "is missing",
    "extra_forbidden": "is not a known field",
    "json_invalid": "is not JSON",
    "model_attributes_type": "must be an object with fields",
}
"""Mistakes by the kind that the library gives them."""

TITLES = {
    400: "The request cannot be read",
    401: "The token is missing or unknown",
    403: "This may not be asked",
    404: "There is no such thing",
    405: "This cannot be done here",
    412: "It has changed since",
    413: "The request is too large",
    422: "The request has mistakes",
    429: "Too many requests",
    500: "Something broke",
    503: "The service is not ready",
}


def answer_errors(app: FastAPI) -> None:
    """Let an application answer errors as problems."""

    @app.exception_handler(RequestValidationError)
    async def mistaken(_: Request, error: RequestValidationError) -> Response:
        problems = [problem_of(details) for details in error.errors()[:MOST_PROBLEMS]]
        return problem_answer(422, str(problems[0]), problems)

    @app.exception_handler(VppresError)
    async def known(_: Request, error: VppresError) -> Response:
        if isinstance(error, InputError):
            first = str(error).splitlines()[0]
            return problem_answer(422, first, [p for p in error.problems if isinstance(p, Problem)])
        status = next((code for kind, code in STATUSES.items() if isinstance(error, kind)), 500)
        return problem_answer(status, str(error))

    @app.exception_handler(Denied)
    async def denied(_: Request, error: Denied) -> Response:
        return denied_answer(error)

    @app.exception_handler(HTTPException)
    async def refused(_: Request, error: HTTPException) -> Response:
        return problem_answer(error.status_code, str(error.detail))

    @app.exception_handler(Exception)
    async def unforeseen(_: Request, error: Exception) -> Response:
        # What it was stands in the log of the service, and nowhere else.
        return problem_answer(500, "The service has a mistake. Its log says which.")


def problem_of(details: Mapping[str, Any]) -> Problem:
    """A mistake in a request in our words: those of the library are no sentence with a place."""
    kind, context = details["type"], details.get("ctx", {})
    place, value = list(details["loc"]), _sent(details)
    # "Input should be a valid number, unable to parse ...", "String should have at most ..."
    message, cure = SHOULD.sub("must ", str(details["msg"])).partition(", ")[0], SEE
    message = message.removesuffix(" after validation")
    if kind == "value_error":  # our own: what is wrong, and what to do
        said, _, advice = str(details["msg"]).removeprefix("Value error, ").partition(". ")
        message, cure = said, f"{advice}." if advice else SEE
    elif kind.startswith("union_tag_"):
        place.append(context["discriminator"].strip("'"))
        value = context.get("tag")
    names = QUOTED.findall(context.get("expected_tags") or context.get("expected") or "")
    if names:
        message, cure = "is not known", did_you_mean(str(value), names, SEE)
    elif kind in SHORT:
        message = SHORT[kind]
    return Problem("request", message, cure, field=".".join(map(str, place))[:200], value=value)


def _sent(details: Mapping[str, Any]) -> str | float | None:
    """The value that a mistake is about; none where there is none, or a whole table."""
    value = details.get("input")
    alone = isinstance(value, str | int | float) and details["type"] != "json_invalid"
    return value if alone else None


def problem_answer(status: int, detail: str, problems: Sequence[Problem] = ()) -> Response:
    """RFC 9457."""
    body = {
        "type": "about:blank",
        "title": TITLES.get(status, "The request was refused"),
        "status": status,
        "detail": detail,
        "problems": listed(problems),
    }
    headers = {"WWW-Authenticate": "Bearer"} if status == 401 else None
    return JSONResponse(body, status, headers, media_type=PROBLEM)


def denied_answer(error: Denied) -> Response:
    """To who may not; with the time to wait where that would help."""
    answer = problem_answer(error.status, str(error))
    if error.wait_s > 0.0:
        answer.headers["Retry-After"] = str(math.ceil(error.wait_s))
    return answer


def listed(problems: Sequence[Problem]) -> list[dict[str, Any]]:
    """Problems as JSON, not more than a person reads."""
    return [
        {
            "where": problem.where,
            "message": problem.message,
            "cure": problem.cure,
            "field": problem.field,
            # A lone surrogate that was sent cannot be encoded.
            "value": None if problem.value is None else visible(str(problem.value)[:100]),
        }
        for problem in problems[:MOST_PROBLEMS]
    ]
