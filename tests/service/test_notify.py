"""Notices of alarms reach a webhook and a mail server, and hold up nothing if they do not."""

from __future__ import annotations

import json
import logging
import queue
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
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


ODD_ANSWERS = {
    "of another protocol": b"SSH-2.0-OpenSSH_9.2\r\n",
    "with a status that is no number": b"HTTP/1.1 ok fine\r\n\r\n",
    "of a redirect": b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:9/\r\n\r\n",
    "of nothing": b"",
}


@pytest.mark.parametrize("answer", ODD_ANSWERS.values(), ids=ODD_ANSWERS)
def test_an_odd_answer_of_one_webhook_keeps_no_notice_from_another(
    answer: bytes,
    hook: tuple[str, list[Any]],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(notify, "ATTEMPTS_AFTER_S", (0.0, 0.0))
    odd = socket.create_server(("127.0.0.1", 0))

    def talk() -> None:
        for _ in range(4):
            with suppress(OSError), odd.accept()[0] as other:
                other.recv(65536)
                other.sendall(answer)

    threading.Thread(target=talk, daemon=True).start()
    address, posted = hook
    targets = [target_of(f"http://127.0.0.1:{odd.getsockname()[1]}/"), target_of(address)]
    with notifier("my-feeder", targets) as take, caplog.at_level(logging.ERROR):
        take(NOTICE)
        take(Notice("cleared", [ALARM]))
    odd.close()
    assert [one["what"] for one in posted] == ["raised", "cleared"]
    assert caplog.text.count("notice given up for 127.0.0.1") == 2


def test_a_webhook_that_never_ends_its_answer_holds_up_no_other(
    hook: tuple[str, list[Any]], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(notify, "ATTEMPTS_AFTER_S", (0.0,))
    monkeypatch.setattr(notify, "DELIVERY_S", 0.1)
    hangs = threading.Event()
    address, posted = hook
    with notifier(
        "my-feeder", [Target("slow", lambda _: hangs.wait() and None), target_of(address)]
    ) as take:
        take(NOTICE)
        take(NOTICE)
    hangs.set()
    assert len(posted) == 2
    assert caplog.text.count("notice given up for slow") == 2


@pytest.mark.parametrize(
    "text", ["http://[::1", "https://host/a b", "https://host:port/x", "http://h\n/"]
)
def test_an_address_that_cannot_be_one_is_refused_at_the_start(text: str) -> None:
    with pytest.raises(InputError, match="is no address of a webhook or for mail"):
        target_of(text)


def test_a_target_that_no_notice_reaches_is_named_until_one_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(notify, "ATTEMPTS_AFTER_S", (0.0,))
    broken = threading.Event()
    broken.set()
    sent: queue.Queue[str] = queue.Queue()

    def send(_: dict[str, Any]) -> None:
        sent.put("")
        if broken.is_set():
            raise ValueError("no HTTP")

    with notifier("s", [Target("one", send), Target("two", lambda _: None)]) as take:
        for unreached in (["one"], []):
            take(NOTICE)
            sent.get(timeout=5.0)
            begin = time.monotonic()
            while take.unreached() != unreached and time.monotonic() < begin + 5.0:
                time.sleep(0.01)
            assert take.unreached() == unreached and take.alive()
            broken.clear()
    assert take.unreached() == ["one", "two"] and not take.alive()
