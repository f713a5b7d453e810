"""The tests under every supported Python, and a trial of a release; Pythons of PATH or pyenv."""

import os
import shutil
from pathlib import Path

import nox

VERSIONS = ("3.10", "3.11", "3.12", "3.13")
DIST = Path("dist").resolve()
# What `e3pose[all]` has to be had for, as wheels, beside the machine that runs this.
PLATFORMS = (
    "aarch64-manylinux_2_28", "x86_64-manylinux_2_28", "aarch64-apple-darwin",
    "x86_64-apple-darwin", "x86_64-pc-windows-msvc",
)  # fmt: skip
TESTED = ("base/test_table.py", "model", "select", "wire", "recording", "output/exports")
BESIDE = (
    *("tests", "docs", "examples", "README.md", "house.toml", "pyproject.toml"),
    *("hub/pyproject.toml", "lab/pyproject.toml", "lab/benchmarks"),
)
# Tests that read the sources, or need what builds the pages.
OF_SOURCES = (
    *("recording/test_recording_format_doc.py", "wire/test_codec.py"),
    "wire/test_messages_doc.py",
)
FILMS = "--people 1 --cameras 3 --seconds 4 --fps 12.5 --resolution 640x480 --seed 701 --videos"
nox.options.sessions = ["tests"]


def interpreter(version: str) -> str | None:
    """Find a Python that really runs: a pyenv shim of a version that is not active only says no."""
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = sorted(versions.glob(f"{version}.*/bin/python"))
    return str(found[-1]) if found else shutil.which(f"python{version}")


def environment(session: nox.Session, version: str, folder: Path) -> str:
    """Make an empty environment; return its Python."""
    found = interpreter(version)
    if found is None:
        session.skip(f"no Python {version} on PATH or in pyenv")
    session.run(found, "-m", "venv", "--clear", str(folder), external=True)
    return str(folder / "bin" / "python")


@nox.session(python=False)
@nox.parametrize("version", VERSIONS)
def tests(session: nox.Session, version: str) -> None:
    """Install the package and run all tests; what follows `--` goes to pytest."""
    folder = Path(session.cache_dir).parent / f"python-{version}"
    python = str(folder / "bin" / "python")
    installed = folder / "installed"  # with the requirements of that time
    project = Path("pyproject.toml")
    if not (installed.exists() and installed.read_bytes() == project.read_bytes()):
        environment(session, version, folder)
        parts = ("-e", ".[dev]", "-e", "hub", "-e", "lab")
        session.run(python, "-m", "pip", "install", "--quiet", *parts, external=True)
        installed.write_bytes(project.read_bytes())
    session.run(python, "-m", "pytest", "-q", *session.posargs, external=True)


@nox.session(python=False)
def platforms(session: nox.Session) -> None:
    """Resolve what `make dist` built, by name, for other systems: all of it as wheels."""
    folder = Path(session.create_tmp()).resolve()
    asked = folder / "asked.in"
    asked.write_text("e3pose[all]\ne3pose-hub\ne3pose-lab\n")
    for platform in PLATFORMS:
        for version in (VERSIONS[0], VERSIONS[-1]):
            session.run(
                *("uv", "pip", "compile", "--quiet", "--no-header", "--only-binary", ":all:"),
                *("--find-links", str(DIST), "--python-platform", platform),
                *(
                    "--python-version",
                    version,
                    "--output-file",
                    str(folder / "found.txt"),
                    str(asked),
                ),
                external=True,
            )


@nox.session(python=False)
@nox.parametrize("version", VERSIONS)
def release(session: nox.Session, version: str) -> None:
    """Install what `make dist` built, by name, and use it in an empty folder; sdists too."""
    folder = Path(session.create_tmp()).resolve() / version
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    python = environment(session, version, folder / "venv")
    program, project = str(folder / "venv/bin/e3pose"), Path.cwd()
    alone = {"E3POSE_SHARED": "", "PYTHONPATH": "", "NUMBA_CACHE_DIR": str(folder / "compiled")}

    def run(*words: str) -> None:
        session.run(*words, external=True, env=alone)

    def install(*words: str) -> None:
        run(python, "-m", "pip", "install", "--quiet", "--find-links", str(DIST), *words)

    sources = sorted(map(str, DIST.glob("*.tar.gz")))
    run(python, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(folder / "again"), *sources)
    assert {path.name for path in (folder / "again").iterdir()} == {
        path.name for path in DIST.glob("*.whl")
    }
    install("e3pose[all]", "e3pose-hub", "e3pose-lab")
    with session.chdir(folder):
        run(program, "--version")
        run(program, "demo")
        run(program, "simulate", "films", *FILMS.split())
        films = [f"films/videos/cam{number}.mp4" for number in range(3)]
        known = ("--calibration", "films/calibration.toml", "--model", "drawn", "--out", "walk3d")
        run(program, "reconstruct", *films, *known)
        install("e3pose[hdf5]", "ezc3d", "hypothesis", "pygltflib", "pytest", "pytest-timeout")
        for name in BESIDE:  # what tests read, without the packages
            Path(name).parent.mkdir(parents=True, exist_ok=True)
            copy = shutil.copytree if (project / name).is_dir() else shutil.copy
            copy(project / name, name)
        chosen = [f"tests/{name}" for name in TESTED]
        chosen += [f"--ignore=tests/{name}" for name in OF_SOURCES]
        run(python, "-m", "pytest", "-q", "-m", "not slow and not shared and not nightly", *chosen)
