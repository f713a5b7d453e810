"""A person moves a slider in a browser, and the edge of a real site wakes other cameras."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.site.streams.test_webhook import Receiver
from tests.site.web.browser import Page, in_browser
from tests.waiting import eventually

from e3pose.settings.resolved import resolve_site
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.edge_program import Edge
from e3pose.site.example import write_recorded
from e3pose.site.web.program import View, open_view

pytestmark = in_browser
LIVE = Path(__file__).parents[2] / "examples" / "06_live.py"


@pytest.fixture(scope="module")
def site(
    tmp_path_factory: pytest.TempPathFactory, window: Page
) -> Iterator[tuple[Edge, View, Page]]:
    """An edge with three cameras, its view, and a browser."""
    folder = tmp_path_factory.mktemp("site")
    recording = simulate(SceneSettings(people=2, seconds=4, fps=6.0, cameras=3), seed=1)
    site_file = write_recorded(folder / "site", recording)
    # Not falls: one that is unsure would have a second camera look.
    site_file.write_text(site_file.read_text() + '\n[events]\nkinds = ["waved"]\n')
    with ExitStack() as stack:
        edge: Edge = runpy.run_path(str(LIVE))["run"](site_file, stack)
        view = stack.enter_context(open_view(resolve_site(site_file), "127.0.0.1:0"))
        assert eventually(lambda: edge.status().slot > 5, 240)
        yield edge, view, window
        window.open("about:blank")
        window.messages.clear()


def paused(edge: Edge) -> list[bool]:
    return [camera.paused for camera in edge.status().cameras]


def test_slider_moves_the_edge_and_a_button_pauses_a_camera(
    site: tuple[Edge, View, Page],
) -> None:
    edge, view, page = site
    page.open(f"{view.url}#token={view.tokens.write}")
    assert page.shows("state", "live") and page.shows("cameras-out", "")
    move = (
        "(() => {{ const slider = document.getElementById('cameras'); slider.value = {};"
        " slider.dispatchEvent(new Event('input', {{ bubbles: true }}));"
        " slider.dispatchEvent(new Event('change')); }})()"
    )
    if edge.status().num_selected != 2:  # in a second try
        page.run(move.format(2))
    assert page.shows("cameras-out", "2")
    assert eventually(lambda: edge.status().num_selected == 2)
    page.run(move.format(1))
    assert page.shows("said", "1 camera per slot")
    assert eventually(lambda: edge.status().num_selected == 1)
    # The slots that were decided before pass first.
    assert eventually(lambda: page.of("known", "m.known.shown?.selected.size") == 1)
    page.run("[...document.querySelectorAll('#table button')][1].click()")
    assert eventually(lambda: paused(edge) == [False, True, False])
    assert page.shows("table", "paused")
    page.run("[...document.querySelectorAll('#table button')][1].click()")
    assert eventually(lambda: paused(edge) == [False, False, False])
    assert page.messages == []


def test_form_sets_target_and_weight_and_a_field_the_budget(
    site: tuple[Edge, View, Page],
) -> None:
    edge, view, page = site
    page.open(f"{view.url}#token={view.tokens.write}")
    assert page.shows("state", "live")
    assert eventually(lambda: page.text("cameras-out") != "")
    entered = (
        "(() => {{ const enter = (name, value) => {{ const field = document.getElementById(name);"
        " field.value = value; field.dispatchEvent(new Event('input')); }};"
        " enter('target', '{}'); enter('weight', '{}');"
        " setTimeout(() => document.getElementById('loop').requestSubmit(), 300); }})()"
    )
    page.run(entered.format(40, 3))
    assert page.shows("said", "40 mm")
    assert eventually(lambda: edge.status().target_error_mm == 40)
    assert edge.status().quality_weight == 3
    assert page.shows("cameras-out", "by target")
    page.run(
        "(() => { const field = document.querySelector('#table input'); field.value = '60%';"
        " field.dispatchEvent(new Event('change')); })()"
    )
    assert page.shows("said", "60")
    assert eventually(lambda: edge.status().cameras[0].budget == pytest.approx(0.6))
    page.run(
        "(() => { const slider = document.getElementById('cameras'); slider.value = 2;"
        " slider.dispatchEvent(new Event('change')); })()"
    )
    assert eventually(lambda: edge.status().num_selected == 2)
    assert edge.status().target_error_mm is None
    assert page.messages == []


def test_a_button_tests_another_s_webhook(site: tuple[Edge, View, Page], tmp_path: Path) -> None:
    edge, view, page = site
    page.open(f"{view.url}#token={view.tokens.write}")
    assert page.shows("state", "live")
    press = "document.getElementById('test-notice').click()"
    page.run(press)
    assert page.shows("said", "no webhook is at work")
    receiver, secret = Receiver(tmp_path), tmp_path / "secret"
    secret.touch(0o600)
    secret.write_text("correct horse battery staple")
    receiver.start("takes")
    words = ["stream", str(edge.site.path), f"webhook:http://127.0.0.1:{receiver.port}/hook"]
    program = subprocess.Popen(
        [sys.executable, "-m", "e3pose", *words],
        env={**os.environ, "E3POSE_WEBHOOK_SECRET_FILE": str(secret)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
    )
    with program:
        try:
            assert program.stdout is not None and b"Streaming" in program.stdout.readline()
            page.run(press)
            assert page.shows("said", "test notice delivered")
            assert '"kind": "test"' in receiver.got()[-1]["body"]
        finally:
            program.terminate()
            assert program.wait(60) == 0
            receiver.end()
    assert all("409" in one for one in page.messages), "it was refused once, and no more"


def test_who_may_only_read_sees_no_controls(site: tuple[Edge, View, Page]) -> None:
    _, view, page = site
    page.open(view.url)
    page.run("sessionStorage.clear()")
    page.open(view.url)
    assert page.shows("state", "live")
    assert page.run("document.getElementById('control') === null")
    assert not page.run("document.querySelectorAll('#table button').length")
    status = "fetch('/api/control/loop', { method: 'POST', body: '{}' }).then((a) => a.status)"
    assert page.run(status) == 401
