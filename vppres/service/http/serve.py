"""Puts the parts of a service together, and runs it until it is stopped."""

from __future__ import annotations

import errno
import socket
import ssl
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from vppres.core.errors import InputError
from vppres.io.messages import did_you_mean
from vppres.model.site import Site
from vppres.service.access import LOOPBACK, Access, new_token
from vppres.service.alarms.notify import notifier, target_of
from vppres.service.clock import SetClock, SystemClock, TimeSource
from vppres.service.http.app import make_app
from vppres.service.http.connections import MOST_AT_ONCE, Connection
from vppres.service.operation.loop import Loop
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service
from vppres.service.storage.store import Store

DEFAULT_PORT = 8420
GRACE_S = 10
"""What requests may take to end after the service was stopped."""


@dataclass(frozen=True)
class Address:
    """Address at which a service listens, with TLS by itself or by a proxy in front.

    ``names`` are further ones under which it is called, as a proxy passes them on.
    """

    host: str = LOOPBACK[0]
    port: int = DEFAULT_PORT
    behind_proxy: bool = False
    names: tuple[str, ...] = ()
    certificate: Path | None = None
    key: Path | None = None

    @property
    def encrypts(self) -> bool:
        """Whether it does TLS itself."""
        return bool(self.certificate)

    @property
    def url(self) -> str:
        """As a browser writes it."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http{'s' if self.encrypts else ''}://{host}:{self.port}"

    @contextmanager
    def listening(self) -> Iterator[socket.socket]:
        """A socket that listens there, closed in the end.

        Raises
        ------
        InputError
            If it cannot, for example because another program does.
        """
        kind = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        with socket.socket(kind) as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                sock.bind((self.host, self.port))
                sock.listen()
            except OSError as error:
                cure = "Give another --port, or end the program that uses it."
                if error.errno != errno.EADDRINUSE:
                    cure = "Give an address of this machine with --host, and a port that is open."
                message = f"cannot be listened on: {error.strerror or error}"
                where = f"{self.host}:{self.port}"
                raise InputError.of("options", message, cure, field="port", value=where) from error
            yield sock

    def check(self, access: Access) -> None:
        """Refuse what would be open to strangers, and files that are no certificate and its key.

        Raises
        ------
        InputError
            With the cure.
        """
        needs = []
        if not access.tokens:
            needs.append("a token (--add-token NAME:SCOPES)")
        if not (self.behind_proxy or self.encrypts):
            needs.append("TLS (--certificate and --key), or a proxy in front (--behind-proxy)")
        if needs and self.host not in LOOPBACK:
            raise InputError.of(
                "options",
                "is an address for other machines",
                f"It needs {' and '.join(needs)}; 127.0.0.1 needs neither.",
                field="host",
                value=self.host,
            )
        if bool(self.certificate) != bool(self.key):
            given, missing = ("certificate", "key") if self.encrypts else ("key", "certificate")
            raise InputError.of("options", f"needs --{missing}", "Give both files.", field=given)
        if self.certificate and self.key:
            try:
                ssl.create_default_context().load_cert_chain(
                    self.certificate, self.key, _no_password
                )
            except (OSError, ValueError) as error:
                raise InputError.of(
                    "options",
                    f"is no certificate with its key: {error}",
                    "Give PEM files, the key without a password.",
                    field="certificate",
                    value=str(self.certificate),
                ) from error


def _no_password() -> str:
    """No user is there to be asked."""
    raise ValueError("the key has a password")


@contextmanager
def opened(
    service: Service, folder: Path | str, clock: TimeSource | None = None
) -> Iterator[Runner]:
    """A runner with its store, a folder or a PostgreSQL address, closed in the end."""
    if not clock:
        played = service.rehearsal or service.paced
        clock = SetClock(service.scenario.grid.start) if played else SystemClock()
    profile = service.profile  # a site without a whole day leaves no state behind
    with (
        closing(Store(folder, Site.of(service.scenario).key)) as store,
        closing(Runner(service, store, clock, profile)) as runner,
    ):
        yield runner


def add_token(service: Service, folder: Path | str, text: str, days: float | None = None) -> str:
    """Add a token, for some days or for good; the secret, which is shown once.

    Raises
    ------
    InputError
        If the text is no name with scopes, or the service runs.
    """
    secret, token = new_token(text, days)
    with closing(Store(folder, Site.of(service.scenario).key)) as store:
        store.add_token(token, SystemClock().now())
    return secret


def remove_token(service: Service, folder: Path | str, name: str) -> None:
    """Remove a token.

    Raises
    ------
    InputError
        If there is no such token, or the service runs.
    """
    with closing(Store(folder, Site.of(service.scenario).key)) as store:
        if not store.remove_token(name, SystemClock().now()):
            known = [token.name for token in store.tokens()]
            cure = did_you_mean(name, known, "There is none.")
            raise InputError.of(
                "tokens", "is not the name of a token", cure, field="name", value=name
            )


def serve(
    service: Service,
    folder: Path | str,
    address: Address,
    told: Callable[[str], None],
    notify: Sequence[str] = (),
) -> None:
    """Serve until SIGINT or SIGTERM.

    Raises
    ------
    InputError
        If another program listens there or serves from the folder, or the address needs what is
        not there.
    """
    targets = [target_of(text) for text in notify]
    with (
        address.listening() as sock,
        opened(service, folder) as runner,
        notifier(service.scenario.name, targets) as tell,
    ):
        runner.watch.alarms.on_notice = tell
        runner.watch.notifier = tell
        access = Access(runner.store.tokens())
        address.check(access)
        hosts = (*LOOPBACK, address.host, *address.names)
        app = make_app(runner, access, hosts, address.encrypts)
        config = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            server_header=False,
            proxy_headers=False,  # nothing depends on an address, which any sender can make up
            http=Connection,
            ssl_certfile=address.certificate,
            ssl_keyfile=address.key,
            limit_concurrency=MOST_AT_ONCE,
            ws="none",
            timeout_graceful_shutdown=GRACE_S,
        )
        told(f"Serving {service.scenario.name} at {address.url}, state in {runner.store.place}.")
        loop = None if runner.rehearsal else Loop(runner)
        if loop:
            loop.start()
        try:
            uvicorn.Server(config).run([sock])
        except KeyboardInterrupt:  # it has ended by then
            pass
        finally:
            if loop:
                loop.end()
