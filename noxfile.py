"""The tests under every supported Python; interpreters come from PATH or pyenv."""

import os
import shutil
from pathlib import Path

import nox

VERSIONS = ("3.10", "3.11", "3.12", "3.13")
nox.options.reuse_existing_virtualenvs = True
nox.options.sessions = ["tests"]


def interpreter(version: str) -> str:
    """Find a Python that really runs: a pyenv shim of a version that is not active only says no."""
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = sorted(versions.glob(f"{version}.*/bin/python"))
    return str(found[-1]) if found else shutil.which(f"python{version}") or version


@nox.session(python=False)
@nox.parametrize("version", VERSIONS)
def tests(session: nox.Session, version: str) -> None:
    """Install the package as a user would and run all tests."""
    environment = Path(session.cache_dir) / f"python-{version}"
    python = environment / "bin" / "python"
    if not python.exists():
        session.run(interpreter(version), "-m", "venv", str(environment), external=True)
    session.run(str(python), "-m", "pip", "install", "--quiet", "-e", ".[dev]", external=True)
    session.run(str(python), "-m", "pytest", "-q", *session.posargs, external=True)
