"""Notices of alarms reach a webhook and a mail server, and hold up nothing if they do not."""

from __future__ import annotations

import base64
import json
import logging
import queue
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from email.message import EmailMessage
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest

from vppres.core.errors import InputError
from vppres.service.alarms import notify
from vppres.service.alarms.notify import Target, message_of, notifier, target_of
from vppres.service.alarms.state import Notice

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


@pytest.mark.parametrize(
    "text",
    ["ftp://host/x", "ops@example.com", "smtp://mail/", "https://", "http://[::1", "https://host/a b",
     "https://host:port/x", "http://h\n/", "https://host/\u00fc"],
)  # fmt: skip
def test_an_address_that_is_none(text: str) -> None:
    with pytest.raises(InputError, match="is no address of a webhook or for mail") as found:
        target_of(text)
    assert "Write https://HOST/PATH, or smtp://" in str(found.value)


OK = b"HTTP/1.1 200 OK\r\n"
ODD_ANSWERS = {
    "of another protocol": b"SSH-2.0-OpenSSH_9.2\r\n",
    "with a status that is no number": b"HTTP/1.1 ok fine\r\n\r\n",
    "with a status beyond all": b"HTTP/1.1 99999 OK\r\n\r\n",
    "with a status below all": b"HTTP/1.1 0 OK\r\n\r\n",
    "of a redirect": b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:9/\r\n\r\n",
    "moved for good": b"HTTP/1.1 301 Moved\r\nLocation: /\r\n\r\n",
    "see other": b"HTTP/1.1 303 See\r\nLocation: http://127.0.0.1:9/\r\n\r\n",
    "moved, with its method": b"HTTP/1.1 308 Moved\r\nLocation: file:///etc/passwd\r\n\r\n",
    "redirected to nowhere": b"HTTP/1.1 307 Moved\r\n\r\n",
    "of nothing": b"",
    "of a server's mistake": b"HTTP/1.1 500 No\r\n\r\n",
    "for later": b"HTTP/1.1 503 No\r\nRetry-After: 999999999\r\n\r\n",
    "that there is nothing": b"HTTP/1.1 404 No\r\nContent-Length: -5\r\n\r\n",
    "who are you": b'HTTP/1.1 401 No\r\nWWW-Authenticate: Basic realm="\xff"\r\n\r\n',
    "of a proxy": b"HTTP/1.1 407 No\r\n\r\n",
    "to go on, again and again": b"HTTP/1.1 100 Continue\r\n\r\n" * 5000,
    "of another protocol, asked for": b"HTTP/1.1 101 Switching\r\nUpgrade: x\r\n\r\n",
    "of a long line": OK + b"X: " + b"a" * 100_000 + b"\r\n\r\n",
    "of many lines": OK + b"X: a\r\n" * 1000 + b"\r\n",
    "of TLS": b"\x15\x03\x01\x00\x02\x02\x28",
    "of zeros": b"\0" * 5000,
    "without a head": b"<html>hello</html>",
    "of half a head": b"HTTP/1.1 20",
    "of a mail server": b"220 mail ESMTP\r\n",
}


Talk = Callable[[socket.socket], object]


def told_beside(text: str, talk: Talk, posted_at: str) -> list[bool]:
    """Send two notices to a server that talks so and to another; whether each target failed."""
    odd = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with suppress(OSError):
            while True:
                with odd.accept()[0] as other, suppress(OSError):
                    talk(other)

    threading.Thread(target=serve, daemon=True).start()
    targets = [target_of(text.format(odd.getsockname()[1])), target_of(posted_at)]
    with notifier("my-feeder", targets) as take:
        take(NOTICE)
        take(Notice("cleared", [ALARM]))
    odd.close()
    return [courier.failed for courier in take._couriers]


@pytest.mark.parametrize("answer", ODD_ANSWERS.values(), ids=ODD_ANSWERS)
def test_an_odd_answer_of_one_webhook_keeps_no_notice_from_another(
    answer: bytes,
    hook: tuple[str, list[Any]],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(notify, "ATTEMPTS_AFTER_S", (0.0, 0.0))
    address, posted = hook
    with caplog.at_level(logging.ERROR):
        told_beside("http://127.0.0.1:{}/", lambda o: (o.recv(65536), o.sendall(answer)), address)
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
            sent.get(timeout=60.0)
            begin = time.monotonic()
            while take.unreached() != unreached and time.monotonic() < begin + 60.0:
                time.sleep(0.01)
            assert take.unreached() == unreached and take.alive()
            broken.clear()
    assert take.unreached() == ["one", "two"] and not take.alive()


def _never(other: socket.socket) -> None:
    other.recv(1)


def _drips(other: socket.socket) -> None:
    for _ in range(1000):
        other.sendall(b"H")
        time.sleep(0.02)


def _resets(other: socket.socket) -> None:
    other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


TALKS: dict[str, tuple[str, Talk]] = {
    "a mail server that never speaks": ("smtp://127.0.0.1:{}/ops@example.com", _never),
    "a mail server that drips": ("smtp://127.0.0.1:{}/ops@example.com", _drips),
    "a mail server that resets": ("smtp://127.0.0.1:{}/ops@example.com", _resets),
    "a mail server of TLS that is none": ("smtps://127.0.0.1:{}/ops@example.com", _drips),
    "a hook that never answers": ("http://127.0.0.1:{}/", _never),
    "a hook that drips": ("http://127.0.0.1:{}/", _drips),
    "a hook that resets": ("http://127.0.0.1:{}/", _resets),
    "a hook of TLS that is none": ("https://127.0.0.1:{}/", _drips),
    "by a name that is none": ("http://nobody.invalid:{}/", _never),
    "by a name with an empty part": ("http://a..b:{}/", _never),
    "by a name that is too long": ("http://" + "a" * 70 + ":{}/", _never),
    "at port 0": ("http://127.0.0.1:0/{}", _never),
    "at an address of a network that is none": ("http://[fe80::1%25none]:{}/", _never),
}


@pytest.mark.parametrize(("text", "talk"), TALKS.values(), ids=TALKS)
def test_a_target_that_hangs_or_is_nowhere_keeps_no_notice_from_another(
    text: str, talk: Talk, hook: tuple[str, list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notify, "ATTEMPTS_AFTER_S", (0.0,))
    monkeypatch.setattr(notify, "DELIVERY_S", 0.3)
    address, posted = hook
    assert told_beside(text, talk, address) == [True, False]
    assert [one["what"] for one in posted] == ["raised", "cleared"]


def test_a_name_and_a_password_in_an_address_are_those_of_http(
    hook: tuple[str, list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The host was looked up with them before, and nothing arrived."""
    heads: list[str | None] = []
    parse = BaseHTTPRequestHandler.parse_request

    def noted(self: BaseHTTPRequestHandler) -> bool:
        found = parse(self)
        heads.append(self.headers["Authorization"])
        return found

    monkeypatch.setattr(BaseHTTPRequestHandler, "parse_request", noted)
    address, posted = hook
    with notifier("s", [target_of(address.replace("://", "://vpp:a%40b@"))]) as take:
        take(NOTICE)
    assert len(posted) == 1
    assert heads == ["Basic " + base64.b64encode(b"vpp:a@b").decode()]
