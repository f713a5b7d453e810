"""A new camera joins a running site by a code: edge, page, browser and camera are real programs."""

from __future__ import annotations

import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from tests.live.processes import LiveSite, e3pose, make_keys, make_recording
from tests.ports import free_port
from tests.site.web.browser import Page, in_browser
from tests.waiting import WAIT_S, eventually

from e3pose.site.web.tokens import open_tokens
from e3pose.wire.keys.folder import revoke_keys

pytestmark = in_browser


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveSite]:
    """An edge with two of its three cameras: cam2 has no certificate."""
    folder, port = tmp_path_factory.mktemp("site"), free_port()
    made = LiveSite(folder, port=port, name=f"join-{port}")
    make_recording(folder / "recording")
    keys = make_keys(folder / "keys", site=made.name)
    revoke_keys(keys, "cam2")
    shutil.rmtree(keys / "cameras" / "cam2")
    made.write()
    made.start_edge()
    made.start_camera("cam0")
    made.start_camera("cam1")
    made.watch()
    try:
        made.becomes("cam0", "cam1")
        yield made
    finally:
        made.close()


def join(
    site: LiveSite, folder: Path, code: str, *options: str
) -> subprocess.CompletedProcess[str]:
    """Run the camera program on another machine, so to say, and type a code there."""
    folder.mkdir(exist_ok=True)
    words = ["camera", "--join", "--name", "cam2", "--site", site.name, "--meter", "model"]
    source = f"recorded:{site.folder / 'recording'}"
    return subprocess.run(
        [*e3pose(*words), "--source", source, *options],
        input=f"{code}\n",
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=60,
    )


def shown_code(page: Page) -> str:
    """Press the button of the page; return the code that it shows."""
    page.run("document.getElementById('join-button').click()")
    assert eventually(lambda: page.run("!!document.getElementById('join-code')"))
    return str(page.text("join-code"))


def test_camera_joins_by_the_code_of_the_page_and_works_at_once(
    site: LiveSite, page: Page, tmp_path: Path
) -> None:
    url, tokens = site.start_view(), open_tokens(site.folder / "view-tokens.toml")
    page.open(f"{url}#token={tokens.write}")
    assert page.shows("join", "Without a certificate: cam2.")
    code = shown_code(page)
    page.judge("document.getElementById('join')")
    for token, status in (("", 401), (tokens.read, 403)):  # the code is for operators
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        assert httpx.get(f"{url}api/control/join", headers=headers).status_code == status
    wrong = join(site, tmp_path / "pi", "000 001" if code == "000 000" else "000 000")
    assert wrong.returncode == 2 and "wrong code" in wrong.stderr, wrong
    assert not any((tmp_path / "pi").iterdir())
    assert page.shows("join-said", "The code is used up, by 127.0.0.1: wrong code")
    done = join(site, tmp_path / "pi", shown_code(page))
    assert done.returncode == 0, done.stderr
    assert "cam2 joined" in done.stdout and "next: e3pose camera cam2.toml" in done.stdout
    assert page.shows("join-said", "cam2 joined.")
    assert page.shows("join", "All cameras of the site have certificates.")
    assert (tmp_path / "pi" / "cam2" / "camera.key").stat().st_mode & 0o777 == 0o600
    assert not (site.folder / "keys" / "cameras" / "cam2" / "camera.key").exists()
    site.start("cam2", *e3pose("camera", str(tmp_path / "pi" / "cam2.toml")))
    site.becomes("cam0", "cam1", "cam2")
    assert [one for one in page.messages if "40" not in one] == []


def test_camera_joins_by_a_terminal_of_the_edge(site: LiveSite, tmp_path: Path) -> None:
    revoke_keys(site.folder / "keys", "cam2")
    site.becomes("cam0", "cam1")
    words = e3pose("keys", "join", str(site.path))
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as door:
        assert door.stdout is not None
        code = door.stdout.readline().rpartition(":")[2].strip()
        done = join(site, tmp_path / "pi", code, "--endpoint", site.endpoint)
        assert done.returncode == 0, done.stderr
        assert "cam2 joined." in door.stdout.read()
        assert door.wait(WAIT_S) == 0
    if "cam2" in site.programs:
        site.send("cam2", signal.SIGKILL)
        site.wait("cam2")
    site.start("cam2", *e3pose("camera", str(tmp_path / "pi" / "cam2.toml")))
    site.becomes("cam0", "cam1", "cam2")
