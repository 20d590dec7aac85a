"""Notices of alarms reach a webhook and a mail server, and hold up nothing if they do not."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Iterator
from email.message import EmailMessage
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest

from vppres.core.errors import InputError
from vppres.service import notify
from vppres.service.alarms import Notice
from vppres.service.notify import Target, message_of, notifier, target_of

ALARM = {"priority": "high", "text": "h1 of the first tier off supply.", "advice": "Go and look."}
NOTICE = Notice("raised", [ALARM])
TEXT = "my-feeder: alarm raised\n[high] h1 of the first tier off supply. Go and look."


@pytest.fixture
def hook() -> Iterator[tuple[str, list[Any]]]:
    """A server that takes what is posted."""
    posted: list[Any] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            posted.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/secret", posted
    server.shutdown()
    server.server_close()


def test_a_webhook_gets_each_notice(hook: tuple[str, list[Any]]) -> None:
    address, posted = hook
    with notifier("my-feeder", [target_of(address)]) as take:
        take(NOTICE)
        take(Notice("cleared", [ALARM]))
    assert posted[0] == {"site": "my-feeder", "what": "raised", "text": TEXT, "alarms": [ALARM]}
    assert posted[1]["text"] == "my-feeder: alarm cleared\n[high] h1 of the first tier off supply."


class Server:
    """A mail server that remembers."""

    said: list[Any]

    def __init__(self, host: str, port: int, **_: Any) -> None:
        Server.said = [(host, port)]

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def ehlo(self) -> None:
        pass

    def has_extn(self, _: str) -> bool:
        return False

    def starttls(self, **_: Any) -> None:
        Server.said.append("tls")

    def login(self, user: str, password: str) -> None:
        Server.said.append((user, password))

    def send_message(self, mail: EmailMessage) -> None:
        assert mail["Date"] and mail["Message-ID"]
        Server.said.append((mail["From"], mail["To"], mail["Subject"], mail.get_content().strip()))


@pytest.mark.parametrize("password", [None, "secret"])
def test_mail_goes_out_with_a_password_only_over_tls(
    monkeypatch: pytest.MonkeyPatch, password: str | None
) -> None:
    monkeypatch.setattr(notify.smtplib, "SMTP", Server)
    monkeypatch.delenv(notify.SMTP_PASSWORD, raising=False)
    if password is not None:
        monkeypatch.setenv(notify.SMTP_PASSWORD, password)
    target = target_of("smtp://vpp@mail.example:587/ops@example.com?from=vpp@example.com")
    target.send(message_of("my-feeder", NOTICE))
    mail = ("vpp@example.com", "ops@example.com", "my-feeder: alarm raised", TEXT)
    login = [] if password is None else ["tls", ("vpp", password)]
    assert Server.said == [("mail.example", 587), *login, mail]


def test_what_cannot_be_sent_is_tried_again_and_logged_without_its_address(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(notify, "ATTEMPTS_AFTER_S", (0.0, 0.0, 0.0))
    tried: list[Any] = []

    def fail(message: dict[str, Any]) -> None:
        tried.append(message)
        raise ConnectionRefusedError("https://hooks.example/secret")

    with caplog.at_level(logging.WARNING), notifier("s", [Target("hooks.example", fail)]) as take:
        take(NOTICE)
    assert len(tried) == 3
    assert "notice given up for hooks.example" in caplog.text and "secret" not in caplog.text


@pytest.mark.parametrize("text", ["ftp://host/x", "ops@example.com", "smtp://mail/", "https://"])
def test_an_address_that_is_none(text: str) -> None:
    with pytest.raises(InputError, match="is no address of a webhook or for mail") as found:
        target_of(text)
    assert "Write https://HOST/PATH, or smtp://" in str(found.value)
