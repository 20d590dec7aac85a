"""A PostgreSQL server of the system's packages, for the tests alone."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

from tests.support.browser import free_port

START_S = 30.0


def missing() -> str:
    """Why no server can be started here; empty if one can."""
    if find_spec("psycopg") is None:
        return "the package psycopg is not installed"
    if programs() is None:
        return "PostgreSQL's server is not installed"
    if os.geteuid() == 0 and (user() is None or shutil.which("setpriv") is None):
        return "a server must not be run as root, and there is nobody else to run it as"
    return ""


def programs() -> Path | None:
    """Folder of initdb and postgres, of the newest version."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    here = shutil.which("initdb")
    if found:
        return found[-1].parent
    return None if here is None else Path(here).resolve().parent


def user() -> pwd.struct_passwd | None:
    """Whoever may run it where we are root."""
    for name in ("postgres", "nobody"):
        try:
            return pwd.getpwnam(name)
        except KeyError:
            continue
    return None


class Server:
    """A server that can be stopped and started again, with its data."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="vppres-postgres-"))
        self._as: list[str] = []
        other = user()
        if os.geteuid() == 0 and other is not None:
            os.chown(self.folder, other.pw_uid, other.pw_gid)
            ids = [f"--reuid={other.pw_uid}", f"--regid={other.pw_gid}", "--clear-groups"]
            self._as = ["setpriv", *ids]
        self.port = free_port()
        self._run("initdb", "-D", str(self.folder / "data"), "-A", "trust", "-U", "vppres", "-N")
        self._process: subprocess.Popen[bytes] | None = None
        self._databases = 0
        self.start()

    def start(self) -> None:
        """Start it, and wait until it answers."""
        place = str(self.folder / "data")
        options = ["-c", "listen_addresses=127.0.0.1", "-k", str(self.folder)]
        command = [*self._command("postgres"), "-D", place, "-p", str(self.port), *options]
        with (self.folder / "log").open("ab") as log:
            self._process = subprocess.Popen(command, stdout=log, stderr=log, cwd="/")
        end = time.monotonic() + START_S
        while self._asked("SELECT 1").returncode != 0:
            if time.monotonic() > end:
                raise RuntimeError((self.folder / "log").read_text())
            time.sleep(0.05)

    def stop(self) -> None:
        """Stop it at once, as a crash does."""
        self._process.send_signal(signal.SIGQUIT)
        self._process.wait()

    def close(self) -> None:
        """Stop it for good."""
        self.stop()
        shutil.rmtree(self.folder)

    def new_database(self) -> str:
        """Address of an empty database."""
        self._databases += 1
        name = f"site{self._databases}"
        done = self._asked(f"CREATE DATABASE {name}")
        assert done.returncode == 0, done.stderr
        return f"postgresql://vppres@127.0.0.1:{self.port}/{name}"

    def _asked(self, statement: str) -> subprocess.CompletedProcess[bytes]:
        options = ["-h", "127.0.0.1", "-p", str(self.port), "-U", "vppres", "-c", statement]
        psql = shutil.which("psql") or str(programs() / "psql")  # type: ignore[operator]
        return subprocess.run([psql, "-q", *options, "postgres"], capture_output=True, check=False)

    def _command(self, program: str) -> list[str]:
        folder = programs()
        assert folder is not None
        return [*self._as, str(folder / program)]

    def _run(self, program: str, *arguments: str) -> None:
        done = subprocess.run(
            [*self._command(program), *arguments], capture_output=True, cwd="/", check=False
        )
        if done.returncode:
            raise RuntimeError(done.stderr.decode())
