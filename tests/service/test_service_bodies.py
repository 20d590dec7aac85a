"""What is accepted over HTTP can be decided on; what is not is refused by name, and cheaply."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.support.asgi import Caller
from tests.support.live_service import NOON, client, decided, site
from tests.support.strangers import empty_texts, telemetry, unknown_fields
from tests.support.tiny_day import tiny_scenario
from vppres.day.options import RunOptions
from vppres.scenario.scenario import Scenario
from vppres.service import payloads
from vppres.service.clock import SetClock
from vppres.service.operation.site import Service

BELIEVING = RunOptions(horizon_h=2.0, isolate=False, outages="belief")
HUGE = 10**400
SEE = "The fields are described in /openapi.json."
BEGIN = "2026-11-21T12:00:00Z"
LATE = "2199-12-31T00:00:00Z"


def belief(**fields: Any) -> dict[str, Any]:
    onset = {"start": BEGIN, "resolution": "PT1H", "probabilities": [1.0]}
    return {"type": "outage_belief", "probability": 0.5, "onset": onset, **fields}


def forecast(values: list[float], resolution: str = "PT1H", start: str = BEGIN) -> dict[str, Any]:
    assets = {"shop": {"p50": values}}
    return {"issued_at": BEGIN, "start": start, "resolution": resolution, "assets": assets}


def openadr(kind: str, values: list[Any], **period: str) -> dict[str, Any]:
    common = {"start": BEGIN, "duration": "PT1H", **period}
    part = {"payloads": [{"type": kind, "values": values}]}
    return {"programID": "p", "intervalPeriod": common, "intervals": [part, part]}


def weibull(**more: float) -> dict[str, Any]:
    return belief(duration={"family": "weibull", "scale_h": 4.0, "shape": 0.003, **more})


CENTURIES = {"start": LATE, "resolution": "PT9999H"}
EVENTS = {
    "weibull of nothing": weibull(),
    "weibull without end": weibull(max_h=9.0),
    "onset of centuries": belief(onset={**CENTURIES, "probabilities": [0.0] * 1999 + [1]}),
    "prices of centuries": {"type": "price", "start": LATE, "resolution": "PT1H",
                            "price_gbp_per_kwh": [1.0] * 2000},
    "limit of 400 digits": {"type": "import_limit", "start": BEGIN, "limit_kw": HUGE},
}  # fmt: skip
FORECASTS = {
    "a gigawatt": forecast([2e6]),
    "400 digits": forecast([HUGE]),
    "watts for kilowatts": forecast([40_000.0]),
    "of tomorrow": {**forecast([40.0]), "issued_at": "2026-11-22T12:00:00Z"},
}
TELEMETRY = {
    "centuries": telemetry(**CENTURIES, values=[0.5] * 2000),
    "400 digits": telemetry(values=[HUGE]),
    "a gigawatt": telemetry(asset="shop", quantity="load_kw", values=[2e6]),
}
OPENADR = {
    "400 digits": openadr("PRICE", [HUGE]),
    "centuries": openadr("ALERT_OTHER", [], start=LATE, duration="P300D"),
    "a gigawatt": openadr("IMPORT_CAPACITY_LIMIT", [1e10]),
}
REFUSED = {
    "PUT /v1/events/x": EVENTS,
    "PUT /v1/forecasts/load_kw": FORECASTS,
    "POST /v1/telemetry": TELEMETRY,
    "POST /v1/openadr/events": OPENADR,
}


@pytest.fixture(scope="module")
def http(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Caller]:
    """A service with beliefs at noon, which is told nothing that it takes."""
    service = Service(site(tiny_scenario()), BELIEVING)
    with client(service, tmp_path_factory.mktemp("live"), SetClock(NOON)) as caller:
        yield caller


@pytest.mark.parametrize(
    ("route", "name"), [(route, name) for route, bodies in REFUSED.items() for name in bodies]
)
def test_what_no_step_could_take_is_refused(route: str, name: str, http: Caller) -> None:
    answer = http.ask(*route.split(), REFUSED[route][name], {})
    assert answer.status == 422, answer
    problem = answer.json()["problems"][0]
    assert problem["message"] and problem["cure"]
    if name == "weibull of nothing":
        assert (problem["field"], problem["value"]) == ("duration.shape", "0.003")


numbers = st.one_of(
    st.floats(allow_nan=False),
    st.sampled_from([0.0, 1e-300, 5e-324, 1e6, 1e9, 1e300, -1.0, 0.003, 20.0, HUGE]),
)
lengths = st.one_of(
    st.fixed_dictionaries({"family": st.just("weibull"), "scale_h": numbers, "shape": numbers},
                          optional={"max_h": numbers}),
    st.fixed_dictionaries({"family": st.just("lognormal"), "median_h": numbers, "sigma": numbers},
                          optional={"max_h": numbers}),
    st.fixed_dictionaries({"family": st.just("discrete"), "hours": st.lists(numbers, min_size=1, max_size=1),
                           "probabilities": st.just([1.0])}),
)  # fmt: skip
messages = st.one_of(
    numbers.map(lambda x: ("/v1/forecasts/load_kw", forecast([x]))),
    numbers.map(
        lambda x: ("/v1/forecasts/pv_kw", {**forecast([x]), "assets": {"roof": {"p50": [x]}}})
    ),
    st.tuples(numbers, lengths).map(
        lambda x: ("/v1/events/storm", belief(probability=x[0], duration=x[1]))
    ),
    lengths.map(lambda x: ("/v1/events/storm", belief(duration=x))),
    numbers.map(
        lambda x: ("/v1/events/cap", {"type": "import_limit", "start": BEGIN, "limit_kw": x})
    ),
    numbers.map(
        lambda x: (
            "/v1/events/price",
            {"type": "price", "start": BEGIN, "resolution": "PT1H", "price_gbp_per_kwh": [x]},
        )
    ),
)


@pytest.mark.daily
@pytest.mark.filterwarnings("ignore:overflow", "ignore:divide", "ignore:invalid")
def test_whatever_is_said_the_step_is_decided(
    tiny: Scenario, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """By property: a message is refused, or the next step stands on it."""

    @settings(max_examples=7, suppress_health_check=list(HealthCheck))
    @given(st.lists(messages, min_size=1, max_size=3))
    def check(said: list[tuple[str, dict[str, Any]]]) -> None:
        clock = SetClock(NOON)
        folder = tmp_path_factory.mktemp("live")
        with client(Service(site(tiny), BELIEVING), folder, clock) as http:
            for path, body in said:
                assert http.put(path, body).status in (200, 201, 422)
            plan = decided(http, clock, NOON)
            assert plan["status"] == "ok", (plan.get("reason"), plan["solve"])

    check()


def empty_lists() -> bytes:
    return b"[%s[]]" % (b"[]," * 2_600_000)


@pytest.mark.daily
@pytest.mark.parametrize(
    ("body", "status"), [(empty_texts, 422), (unknown_fields, 413), (empty_lists, 413)]
)
def test_a_body_of_mistakes_costs_little(
    body: Callable[[], bytes], status: int, http: Caller
) -> None:
    sent = body()
    begin = time.process_time()
    answer = http.post("/v1/telemetry", sent)
    used_s = time.process_time() - begin
    assert answer.status == status and len(answer.json().get("problems", [])) <= 50
    # A mistake is some 1 kB and 40 us: 2.6 million are 3.3 GB and minutes.
    assert used_s < 2.0


@pytest.mark.parametrize(("body", "said"), [
    ({"type": "outagee"}, "body.type = outagee: is not known. Did you mean outage?"),
    ({"start": BEGIN}, f"body.type: is missing. {SEE}"),
    ({"type": "outage"}, f"body.outage.start: is missing. {SEE}"),
    ({"type": "outage", "start": BEGIN, "ende": BEGIN},
        f"body.outage.ende = {BEGIN}: is not a known field. {SEE}"),
    ({"type": "import_limit", "start": BEGIN, "limit_kw": "many"},
        f"body.import_limit.limit_kw = many: must be a valid number. {SEE}"),
    ({"type": "import_limit", "start": BEGIN, "limit_kw": -3},
        f"body.import_limit.limit_kw = -3: must be greater than or equal to 0. {SEE}"),
    ({"type": "outage", "start": "noon"}, "body.outage.start = noon: is not a time. "
        "Write ISO 8601, for example 2026-07-19T12:00:00Z."),
    ([], f"body: must be an object with fields. {SEE}"),
])  # fmt: skip
def test_a_mistake_has_place_value_and_fix(body: Any, said: str, http: Caller) -> None:
    answer = http.put("/v1/events/storm", body)
    assert (answer.status, answer.json()["detail"]) == (422, f"request, {said}")


def test_a_batch_of_mistakes_is_told_by_its_first_ones(http: Caller) -> None:
    """Fifty mistakes in each of 2,000 series took a second to collect, in which nothing answers."""
    unknown = {f"unknown_{i}": 1 for i in range(payloads.MOST_FIELDS)}

    def told(series: int) -> float:
        gc.disable()  # what other tests have left is not looked through for it
        begin = time.process_time()
        answer = http.post("/v1/telemetry", {"series": [unknown] * series})
        used_s = time.process_time() - begin
        gc.enable()
        assert answer.status == 422 and len(answer.json()["problems"]) == 50
        assert answer.json()["problems"][0]["field"] == "series.0.source"
        return used_s

    told(1)
    assert told(payloads.MOST_SERIES) < 8.0 * told(payloads.MOST_SERIES // 4)
