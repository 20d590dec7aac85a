"""Requests to break a service with: made from its OpenAPI description, and a corpus of our own."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from random import Random
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

import pandas as pd

from experiments.studies.within import Request
from tests.support.live_service import reading
from vppres.scenario.scenario import Scenario
from vppres.service.clock import written

LEAST_OF_A_KIND = 5


def generated_requests(description: dict[str, Any], count: int, seed: int) -> list[Request]:
    """Requests that schemathesis makes from an OpenAPI description, right and wrong ones."""
    import schemathesis

    described: Any = schemathesis.openapi.from_dict(description)
    found = [one.ok() for one in described.get_all_operations()]
    kinds = [(one, mode) for one in found for mode in schemathesis.GenerationMode]
    # A kind costs its time even for one request: of few requests, some kinds.
    kinds = Random(seed).sample(kinds, min(len(kinds), max(1, count // LEAST_OF_A_KIND)))
    each = -(-count // len(kinds))
    made = (_cases(*kind, each, seed + number) for number, kind in enumerate(kinds))
    return [*chain.from_iterable(made)][:count]


def _cases(operation: Any, mode: Any, count: int, seed: int) -> list[Request]:
    """Requests for one operation; none where it has nothing to be wrong with."""
    import hypothesis
    from schemathesis.errors import SchemathesisError

    made: list[Request] = []

    def keep(case: Any) -> None:
        made.append(_request(case))

    given: Any = hypothesis.given
    seeded: Any = hypothesis.seed(seed)
    as_they_come: Any = hypothesis.settings(
        max_examples=count,
        database=None,
        deadline=None,
        phases=[hypothesis.Phase.generate],
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    try:
        cases = operation.as_strategy(generation_mode=mode)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            as_they_come(seeded(given(cases)(keep)))()
    except (SchemathesisError, hypothesis.errors.HypothesisException):
        pass
    return made


def _request(case: Any) -> Request:
    """A case of schemathesis on the wire."""
    plain = case.as_transport_kwargs(base_url="http://localhost")
    parts = urlsplit(plain["url"])
    query = urlencode(plain.get("params") or {}, doseq=True, errors="replace")
    body = plain.get("data") or b""
    if "json" in plain:
        body = json.dumps(plain["json"]).encode()
    if isinstance(body, str):
        body = body.encode("utf-8", "replace")
    headers = {str(k).lower(): str(v) for k, v in (plain.get("headers") or {}).items()}
    headers = {"host": "localhost", "content-type": "application/json"} | headers
    target = parts.path + (f"?{query}" if query else "")
    return Request(plain["method"], target, headers, body if isinstance(body, bytes) else b"{}")


NUMBERS = (
    "1e308", "-1e308", "1e999", "NaN", "-Infinity", "9" * 400, "9" * 5000, "-0.0", "1e-320", "4.2",
    "18446744073709551616", "0x10", "1_000", "01", "true", "null",
)  # fmt: skip
TEXTS = (
    "", " ", "a" * 100_000, "\x00", "\ud800", "\U0001f4a5", "\u202e", "../../../etc/passwd",
    "%2e%2e%2f", "'; DROP TABLE audit; --", "{{7*7}}", "%n%s%x", "<script>alert(1)</script>",
    "${jndi:ldap://x}", "__proto__", "null", "NaN", "\r\nX-Evil: 1", "CON", "~/.ssh/id_rsa", "|id",
    "$(id)",
)  # fmt: skip
TIMES = (
    "0001-01-01T00:00:00Z", "9999-12-31T23:59:59Z", "1969-12-31T23:59:59Z", "2026-02-30T00:00:00Z",
    "2026-11-21T12:00:00", "2026-11-21T12:00:00+99:99", "2199-12-31T23:59:59.999999999Z",
    "2026-11-21T24:00:01Z", "-2026-11-21T12:00:00Z", "20261121T120000Z", "now", "2026-W47-6",
    "2000-01-01T00:00:00Z", "2026-11-21T12:00:00.0000001Z", "2026-10-25T01:30:00[Europe/London]",
    "-PT1H", "PT0S", "PT9999H", "P1M", "PT1H1H", "PT99999M999999S",
)  # fmt: skip
DEEP = ("[" * 400 + "]" * 400, '{"a":' * 400 + "1" + "}" * 400, "[" * 100_000, '{"a":' * 50_000)
RAW = (
    b"", b"{", b"\xff\xfe{\x00}\x00", b"\x00" * 1000, b"\x1f\x8b\x08\x00garbage",
    b'{"a":1}{"a":2}', b"null", b"[]", b'"text"', b"3", b"\xef\xbb\xbf{}",
    b"--x\r\nContent-Disposition: form-data\r\n\r\n1\r\n--x--",
    b"<!DOCTYPE a [<!ENTITY b SYSTEM 'file:///etc/passwd'>]><a>&b;</a>", b"a=1&b=2",
    b"{" + b" " * 500_000 + b"}",
)  # fmt: skip
PATHS = (
    "/../../etc/passwd", "/v1/../v1/plan", "/v1/events/..%2f..%2fetc%2fpasswd", "/v1/events/%00",
    "/v1/events/%c0%ae%c0%ae", "/v1/events/%ff%fe", "/v1/events/" + "a" * 9000,
    "//evil.example/v1/plan", "/v1//plan", "/v1/plan/", "/v1/events/%0d%0aX-Evil:1",
    "/page/../store.py", "/page/%2e%2e/access.py", "/page//etc/passwd", "/v1/forecasts/__class__",
    "/v1/events/{{7*7}}", "/docs", "/.git/config", "/*", "/v1/setpoints?at=" + "9" * 5000,
    "/v1/setpoints?at=9999-12-31T23:59:59Z", "/v1/setpoints?asset=%00",
    "/v1/setpoints?at=2026-11-21T12:00:00Z&at=x", "/v1/setpoints?" + "a=1&" * 3000,
    "/readyz?max_age_seconds=NaN", "/readyz?max_age_seconds=-1e999", "/v1/plan?x=%ff",
)  # fmt: skip
HEADERS = (
    ("host", "evil.example"), ("host", "localhost:99999"), ("host", "localhost\t"),
    ("host", "[::1"), ("host", ""), ("origin", "http://evil.example"), ("origin", "null"),
    ("origin", "http://[::"), ("x-forwarded-host", "evil.example"),
    ("x-http-method-override", "DELETE"), ("content-type", "text/plain"),
    ("content-type", "application/xml"), ("content-type", "application/json; charset=utf-7"),
    ("content-type", "multipart/form-data"), ("content-length", "-1"),
    ("content-length", "9" * 30), ("transfer-encoding", "chunked"), ("if-match", "*"),
    ("if-match", '"' * 5000), ("if-none-match", "\xff\xfe"),
    ("authorization", "Bearer " + "a" * 60_000), ("authorization", "Bearer \xff"),
    ("authorization", "Basic Og=="), ("authorization", "Bearer"), ("idempotency-key", "\x01"),
    ("prefer", "respond-async, wait=1e999"), ("prefer", "wait=" + "9" * 5000),
    ("range", "bytes=0-0,1-1,2-2"), ("accept-encoding", "x" * 5000), ("connection", "upgrade"),
)  # fmt: skip
METHODS = ("TRACE", "CONNECT", "PATCH", "OPTIONS", "HEAD", "DELETE", "PUT", "POST", "FOO")


def valid_requests(scenario: Scenario, now: pd.Timestamp) -> list[tuple[str, str, Any]]:
    """Requests of each kind as they should be, to be spoiled."""
    battery, load = str(scenario.batteries.id[0]), str(scenario.customers.id[0])
    at, later = written(now), written(now + pd.Timedelta("2h"))
    told = [reading(battery, "soc", now, 0.5, None), reading(battery, "online", now, 1.0)]
    forecast = {
        "issued_at": at,
        "start": at,
        "resolution": "PT1H",
        "assets": {load: {"p10": [1.0], "p50": [2.0], "p90": [3.0]}},
    }
    belief = {
        "type": "outage_belief",
        "issued_at": at,
        "source": "notice",
        "probability": 0.6,
        "onset": {"start": at, "resolution": "PT1H", "probabilities": [0.5, 0.5]},
        "duration": {"family": "lognormal", "median_h": 7.0, "sigma": 1.3, "max_h": 72.0},
    }
    return [
        ("POST", "/v1/telemetry", {"series": told}),
        ("PUT", "/v1/forecasts/load_kw", forecast),
        ("PUT", "/v1/events/one", {"type": "outage", "source": "x", "start": at, "end": later}),
        (
            "PUT",
            "/v1/events/two",
            {"type": "import_limit", "start": at, "end": later, "limit_kw": 100.0},
        ),
        (
            "PUT",
            "/v1/events/three",
            {"type": "price", "start": at, "resolution": "PT1H", "price_gbp_per_kwh": [0.1, 0.2]},
        ),
        ("PUT", "/v1/events/four", {"type": "alert", "start": at, "text": "storm"}),
        ("PUT", "/v1/events/five", belief),
        ("DELETE", "/v1/events/one", None),
        ("POST", "/v1/steps", {"time": at}),
        ("PUT", "/v1/mode", {"mode": "auto", "until": later, "reason": "x"}),
        ("GET", "/v1/plan", None),
        ("GET", "/v1/setpoints", None),
        ("GET", "/v1/overview", None),
        ("GET", "/v1/status", None),
    ]


def hostile_requests(
    scenario: Scenario, now: pd.Timestamp, count: int, seed: int
) -> Iterator[Request]:
    """Valid requests with something spoiled: a leaf, the body, the path, a header, the method."""
    random = Random(seed)
    spoilers = (_leaf, _leaf, _leaf, _body, _path, _header, _method)
    valid = valid_requests(scenario, now)
    for _ in range(count):
        method, path, body = random.choice(valid)
        headers = {"host": "localhost", "content-type": "application/json"}
        text = b"" if body is None else json.dumps(body).encode()
        yield random.choice(spoilers)(Request(method, path, headers, text), random)


def _leaf(request: Request, random: Random) -> Request:
    """Another value somewhere in the body."""
    if not request.body:
        return _path(request, random)
    body = json.loads(request.body)
    holder, key = random.choice(list(_places(body)))
    kind = random.randrange(6)
    if kind == 0 and isinstance(holder, dict):
        holder[random.choice(TEXTS[1:])[:2000]] = 1
    elif kind == 1 and isinstance(holder, dict):
        del holder[key]
    else:
        holder[key] = "\N{SKULL}"
    word = random.choice(
        (*NUMBERS, *map(json.dumps, TEXTS), *map(json.dumps, TIMES), *DEEP[:2], "[]", "{}", "[[]]")
    )
    text = json.dumps(body).replace(json.dumps("\N{SKULL}"), word)
    return replace(request, body=text.encode("utf-8", "surrogatepass"))


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """All places in a body that hold something."""
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        yield value, key
        if isinstance(inner, (dict, list)):
            yield from _places(inner)


def _body(request: Request, random: Random) -> Request:
    """No body that anybody asked for."""
    raw = (*RAW, *(text.encode() for text in DEEP), request.body[:-1], request.body * 2)
    method = request.method if request.method != "GET" else "POST"
    return replace(request, method=method, body=random.choice(raw))


def _path(request: Request, random: Random) -> Request:
    """Another path, or an identifier that is none."""
    if random.random() < 0.5:
        return replace(request, target=random.choice(PATHS))
    word = quote(random.choice(TEXTS)[:3000].encode("utf-8", "surrogatepass"))
    return replace(request, target=f"{request.target.rpartition('/')[0]}/{word}")


def _header(request: Request, random: Random) -> Request:
    """Another header, or two."""
    return replace(request, headers=request.headers | dict(random.choices(HEADERS, k=2)))


def _method(request: Request, random: Random) -> Request:
    """Another verb."""
    return replace(request, method=random.choice(METHODS))
