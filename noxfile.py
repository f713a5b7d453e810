"""The tests under every supported Python; interpreters come from PATH or pyenv."""

import os
import shutil
from pathlib import Path

import nox

VERSIONS = ("3.10", "3.11", "3.12", "3.13")
nox.options.sessions = ["tests"]


def interpreter(version: str) -> str | None:
    """Find a Python that really runs: a pyenv shim of a version that is not active only says no."""
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = sorted(versions.glob(f"{version}.*/bin/python"))
    return str(found[-1]) if found else shutil.which(f"python{version}")


@nox.session(python=False)
@nox.parametrize("version", VERSIONS)
def tests(session: nox.Session, version: str) -> None:
    """Install the package and run all tests; what follows `--` goes to pytest."""
    environment = Path(session.cache_dir).parent / f"python-{version}"
    python = environment / "bin" / "python"
    installed = environment / "installed"  # with the requirements of that time
    project = Path("pyproject.toml")
    if not (installed.exists() and installed.read_bytes() == project.read_bytes()):
        found = interpreter(version)
        if found is None:
            session.skip(f"no Python {version} on PATH or in pyenv")
        session.run(found, "-m", "venv", "--clear", str(environment), external=True)
        parts = ("-e", ".[dev]", "-e", "hub", "-e", "lab")
        session.run(str(python), "-m", "pip", "install", "--quiet", *parts, external=True)
        installed.write_bytes(project.read_bytes())
    session.run(str(python), "-m", "pytest", "-q", *session.posargs, external=True)
