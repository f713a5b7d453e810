"""`e3pose router` and its certificate: options that fit, rules that are taken in while it runs."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from pathlib import Path

import pytest
from tests.memory_transport import Hub, MemoryTransport
from tests.ports import free_port

from e3pose.base.errors import InputError
from e3pose.cli.app import main
from e3pose.site.router_program import Router, router_link
from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, init_keys, read_roll, revoke_keys

NOW = datetime.datetime.now(datetime.timezone.utc)
EDGE, HERE = read_endpoint("tls/edge.local:7447"), read_endpoint("tls/127.0.0.1:7448")


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    init_keys(tmp_path / "keys", "lab", [], NOW)
    add_keys(tmp_path / "keys", "cam1", NOW)
    add_keys(tmp_path / "keys", "hall", NOW, kind="router", hosts=["hall.local"])
    return tmp_path / "keys"


def test_router_is_of_its_site_and_reaches_the_edge(keys: Path) -> None:
    link, roll = router_link(keys / "routers" / "hall", HERE, EDGE)
    assert (link.role, link.site, link.upstream) == ("router", "lab", (EDGE,))
    assert roll == read_roll(keys) and set(roll.cameras) == {"cam1"}
    add_keys(keys, "cam2", NOW)
    assert read_roll(keys / "routers" / "hall") == read_roll(keys)
    revoke_keys(keys, "cam1")
    assert set(read_roll(keys / "routers" / "hall").cameras) == {"cam2"}


def test_its_certificate_is_for_its_hosts(keys: Path) -> None:
    from cryptography import x509

    found = x509.load_pem_x509_certificate((keys / "routers/hall/router.pem").read_bytes())
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert set(names.get_values_for_type(x509.DNSName)) == {"localhost", "hall", "hall.local"}


def test_nothing_but_tls_is_routed(keys: Path) -> None:
    plain = read_endpoint("tcp/127.0.0.1:7448")
    for here, edge in ((plain, EDGE), (HERE, plain)):
        with pytest.raises(InputError, match="found no tls, expected tls/HOST:PORT"):
            router_link(keys / "routers" / "hall", here, edge)


def test_running_router_takes_in_a_new_list_and_outlives_a_wrong_one(keys: Path) -> None:
    messages: list[str] = []
    opened: list[Mapping[str, str]] = []

    def join(link: Link, roll: object) -> MemoryTransport:
        opened.append(read_roll(keys).cameras)
        return MemoryTransport(Hub())

    place = keys / "routers" / "hall"
    router = Router(place, HERE, EDGE, join, messages.append)
    router.open()
    router.update()
    assert len(opened) == 1 and not messages
    revoke_keys(keys, "cam1")
    router.update()
    router.update()
    assert opened[1:] == [{}] and messages == ["certificates reloaded"]
    (place / "keys.toml").write_text("nothing")
    router.update()
    router.update()
    assert len(opened) == 2 and len(messages) == 2 and "keys.toml" in messages[1]


def test_contradictions_are_refused(keys: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for options, messages in (
        (["--viewer", "--router"], "--router: found with --viewer"),
        (["--host", "a.local"], "--host: found without --router"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(["keys", "add", "x", "--keys", str(keys), *options])
        assert ended.value.code == 2 and messages in capsys.readouterr().err


def test_folder_of_a_camera_is_no_router(keys: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(
            ["router", str(keys), "--edge", str(EDGE), "--endpoint", f"tls/127.0.0.1:{free_port()}"]
        )
    assert ended.value.code == 2 and "router.pem" in capsys.readouterr().err
