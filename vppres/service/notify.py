"""Tells people of alarms: webhooks and mail, in a thread of its own that holds up no step."""

from __future__ import annotations

import json
import logging
import os
import queue
import smtplib
import ssl
import threading
import urllib.request
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from email.message import EmailMessage
from email.utils import localtime, make_msgid
from typing import Any
from urllib.parse import SplitResult, parse_qs, unquote, urlsplit

from vppres.core.errors import InputError
from vppres.core.text import visible
from vppres.service.alarms import Notice

TIMEOUT_S = 10.0
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
    """Where notices go; its name, the host, is all that the log says of it."""

    name: str
    send: Send


def target_of(text: str) -> Target:
    """A target: ``https://HOST/PATH`` or, for mail, ``smtp://USER@HOST:PORT/TO?from=FROM``.

    Raises
    ------
    InputError
        If it is neither.
    """
    parts = urlsplit(text)
    kinds: dict[str, Callable[[SplitResult], Send]] = {
        "http": _webhook,
        "https": _webhook,
        "smtp": _mail,
        "smtps": _mail,
    }
    mail = parts.scheme in SMTP_PORTS
    if parts.scheme not in kinds or not parts.hostname or (mail and "@" not in parts.path):
        cure = "Write https://HOST/PATH, or smtp://USER@HOST:PORT/TO?from=FROM."
        shown = f"{parts.scheme}://{parts.hostname or ''}"
        raise InputError.of(
            "options", "is no address of a webhook or for mail", cure, field="notify", value=shown
        )
    return Target(parts.hostname, kinds[parts.scheme](parts))


def message_of(site: str, notice: Notice) -> dict[str, Any]:
    """A notice as it is sent; ``text`` is what chat servers show."""
    lines = [f"{site}: alarm {notice.what}"]
    for one in notice.alarms:
        advice = "" if notice.what == "cleared" else f" {one['advice']}"
        lines.append(f"[{one['priority']}] {one['text']}{advice}")
    return {"site": site, "what": notice.what, "text": "\n".join(lines), "alarms": notice.alarms}


@contextmanager
def notifier(site: str, targets: Iterable[Target]) -> Iterator[Callable[[Notice], None]]:
    """Something that takes notices, and sends each to all targets until the end."""
    waiting: queue.Queue[dict[str, Any] | None] = queue.Queue(MOST_WAITING)
    ended = threading.Event()

    def work() -> None:
        while (message := waiting.get()) is not None:
            for target in every:
                _deliver(target, message, ended)

    def take(notice: Notice) -> None:
        try:
            waiting.put_nowait(message_of(site, notice))
        except queue.Full:
            log.error("notice dropped: %d wait to be sent", MOST_WAITING)

    every = list(targets)
    thread = threading.Thread(target=work, name="vppres-notify", daemon=True)
    thread.start()
    try:
        yield take
    finally:
        ended.set()
        try:
            waiting.put(None, timeout=TIMEOUT_S)
        except queue.Full:
            log.error("notices dropped at the end")
        thread.join(TIMEOUT_S)


def _deliver(target: Target, message: dict[str, Any], ended: threading.Event) -> None:
    """Send a message, again if that fails; after the end without a wait."""
    for wait_s in ATTEMPTS_AFTER_S:
        ended.wait(wait_s)
        try:
            target.send(message)
            return
        except (OSError, smtplib.SMTPException) as error:
            log.warning("notice not sent to %s: %s", target.name, type(error).__name__)
    log.error("notice given up for %s", target.name)


def _webhook(parts: SplitResult) -> Send:
    """Posts JSON."""

    def send(message: dict[str, Any]) -> None:
        body = json.dumps(message).encode()
        headers = {"Content-Type": "application/json"}
        request = urllib.request.Request(parts.geturl(), body, headers, method="POST")
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
            answer.read(0)

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
