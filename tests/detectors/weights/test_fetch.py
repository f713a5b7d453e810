"""Downloads arrive whole and right, or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.detectors.weights.web import CONTENT, SHA256, Site, dead_url, files_in

from e3pose.base.errors import InputError
from e3pose.detectors.weights import (
    fetch_file,
)


def test_a_good_download_arrives(site: Site, tmp_path: Path) -> None:
    site.pages["/w"] = CONTENT
    steps: list[tuple[int, int | None]] = []
    dest = tmp_path / "deep" / "w.onnx"
    fetched = fetch_file(
        f"{site.url}/w", SHA256, dest, lambda done, total: steps.append((done, total))
    )
    assert fetched == dest and dest.read_bytes() == CONTENT
    assert steps[-1] == (len(CONTENT), len(CONTENT))
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)
    assert files_in(tmp_path) == [dest]


@pytest.mark.parametrize("length_known", [True, False])
@pytest.mark.parametrize(
    ("page", "message"),
    [
        (bytes([CONTENT[0] ^ 1]) + CONTENT[1:], "found sha256 .* expected .* thrown away"),
        ((CONTENT[:1000], len(CONTENT)), "broke off|ended after 1000 bytes"),
        ((CONTENT[:1000], -1), "found sha256|ended after 1000 bytes, expected 300000"),
        (b"", "found sha256|ended after 0 bytes"),
        (None, "the server answered 404"),
    ],
)
def test_a_bad_download_leaves_what_was_there(
    site: Site,
    tmp_path: Path,
    page: bytes | tuple[bytes, int] | None,
    message: str,
    length_known: bool,
) -> None:
    if page is not None:
        site.pages["/w"] = page
    dest = tmp_path / "w.onnx"
    size = len(CONTENT) if length_known else None
    for before in (None, b"older"):
        if before:
            dest.write_bytes(before)
        with pytest.raises(InputError, match=message) as caught:
            fetch_file(f"{site.url}/w", SHA256, dest, size_bytes=size)
        assert f"{site.url}/w" in str(caught.value) and "\n" not in str(caught.value)
        assert [path.read_bytes() for path in files_in(tmp_path)] == ([before] if before else [])


def test_more_than_expected_is_not_downloaded(site: Site, tmp_path: Path) -> None:
    site.pages["/w"] = (CONTENT * 10, -1)
    steps: list[int] = []
    with pytest.raises(InputError, match="found more than the 1000 bytes expected"):
        fetch_file(
            f"{site.url}/w", SHA256, tmp_path / "w", lambda done, _: steps.append(done), 1000
        )
    assert not steps and not files_in(tmp_path)


def test_an_interruption_leaves_nothing(site: Site, tmp_path: Path) -> None:
    site.pages["/w"] = CONTENT

    def interrupt(done: int, _total: int | None) -> None:
        if done > 100_000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fetch_file(f"{site.url}/w", SHA256, tmp_path / "w.onnx", interrupt)
    assert not files_in(tmp_path)


def test_no_server_and_no_web_address_are_named(tmp_path: Path) -> None:
    url = dead_url()
    with pytest.raises(InputError, match=rf"{url}/w: could not be reached .*refused"):
        fetch_file(f"{url}/w", SHA256, tmp_path / "w")
    local = tmp_path / "secret"
    local.write_bytes(CONTENT)
    with pytest.raises(InputError, match="expected an http or https address"):
        fetch_file(local.as_uri(), SHA256, tmp_path / "w")
