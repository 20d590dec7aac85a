"""Follows a feed: its incidents in a site's areas come, change and go as events of a service."""

from __future__ import annotations

import http.client
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from math import inf
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd

import vppres
from vppres.core.errors import InputError
from vppres.feeds.adapters import PublicFeed
from vppres.feeds.incidents import FeedSnapshot
from vppres.service.clock import written
from vppres.service.http.client import Client

LEAST_S = 60.0
"""Time between two requests of a feed at least."""

MOST_OFTEN = 8
"""How many times as late a silent feed is asked at most."""

LOOK_S = 10.0
"""Time between two looks at the clock: whether to ask, and whether a feed is late."""

LATE = pd.Timedelta(minutes=30)
"""Age of an answer from which it is late: feeds are made anew every two to ten minutes."""

MOST_BYTES = 20_000_000
"""Of an answer; a storm's has some hundred kilobytes."""

TIMEOUT_S = 30.0
"""For a whole answer, its head included."""

MOST_PAUSE_S = 6 * 3600.0
"""Longest pause that a feed may want: outages last for hours."""

LATE_S = 1.0
"""Beyond the limit: the part that comes last is still looked at."""

CHUNK_BYTES = 65_536
STAMP = "%Y-%m-%dT%H%M%SZ"
"""Time of a recorded answer in its file name."""

Told = Callable[[str], None]


class EventSink:
    """Receiver of events. This one takes them and does nothing: changes are shown only."""

    def put(self, name: str, body: dict[str, Any]) -> None:
        """Announce or change an event."""

    def withdraw(self, name: str) -> None:
        """Take an event back."""

    def said(self, source: str) -> dict[str, dict[str, Any]]:
        """Events of a source that hold."""
        return {}

    def set_clock(self, now: pd.Timestamp) -> None:
        """Let it be so late, in a replay."""


class OverHTTP(EventSink):
    """A service that listens at an address."""

    def __init__(self, client: Client) -> None:
        self.client = client

    def put(self, name: str, body: dict[str, Any]) -> None:
        """Announce or change an event."""
        self.client.wanted("PUT", f"/v1/events/{quote(name, safe='')}", body)

    def withdraw(self, name: str) -> None:
        """Take an event back; one that is gone already stays so."""
        answer = self.client.ask("DELETE", f"/v1/events/{quote(name, safe='')}")
        if answer.status >= 400 and answer.status != 404:
            raise InputError(f"DELETE {name}: the service answers {answer.status}")

    def said(self, source: str) -> dict[str, dict[str, Any]]:
        """Events of a source that hold."""
        events = self.client.wanted("GET", "/v1/events").body
        return {name: body for name, body in events.items() if body.get("source") == source}

    def set_clock(self, now: pd.Timestamp) -> None:
        """Set the clock of a service that is paced."""
        self.client.wanted("PUT", "/v1/clock", {"now": written(now)})


def events_at(url: str | None, token: str | None) -> EventSink:
    """The service at an address, or none: changes are shown only."""
    return EventSink() if url is None else OverHTTP(Client(url, token))


class Follower:
    """Turns answers of a feed into events.

    ``areas`` are postcodes, sectors or districts of the site; ``told`` gets a line for each change.
    """

    def __init__(self, feed: PublicFeed, areas: list[str], service: EventSink, told: Told) -> None:
        self.feed = feed
        self.areas = areas
        self.service = service
        self.told = told
        self.heard: pd.Timestamp | None = None
        self._begun: pd.Timestamp | None = None
        self._refused: dict[str, dict[str, Any]] = {}
        kept = service.said(feed.name)
        self._late = kept.pop(self._alert, None) is not None
        self._said = {name: _without_version(body) for name, body in kept.items()}

    def hear(self, content: bytes, now: pd.Timestamp) -> None:
        """Announce, change and withdraw what an answer says.

        Raises
        ------
        InputError
            If it cannot be read; what was said before stays.
        OSError
            If the service does not answer.
        """
        answer = self.feed.read(content)
        self.heard = now if answer.made_at is None else min(answer.made_at, now)
        if answer.left_out:
            self.told(f"{self.feed.name}: {answer.left_out} rows could not be read")
        self._announce(answer, now)

    def _announce(self, answer: FeedSnapshot, now: pd.Timestamp) -> None:
        """The events of an answer in the place of those before."""
        near = [one for one in answer.incidents if one.touches(self.areas)]
        there = {f"{self.feed.name} {one.name}": one for one in near if not one.restored}
        for name in [name for name in self._said if name not in there]:
            self.service.withdraw(name)
            del self._said[name]
            self.told(f"{name}: over")
        for name, incident in there.items():
            body = incident.event(self.feed.name, now)
            # An estimate that is over leaves what was said: the outage outlasts it.
            if body is None or body in (self._said.get(name), self._refused.get(name)):
                continue
            try:
                self.service.put(name, body)
            except InputError as error:  # the others are announced all the same
                self._refused[name] = body
                self.told(str(error))
                continue
            self.told(f"{name}: {_words(body)}{' (changed)' if name in self._said else ''}")
            self._said[name] = body

    def watch(self, now: pd.Timestamp) -> None:
        """Say that the feed is late, and that it is back.

        Raises
        ------
        InputError, OSError
            If the service does not take it.
        """
        self._begun = self._begun or now
        since = self.heard or self._begun
        late = now - since > LATE
        if late and not self._late:
            text = f"The feed of {self.feed.operator} is late: nothing since {written(since)}"
            alert = {"type": "alert", "source": self.feed.name, "start": written(now), "text": text}
            self.service.put(self._alert, alert)
            self._late = True
            self.told(f"{text}. What it said before stays.")
        elif not late and self._late:
            self.service.withdraw(self._alert)
            self._late = False
            self.told(f"The feed of {self.feed.operator} is back.")

    @property
    def _alert(self) -> str:
        return f"{self.feed.name} late"


