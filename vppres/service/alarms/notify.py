"""Tells people of alarms: webhooks and mail, each in a thread of its own that holds up no step."""

from __future__ import annotations

import base64
import json
import logging
import os
import queue
import smtplib
import ssl
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from email.message import EmailMessage
from email.utils import localtime, make_msgid
from typing import Any
from urllib.parse import SplitResult, parse_qs, unquote, urlsplit

from vppres.core.errors import InputError
from vppres.core.text import visible
from vppres.service.alarms.state import Notice

TIMEOUT_S = 10.0
DELIVERY_S = 30.0
"""Limit of one attempt as a whole: a server that sends a byte now and then never times out."""

ATTEMPTS_AFTER_S = (0.0, 5.0, 60.0)
"""Waits before each attempt: a server that restarts is back by the last one."""

MOST_WAITING = 100
"""Notices that wait for a server that does not answer; later ones are dropped, and logged."""

SMTP_PASSWORD = "VPPRES_SMTP_PASSWORD"
SMTP_PORTS = {"smtp": 25, "smtps": 465}

log = logging.getLogger(__name__)

Send = Callable[[dict[str, Any]], None]


@dataclass(frozen=True)
class Target:
    """Target of notices; the log contains its host alone."""

    name: str
    send: Send


def target_of(text: str) -> Target:
    """A target: ``https://HOST/PATH`` or, for mail, ``smtp://USER@HOST:PORT/TO?from=FROM``.

    Raises
    ------
    InputError
        If it is neither.
    """
    parts = _parts(text)
    kinds: dict[str, Callable[[SplitResult], Send]] = {
        "http": _webhook,
        "https": _webhook,
        "smtp": _mail,
        "smtps": _mail,
    }
    mail = parts.scheme in SMTP_PORTS
    if parts.scheme not in kinds or not parts.hostname or (mail and "@" not in parts.path):
        raise _no_address(f"{parts.scheme}://{parts.hostname or ''}")
    return Target(parts.hostname, kinds[parts.scheme](parts))


def _parts(text: str) -> SplitResult:
    """Parts of an address; InputError if it cannot be one. What may be secret is not shown."""
    if not (text.isascii() and text.isprintable()) or " " in text:
        raise _no_address("an address with a space, a control character or one beyond ASCII")
    try:
        parts = urlsplit(text)
        _ = parts.port
    except ValueError as error:
        raise _no_address(text.partition(":")[0] + "://...") from error
    return parts


def _no_address(shown: str) -> InputError:
    cure = "Write https://HOST/PATH, or smtp://USER@HOST:PORT/TO?from=FROM."
    problem = "is no address of a webhook or for mail"
    return InputError.of("options", problem, cure, field="notify", value=shown)


def message_of(site: str, notice: Notice) -> dict[str, Any]:
    """A notice as it is sent; ``text`` is what chat servers show."""
    lines = [f"{site}: alarm {notice.what}"]
    for one in notice.alarms:
        advice = "" if notice.what == "cleared" else f" {one['advice']}"
        lines.append(f"[{one['priority']}] {one['text']}{advice}")
    return {"site": site, "what": notice.what, "text": "\n".join(lines), "alarms": notice.alarms}


class Notifier:
    """Takes notices, and sends each to every target."""

    def __init__(self, site: str, couriers: Sequence[_Courier]) -> None:
        self._site = site
        self._couriers = couriers

    def __call__(self, notice: Notice) -> None:
        """Take a notice, and do not wait."""
        message = message_of(self._site, notice)
        for courier in self._couriers:
            courier.take(message)

    def unreached(self) -> list[str]:
        """Names of targets that the last notice did not reach, or whose courier has ended."""
        return sorted({one.name for one in self._couriers if one.failed or not one.alive})

    def alive(self) -> bool:
        """Whether every target has its courier."""
        return all(one.alive for one in self._couriers)


@contextmanager
def notifier(site: str, targets: Iterable[Target]) -> Iterator[Notifier]:
    """Something that takes notices, and sends each to every target until the end."""
    ended = threading.Event()
    couriers = [_Courier(target, ended) for target in targets]
    try:
        yield Notifier(site, couriers)
    finally:
        ended.set()
        until = time.monotonic() + TIMEOUT_S
        for courier in couriers:
            courier.end(until)


