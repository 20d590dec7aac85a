"""Plays sequences of requests to a service, which stand in ``tests/service/sequences/*.txt``.

``tests/service/sequences/README.md`` tells how they are written.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd
import pytest
import yaml

from tests.support.asgi import Answer, Caller
from tests.support.live_service import HERE, NOON, heard, readings, serving
from tests.support.page_words import NODE, first_lines
from tests.support.sites import SITES
from tests.support.three_phases import three_phases
from vppres.day.options import RunOptions
from vppres.day.reliability import reliability_by_tier
from vppres.day.trajectory import taken
from vppres.report.events import events_of
from vppres.service.clock import SetClock, written
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service
from vppres.service.replay.explanations import explained, question
from vppres.service.replay.export import export

FOLDER = Path(__file__).parents[1] / "service" / "sequences"
ROW = re.compile(
    r"(?P<time>\d\d:\d\d(:\d\d)?) (?P<request>.*?)(?: -> (?P<status>\d{3})?(?P<parts>.*))?$"
)
REQUEST = re.compile(r"(?P<what>[A-Z]+ \S+|\w+)(?P<headers>( [\w-]+=\S+)*)(?: (?P<body>.*))?$")
RUN_OPTIONS = {field.name for field in fields(RunOptions)}
TIME = re.compile(r"\d\d:\d\d(:\d\d)?$")


def moment(time: str) -> pd.Timestamp:
    """A time of the day; hours from 24 on are those of the next one."""
    return NOON.normalize() + pd.Timedelta(time + ":00" * (time.count(":") == 1))


# What an answer is compared with.


class Absent:
    """In place of a part that an answer lacks."""


@dataclass(frozen=True)
class Check:
    """Something else than equality that a part must satisfy."""

    name: str
    value: Any


def in_order(words: Any, text: str) -> bool:
    """Whether a text has some words, one after the other."""
    place = 0
    for word in words if isinstance(words, list) else [words]:
        place = text.find(str(word), place)
        if place < 0:
            return False
        place += len(str(word))
    return True


def near(value: Any, found: Any) -> bool:
    """Whether a number, or each of a list, is as far off at most as is said, or as usual."""
    value, within = (value["of"], value["within"]) if isinstance(value, dict) else (value, None)
    return bool(found == pytest.approx(value, abs=within))


def texts(found: Any) -> list[str]:
    """A text, or those of a list."""
    return [str(one) for one in found] if isinstance(found, list) else [str(found)]


class Checks:
    """The checks by their names, with what stands behind the name and what was found."""

    def __init__(self, known: dict[str, Any]) -> None:
        self.known = known

    def matches(self, expected: Any, found: Any) -> bool:
        """Whether a part is as it must be."""
        if isinstance(expected, Check):
            if found is Absent:
                return expected.name == "absent"
            return bool(getattr(self, expected.name.replace("-", "_"))(expected.value, found))
        if isinstance(expected, dict):
            return (
                isinstance(found, dict)
                and found.keys() == expected.keys()
                and self.part(expected, found)
            )
        if isinstance(expected, list):
            same = isinstance(found, list) and len(found) == len(expected)
            return same and all(map(self.matches, expected, found))
        return bool(found == expected)

    above = staticmethod(lambda value, found: found > value)
    below = staticmethod(lambda value, found: found < value)
    near = staticmethod(near)
    has = staticmethod(lambda value, found: any(in_order(value, text) for text in texts(found)))
    has_not = staticmethod(lambda value, found: not any(value in text for text in texts(found)))
    begins = staticmethod(lambda value, found: any(text.startswith(value) for text in texts(found)))
    ends = staticmethod(lambda value, found: any(text.endswith(value) for text in texts(found)))
    begins_not = staticmethod(
        lambda value, found: not any(text.startswith(value) for text in texts(found))
    )
    once = staticmethod(lambda value, found: str(found).count(value) == 1)
    count = staticmethod(lambda value, found: len(found) == value)
    names = staticmethod(lambda value, found: sorted(found) == sorted(value))

    def other(self, value: Any, found: Any) -> bool:
        """Another than this."""
        return not self.matches(value, found)

    contains = staticmethod(lambda value, found: value in found)
    within = staticmethod(lambda value, found: found in value)
    absent = staticmethod(lambda value, found: False)

    def all(self, value: list[Any], found: Any) -> bool:
        """Each of several checks."""
        return all(self.matches(each, found) for each in value)

    def only(self, value: Mapping[str, Any], found: list[str]) -> bool:
        """Of the texts that speak ``of`` something these ``are`` all."""
        return [text for text in found if value["of"] in text] == value["are"]

    def part(self, value: Mapping[str, Any], found: Any) -> bool:
        """These fields, whatever else there is."""
        return all(self.matches(each, at(found, name)) for name, each in value.items())

    def one(self, value: Any, found: list[Any]) -> bool:
        """An element of a list is so, or has these fields."""
        return any(self._is(value, each) for each in found)

    def none(self, value: Any, found: list[Any]) -> bool:
        """No element of a list."""
        return not self.one(value, found)

    def every(self, value: Any, found: list[Any]) -> bool:
        """All elements of a list, of which there are some."""
        return bool(found) and all(self._is(value, each) for each in found)

    def some_not(self, value: Any, found: list[Any]) -> bool:
        """Not all elements of a list."""
        return not all(self._is(value, each) for each in found)

    def sum(self, value: Mapping[str, Any], found: list[dict[str, Any]]) -> bool:
        """The sum of a field of all elements of a ``kind``."""
        kind, name = value["kind"], next(name for name in value if name != "kind")
        total = sum(one[name] for one in found if one["kind"] == kind)
        return self.matches(value[name], total)

    def not_kept(self, name: str, found: Any) -> bool:
        """Another than what is kept under a name."""
        return not self.kept(name, found)

    def where(self, value: Mapping[str, Any], found: list[Any]) -> bool:
        """Of the elements with these fields the others are as they must be, as a list each."""
        checks = {name: each for name, each in value.items() if isinstance(each, Check)}
        plain = {name: each for name, each in value.items() if name not in checks}
        rows = [one for one in found if self.part(plain, one)]
        return all(self.matches(each, [one[name] for one in rows]) for name, each in checks.items())

    def more(self, name: str, found: float) -> bool:
        """More than what is kept under a name."""
        return bool(found > self.known[name])

    def first(self, value: list[Any], found: list[Any]) -> bool:
        """The first elements of a list."""
        return self.matches(value, found[: len(value)])

    def keep(self, name: str, found: Any) -> bool:
        """Any: it is kept under a name."""
        self.known[name] = found
        return True

    def kept(self, name: str, found: Any) -> bool:
        """Equal to what is kept under a name."""
        return bool(found == self.known[name])

    def has_kept(self, name: str, found: str) -> bool:
        """A text in which is what is kept under a name."""
        return bool(self.known[name]) and self.known[name] in found

    def _is(self, value: Any, found: Any) -> bool:
        return self.part(value, found) if isinstance(value, dict) else self.matches(value, found)


def word(loader: Any, node: yaml.ScalarNode) -> Any:
    """A plain word: a number, true, false or null as in JSON, a time as it is sent, else a text."""
    if node.style is not None:
        return node.value
    if TIME.match(node.value):
        return written(moment(node.value))
    try:
        return json.loads(node.value)
    except ValueError:
        return node.value


def check(loader: Any, name: str, node: yaml.Node) -> Check:
    """A check by its name, and what stands behind it."""
    if isinstance(node, yaml.MappingNode):
        return Check(name, loader.construct_mapping(node, deep=True))
    if isinstance(node, yaml.SequenceNode):
        return Check(name, loader.construct_sequence(node, deep=True))
    return Check(name, word(loader, node))


class Words(yaml.SafeLoader):
    """YAML in which ``off`` is a word and a date a text."""

    yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}


Words.add_constructor("tag:yaml.org,2002:str", word)
Words.add_multi_constructor("!", check)


def read(text: str) -> Any:
    """A value in YAML."""
    return yaml.load(text.replace("!absent", "!absent ~"), Words)  # a safe loader with fewer types


def at(value: Any, path: str) -> Any:
    """A part of an answer by its path: keys, or in a list whom or what an element is of.

    ``*`` stands for all elements that have the rest, and ``.`` for the whole.
    """
    keys = [] if path == "." else path.split(".")
    while keys:
        key, keys = keys[0], keys[1:]
        if isinstance(value, dict):
            if ".".join([key, *keys]) in value:
                return value[".".join([key, *keys])]
            value = value.get(key, Absent)
        elif not isinstance(value, list):
            return Absent
        elif key == "*":
            return [at(one, ".".join(keys) or ".") for one in value if not keys or keys[0] in one]
        elif key.isdecimal():
            value = value[int(key)] if int(key) < len(value) else Absent
        else:
            found = [
                one for one in value if key in map(one.get, ("asset", "kind", "subject", "source"))
            ]
            assert len(found) <= 1, f"{len(found)} elements are of {key}"
            value = found[0] if found else Absent
    return value


# Files of sequences.


@dataclass(frozen=True)
class Sequence:
    """A site, and what is asked of its service row by row."""

    name: str
    site: Mapping[str, Any]
    rows: tuple[str, ...]
    mark: str = ""


def put_in(text: str, values: Mapping[str, Any]) -> str:
    """A text with values in place of their names, as far as these are known."""
    return re.sub(r"\$(\w+)", lambda name: str(values.get(name[1], name[0])), text)


def joined(text: str) -> Iterator[str]:
    """Lines without comments; one that is indented belongs to the one before."""
    lines: list[str] = []
    for line in text.splitlines():
        if line.startswith("  "):
            lines[-1] += " " + line.strip()
        elif line and not line.startswith("# "):
            lines.append(line.strip())
    yield from lines


def sequences(path: Path) -> Iterator[Sequence]:
    """The sequences of a file; one of several cases is several."""
    constants: dict[str, str] = {}
    head, *parts = "\n".join(joined(path.read_text(encoding="utf-8"))).split("== ")
    usual: dict[str, Any] = {}
    for line in head.splitlines():
        name, _, value = line.partition(" ")
        if name == "site":
            usual = read(f"{{{value}}}")
        else:
            constants[name.removeprefix("$")] = put_in(value.removeprefix("= "), constants)
    for part in parts:
        title, *lines = part.splitlines()
        yield from _cases(title, lines, usual, constants)


def _cases(
    title: str, lines: list[str], usual: Mapping[str, Any], constants: Mapping[str, str]
) -> Iterator[Sequence]:
    drawn: dict[str, list[str]] = {}
    site, mark, rows = "", "", list[str]()
    for line in lines:
        word, _, rest = line.partition(" ")
        if word == "each":
            names, _, values = put_in(rest, constants).partition(" in ")
            drawn[names] = values.split(" | ")
        elif word == "mark":
            mark = rest
        elif word == "site":
            site = rest
        else:
            rows.append(line)
    for chosen in product(*drawn.values()):
        case: dict[str, str] = {}
        slow = mark
        for names, values in zip(drawn, chosen, strict=True):
            if values.endswith(" !daily"):
                values, slow = values.removesuffix(" !daily"), "daily"
            pairs = zip(names.split(", "), values.split(" ; "), strict=True)
            case |= {name.removeprefix("$"): value for name, value in pairs}
        known = {**constants, **case}
        own = {**usual, **read("{" + put_in(site, known) + "}")}
        name = f"{title}: {', '.join(case.values())[:60]}" if case else title
        yield Sequence(name, own, tuple(put_in(row, known) for row in rows), slow)


def case(file: Path, one: Sequence) -> Any:
    """A sequence as a case of a test; what the page says is told by node."""
    marks = [getattr(pytest.mark, one.mark)] if one.mark else []
    if NODE is None and any(" page ->" in row for row in one.rows):
        marks.append(pytest.mark.skip("no node on the path"))
    return pytest.param(one, id=f"{file.stem}: {one.name}", marks=marks)


def cases() -> list[Any]:
    """All sequences of the files as cases of a test."""
    return [case(file, one) for file in sorted(FOLDER.glob("*.txt")) for one in sequences(file)]


def service_of(given: Mapping[str, Any]) -> Service:
    """The service of a site: a feeder by name, columns of its tables, and options."""
    given = {"feeder": "tiny", **given}
    day = SITES[given.pop("feeder")]()
    if given.pop("by_phase", False):
        day = three_phases(day)
    options: dict[str, Any] = {}
    service: dict[str, Any] = {}
    for name, value in given.items():
        if isinstance(value, dict):
            day = replace(day, **{name: replace(getattr(day, name), **value)})
        elif name in RUN_OPTIONS:
            options[name] = value
        else:
            service[name] = value
    return Service(day, replace(HERE, **options), **service)


class Player:
    """A service that is asked row by row."""

    def __init__(
        self, service: Service, folder: Path, stack: ExitStack, caught: pytest.LogCaptureFixture
    ) -> None:
        self.service, self.folder, self.stack, self.caught = service, folder, stack, caught
        self.clock = SetClock(NOON)
        self.known: dict[str, Any] = {"etag": ""}
        self.checks = Checks(self.known)
        self.http: Caller
        self.runner: Runner
        self.restart(None)

    def play(self, rows: tuple[str, ...]) -> None:
        """Ask, and compare the answers."""
        for row in rows:
            found = ROW.match(row)
            assert found, f"no row: {row}"
            request = put_in(found["request"], self.known)
            assert "$" not in request + (found["parts"] or ""), f"a name that is not known: {row}"
            asked = REQUEST.match(request)
            assert asked, f"no request: {row}"
            answer = self.ask(moment(found["time"]), asked)
            status = int(found["status"] or 200)
            assert answer.status == status, (row, answer)
            if asked["what"] == "hear" and not found["parts"]:
                assert answer.json()["refused"] == [], (row, answer)
            for name, expected in (read(f"{{{found['parts'] or ''} }}") or {}).items():
                part = self.part(answer, name)
                assert self.checks.matches(expected, part), (row, name, part)
            self.note(answer)

    def part(self, answer: Answer, path: str) -> Any:
        """A part of an answer, its text, one of its headers, or who is ``off`` by a plan, and why."""
        if path == "off":
            customers = [one for one in answer.json()["setpoints"] if one["kind"] == "customers"]
            return {one["asset"]: one["reason"] for one in customers if not one["served"]}
        if path.startswith("headers."):
            return answer.headers.get(path.removeprefix("headers."), Absent)
        return answer.content.decode() if path == "text" else at(answer.json(), path)

    def ask(self, now: pd.Timestamp, asked: re.Match[str]) -> Answer:
        """One request at a time."""
        body = read(asked["body"]) if asked["body"] else None
        if asked["what"] == "look":
            self.runner.set_clock(now)
        elif asked["what"] != "check":
            self.clock.set(now)
        method, _, path = asked["what"].partition(" ")
        if not path:
            act: Callable[[Any], Answer] = getattr(self, method)
            return act(body)
        sent = dict(header.split("=", 1) for header in asked["headers"].split())
        return self.http.ask(method, path if path[0] == "/" else f"/v1/{path}", body, sent)

    def hear(self, body: Any) -> Answer:
        """Telemetry: quantities of assets, read now or ``at`` a time, by ``source``, that ``lasts``."""
        series = []
        for part in body if isinstance(body, list) else [body]:
            time = pd.Timestamp(part.get("at", self.clock.now()))
            more = {"source": part.get("source", "scada"), "resolution": part.get("lasts", "PT1H")}
            told = {name: values for name, values in part.items() if isinstance(values, dict)}
            for quantity, values in told.items():
                series += [{**one, **more} for one in readings(time, quantity, values)]
        return self.http.post("/v1/telemetry", {"series": series})

    def decide(self, soc: float) -> Answer:
        """The step, with a state of charge of both batteries."""
        assert self.http.post("/v1/telemetry", heard(self.clock.now(), soc)).status == 200
        return self.http.post("/v1/steps")

    def anew(self, _: None) -> Answer:
        """The rest of the step, if there is a reason."""
        return answered(self.runner.anew())

    def look(self, _: None) -> Answer:
        """The alarms, after the time that has gone by."""
        self.runner.watch.check_alarms()
        return self.http.get("/v1/alarms")

    def check(self, _: None) -> Answer:
        """The alarms by the service's own clock, and what that says."""
        self.runner.watch.check_alarms()
        found = self.http.get("/v1/alarms").json()["alarms"]
        return answered({"now": written(self.runner.clock.now()), "alarms": found})

    def page(self, _: None) -> Answer:
        """First lines of the page."""
        site, overview = (self.http.get(f"/v1/{name}").json() for name in ("site", "overview"))
        return answered(first_lines(site, overview, self.folder))

    def standing(self, _: None) -> Answer:
        """Alarms that are not cleared and whose condition is not gone."""
        found = self.http.get("/v1/alarms").json()["alarms"]
        return answered(
            {"alarms": [one for one in found if not (one["cleared_at"] or one["gone_since"])]}
        )

    def explain(self, _: None) -> Answer:
        """Why devices do what the last plan says."""
        assert self.runner.last
        return answered(explained(question(self.runner, self.runner.last)))

    def reasons(self, _: None) -> Answer:
        """What has changed since the last plan, in words, and whether a new one is wanted at once."""
        changes = self.runner.changes
        return answered({"reasons": list(changes.reasons), "new": changes.new.is_set()})

    def log(self, _: None) -> Answer:
        """What was logged so far."""
        return answered({"messages": self.caught.messages})

    def export(self, span: dict[str, str]) -> Answer:
        """Tables of the run that is written out: columns over steps, of each asset if there are some."""
        run = export(self.service, self.folder, span["from"], span["to"])
        found: dict[str, Any] = {"steps": run.steps.to_dict("list")}
        found["tiers"] = reliability_by_tier(run).to_dict("index")
        found["events"] = [one.words for one in events_of(run)]
        found["supplied"] = run.supplied.tolist()
        found["off_min"] = (run.time_off * 60.0).tolist()
        found["taken"] = taken(run.customers).tolist()
        found["scenario"] = {name: values.tolist() for name, values in run.scenario.series.items()}
        for name, key in (("customers", "id"), ("batteries", "id"), ("gensets", "genset")):
            table = getattr(run, name)
            assets = [] if table is None or table.empty else table.groupby(key, sort=False)
            found[name] = {asset: rows.to_dict("list") for asset, rows in assets}
        return answered(found)

    def listen(self, _: None) -> Answer:
        """What was missed is looked for, as after a start."""
        self.runner.hearing.look()
        return answered({})

    def restart(self, _: None) -> Answer:
        """The service ends and begins again."""
        self.stack.close()
        self.http, self.runner = self.stack.enter_context(
            serving(self.service, self.folder, self.clock)
        )
        return answered({})

    def note(self, answer: Answer) -> None:
        """Keep what later rows name."""
        self.known["etag"] = answer.headers.get("etag", self.known["etag"])
        found = answer.json() if answer.content[:1] == b"{" else {}
        points = found.get("setpoints")
        for point in points if isinstance(points, list) else ():
            name, number = point["asset"], point.get("id")
            if number and self.known.get(name) != number:
                self.known["old_" + name] = self.known.get(name, "")
                self.known[name] = number


def answered(found: Any) -> Answer:
    """An answer in this process; 204 if there is none."""
    return Answer(204 if found is None else 200, {}, json.dumps(found, default=str).encode())


def play(sequence: Sequence, folder: Path, log: pytest.LogCaptureFixture) -> None:
    """Play a sequence against a service of its site."""
    with ExitStack() as stack:
        Player(service_of(sequence.site), folder, stack, log).play(sequence.rows)