class Redirected(urllib.request.HTTPRedirectHandler):
    """Follows one redirection, which keeps the encryption if there is any."""

    max_redirections = 1

    def redirect_request(
        self, req: urllib.request.Request, fp: Any, code: int, msg: str, headers: Any, newurl: str
    ) -> urllib.request.Request | None:
        """The request at the other address.

        Raises
        ------
        OSError
            If the other address has no encryption and the first one has.
        """
        if req.type == "https" and not newurl.startswith("https:"):
            raise OSError(f"it moves to {newurl}, which has no encryption")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


class Asker:
    """Asks a feed when it is time, with what its last answer was called.

    A feed that does not answer is asked twice as late each time, at most eight times as late, and
    not before it wants to be asked again.

    Parameters
    ----------
    feed : PublicFeed
        Which one.
    every_s : float
        Time between two requests in s.
    clock : callable, optional
        Time in s.

    Raises
    ------
    InputError
        If it would be asked more often than once a minute.
    """

    def __init__(
        self, feed: PublicFeed, every_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        if not every_s >= LEAST_S:
            raise InputError.of(
                "options",
                "asks a feed more often than once a minute",
                "Give 1 minute or more.",
                field="every",
                value=f"{every_s / 60.0:g}",
            )
        self.feed = feed
        self._every_s = every_s
        self._clock = clock
        self._open = urllib.request.build_opener(Redirected).open
        self._tag: str | None = None
        self._content: bytes | None = None
        self._failures = 0
        self._next_s = -inf
        self._asking: threading.Thread | None = None

    def ask(self) -> bytes | None:
        """The answer, the one before if nothing has changed; None if it is not time to ask.

        Raises
        ------
        InputError
            If there is no answer.
        """
        now_s = self._clock()
        if now_s < self._next_s:
            return None
        self._failures += 1
        self._next_s = now_s + self._every_s * min(2**self._failures, MOST_OFTEN)
        try:
            self._content = self._within_limit()
        except urllib.error.HTTPError as error:
            if error.code != http.client.NOT_MODIFIED or self._content is None:
                pause_s = _pause_s(error.headers.get("Retry-After"))
                self._next_s = max(self._next_s, now_s + pause_s)
                pause = f" and wants a pause of {pause_s / 60.0:.0f} min" if pause_s else ""
                raise _silent(self.feed, f"answers {error.code}{pause}") from error
        except (OSError, ValueError, http.client.HTTPException) as error:
            raise _silent(self.feed, f"does not answer: {error}") from error
        self._failures = 0
        self._next_s = now_s + self._every_s
        return self._content

    def _within_limit(self) -> bytes:
        """The answer, within the limit of time for the whole of it.

        A head that drips never times out: it is left to itself, and nothing is asked beside it.
        """
        if self._asking is not None and self._asking.is_alive():
            raise TimeoutError("its answer before is still on the way")
        found: list[bytes] = []
        failed: list[Exception] = []

        def ask() -> None:
            try:
                found.append(self._answer())
            except Exception as error:
                failed.append(error)

        self._asking = threading.Thread(target=ask, name="vppres-feed", daemon=True)
        self._asking.start()
        self._asking.join(TIMEOUT_S + LATE_S)
        if failed:
            raise failed.pop()
        if not found:
            raise TimeoutError(f"it is not done within {TIMEOUT_S:g} s")
        return found[0]

    def _answer(self) -> bytes:
        """Content that the feed sends now."""
        headers = {"User-Agent": f"vppres/{vppres.__version__}"}
        if self._tag is not None:
            headers["If-None-Match"] = self._tag
        request = urllib.request.Request(self.feed.url, headers=headers)
        end_s = time.monotonic() + TIMEOUT_S
        content = bytearray()
        with self._open(request, timeout=TIMEOUT_S) as response:
            while part := response.read1(CHUNK_BYTES):
                content += part
                if len(content) > MOST_BYTES:
                    raise OSError(f"it sends more than {MOST_BYTES:,} bytes")
                if time.monotonic() > end_s:
                    raise OSError(f"it is not done within {TIMEOUT_S:g} s")
            if response.length:
                raise OSError(f"it breaks off {response.length:,} bytes before the end")
            self._tag = response.headers.get("ETag")
        return bytes(content)


def _pause_s(said: str | None) -> float:
    """Time for which a feed does not want to be asked, 0 if it says nothing of it.

    >>> _pause_s("120"), _pause_s(None), _pause_s("soon"), _pause_s("9" * 400)
    (120.0, 0.0, 0.0, 21600.0)
    """
    if said is None:
        return 0.0
    try:
        wanted_s = float(said) if said.isdecimal() else _until_s(said)
    except (OverflowError, TypeError, ValueError):
        return 0.0
    return min(max(wanted_s, 0.0), MOST_PAUSE_S)


def _until_s(said: str) -> float:
    """Time until a date of HTTP, in s."""
    return (parsedate_to_datetime(said) - datetime.now(UTC)).total_seconds()


def follow(
    follower: Follower, asker: Asker, end: threading.Event, record: Path | None = None
) -> None:
    """Ask whenever it is time, until the end; what fails is said and tried again.

    Whether the feed is late is looked at beside it, however long an answer takes.
    """
    watching = threading.Thread(
        target=_watch, args=(follower, end), name="vppres-late", daemon=True
    )
    watching.start()
    while not end.is_set():
        now = _now()
        with _failures_told(follower):
            content = asker.ask()
            if content is not None:
                if record is not None:
                    record.mkdir(parents=True, exist_ok=True)
                    stamp = now.strftime(STAMP)
                    (record / f"{stamp}{follower.feed.suffix}").write_bytes(content)
                follower.hear(content, now)
        end.wait(LOOK_S)


def _watch(follower: Follower, end: threading.Event) -> None:
    """Look whether the feed is late, until the end."""
    while not end.is_set():
        with _failures_told(follower):
            follower.watch(_now())
        end.wait(LOOK_S)


@contextmanager
def _failures_told(follower: Follower) -> Iterator[None]:
    """Print what a feed, a service or a disk refuses, and go on."""
    try:
        yield
    except (InputError, OSError) as error:
        follower.told(str(error))


def _now() -> pd.Timestamp:
    return pd.Timestamp.now(tz="UTC")


def recorded(folder: Path, feed: PublicFeed) -> Iterator[tuple[pd.Timestamp, bytes]]:
    """Recorded answers of a folder with their times, in order.

    Raises
    ------
    InputError
        If there are none, or a name is no time.
    """
    files = sorted(folder.glob(f"*{feed.suffix}")) if folder.is_dir() else []
    if not files:
        raise InputError.of(
            str(folder),
            f"holds no recorded answers of {feed.name}",
            f"Give a folder with files such as 2026-07-19T120000Z{feed.suffix}.",
        )
    for file in files:
        try:
            time = pd.Timestamp(datetime.strptime(file.stem, STAMP), tz="UTC")
        except ValueError as error:
            raise InputError.of(
                str(file),
                "has a name that is no time",
                f"Name it as 2026-07-19T120000Z{feed.suffix}.",
            ) from error
        yield time, file.read_bytes()


def replay(
    follower: Follower,
    answers: Iterator[tuple[pd.Timestamp, bytes]],
    speed: float,
    wait: Callable[[float], bool],
) -> int:
    """Play recorded answers, at a multiple of their speed or, at 0, one after another.

    Returns
    -------
    int
        Answers that could not be read.
    """
    before: pd.Timestamp | None = None
    wrong = 0
    for now, content in answers:
        if speed and before is not None:
            wait((now - before).total_seconds() / speed)
        before = now
        follower.service.set_clock(now)
        follower.told(written(now))
        try:
            follower.hear(content, now)
        except InputError as error:
            wrong += 1
            follower.told(str(error))
        follower.watch(now)
    return wrong


def _silent(feed: PublicFeed, message: str) -> InputError:
    return InputError.of(f"feed {feed.name}", message, "It is asked again.")


def _words(body: dict[str, Any]) -> str:
    """An event in a few words."""
    if body["type"] == "outage":
        return f"planned outage, {body['start']} to {body['end']}"
    return f"restoration about {body['likely']}"


def _without_version(body: dict[str, Any]) -> dict[str, Any]:
    """Event as it was put, without the version."""
    return {name: value for name, value in body.items() if name != "version" and value is not None}