class _Courier:
    """Delivers to one target in a thread of its own: one that hangs holds up no other."""

    def __init__(self, target: Target, ended: threading.Event) -> None:
        self._target, self._ended = target, ended
        self._waiting: queue.Queue[dict[str, Any] | None] = queue.Queue(MOST_WAITING)
        self._attempt: threading.Thread | None = None
        self._thread = threading.Thread(target=self._work, name="vppres-notify", daemon=True)
        self._thread.start()
        self.name = target.name
        self.failed = False

    @property
    def alive(self) -> bool:
        """Whether it still delivers."""
        return self._thread.is_alive()

    def take(self, message: dict[str, Any]) -> None:
        try:
            self._waiting.put_nowait(message)
        except queue.Full:
            self.failed = True
            log.error("notice dropped: %d wait to be sent", MOST_WAITING)

    def end(self, until: float) -> None:
        """Send what waits, until a time of the monotonic clock."""
        try:
            self._waiting.put(None, timeout=max(until - time.monotonic(), 0.0))
        except queue.Full:
            log.error("notices dropped at the end")
        self._thread.join(max(until - time.monotonic(), 0.0))

    def _work(self) -> None:
        while (message := self._waiting.get()) is not None:
            self._deliver(message)

    def _deliver(self, message: dict[str, Any]) -> None:
        """Send a message, again if that fails; after the end without a wait."""
        for wait_s in ATTEMPTS_AFTER_S:
            self._ended.wait(wait_s)
            failure = self._failure(message)
            if failure is None:
                self.failed = False
                return
            log.warning("notice not sent to %s: %s", self._target.name, type(failure).__name__)
        self.failed = True
        log.error("notice given up for %s", self._target.name)

    def _failure(self, message: dict[str, Any]) -> Exception | None:
        """Send once, within the limit; what went wrong, or None."""
        # An attempt that hangs is left to itself, and none begins beside it: one thread at most.
        if self._attempt is not None and self._attempt.is_alive():
            return TimeoutError()
        results: list[Exception | None] = []

        def attempt() -> None:
            try:
                self._target.send(message)
                results.append(None)
            # Whatever a server answers ends the attempt, never the courier.
            except Exception as error:
                results.append(error)

        self._attempt = threading.Thread(target=attempt, name="vppres-notice", daemon=True)
        self._attempt.start()
        self._attempt.join(DELIVERY_S)
        return results[0] if results else TimeoutError()


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """A redirect is no delivery: the notice would be lost in a GET."""

    def redirect_request(self, *_: Any) -> None:
        return None


def _webhook(parts: SplitResult) -> Send:
    """Posts JSON; a name and password in the address are those of HTTP."""
    opener = urllib.request.build_opener(_NoRedirect)
    address = parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()
    own = {"Content-Type": "application/json"}
    if parts.username is not None:
        pair = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        own["Authorization"] = f"Basic {base64.b64encode(pair.encode()).decode()}"

    def send(message: dict[str, Any]) -> None:
        body = json.dumps(message).encode()
        request = urllib.request.Request(address, body, own, method="POST")
        try:
            with opener.open(request, timeout=TIMEOUT_S) as answer:
                answer.read(0)
        except urllib.error.HTTPError as error:
            error.close()
            raise

    return send


def _mail(parts: SplitResult) -> Send:
    """Sends a mail; a password only over TLS."""
    to = unquote(parts.path.strip("/"))
    sender = parse_qs(parts.query).get("from", [to])[0]
    host, port = str(parts.hostname), parts.port or SMTP_PORTS[parts.scheme]
    user, password = parts.username, os.environ.get(SMTP_PASSWORD)

    def send(message: dict[str, Any]) -> None:
        mail = EmailMessage()
        mail["From"], mail["To"] = sender, to
        mail["Date"] = localtime()
        mail["Message-ID"] = make_msgid(domain=host)
        mail["Subject"] = visible(message["text"].splitlines()[0])
        mail.set_content(message["text"])
        context = ssl.create_default_context()
        if parts.scheme == "smtps":
            server: smtplib.SMTP = smtplib.SMTP_SSL(host, port, timeout=TIMEOUT_S, context=context)
        else:
            server = smtplib.SMTP(host, port, timeout=TIMEOUT_S)
        with server:
            server.ehlo()
            if parts.scheme == "smtp" and (server.has_extn("starttls") or password):
                server.starttls(context=context)
            if user and password:
                server.login(unquote(user), password)
            server.send_message(mail)

    return send
