"""What an edge takes from its site file, and how it lets in who was added later."""

from __future__ import annotations

import datetime
import os
from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.manual_clock import ManualClock
from tests.memory_transport import Hub, MemoryTransport
from tests.rigs import looking
from tests.site.tables import write_site

from e3pose.base.errors import InputError
from e3pose.base.lock import hold_all
from e3pose.edge.server import EdgeServer
from e3pose.model.noises import DEFAULT
from e3pose.model.skeleton import COCO17
from e3pose.recording.calibration import save_rig
from e3pose.recording.folder import save_recording
from e3pose.recording.record import Recording, ViewSeries
from e3pose.settings.resolved import ResolvedSite, resolve
from e3pose.settings.site_file import SiteTable
from e3pose.site.admission import Admission, edge_link
from e3pose.site.edge_program import check_edge, make_edge
from e3pose.site.event_sink import EventSink
from e3pose.store.rows import Event
from e3pose.wire.access import Link, Roll
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, init_keys, revoke_keys

NOW = datetime.datetime.now(datetime.timezone.utc)
RIG = looking((4, 0), (0, 4))
TLS = '[link]\nendpoint = "tls/0.0.0.0:7001"\nkeys = "keys"\n'


def live_of(site: SiteTable) -> ResolvedSite:
    save_rig(RIG, site.path.with_name("rig.toml"))
    return resolve(site)


def edge_of(site: SiteTable, stack: ExitStack, tell: list[Event] | None = None) -> EdgeServer:
    tell, live = [] if tell is None else tell, live_of(site)
    clock = ManualClock(10**18)
    parts = check_edge(live)
    hold_all(parts.written, stack)
    return make_edge(live, parts, Hub().join(), clock, tell.append, stack)


def test_place_is_that_of_the_site_file(tmp_path: Path) -> None:
    place = live_of(write_site(tmp_path, 'skeleton = "coco18"\n'))
    assert place.interval_s == 0.05 and place.skeleton.name == "coco18"
    assert place.rig.camera_ids == RIG.camera_ids and place.detector == DEFAULT
    camera = '[[camera]]\nid = "c1"\ndetector = "openpose-thin"\n'
    assert live_of(write_site(tmp_path, camera)).detector == "openpose-thin"
    nothing = (ViewSeries.from_views([], [], [], 17),) * 2
    walk = Recording("walk", RIG, 20.0, 1, COCO17, nothing, detector="simulated")
    save_recording(walk, tmp_path / "walk")
    camera = '[[camera]]\nid = "c1"\nsource = "recorded:walk"\n'
    assert live_of(write_site(tmp_path, camera)).detector == "simulated"


def test_edge_has_the_settings_of_its_site(tmp_path: Path) -> None:
    site = write_site(
        tmp_path,
        'deadline_ms = 250\npace = 0.5\nlead = 3\nstate = "kept/state.npz"\n'
        '[[camera]]\nid = "c1"\nidle_mode = "aggressive-power-saving"\n',
    )
    with ExitStack() as stack:
        edge = edge_of(site, stack)
        settings = edge.settings
        assert (settings.site, settings.deadline_s, settings.pace) == ("lab", 0.25, 0.5)
        assert not settings.adaptive_lead
        assert settings.idle_modes == ["power-saving", "aggressive-power-saving"]
        assert edge.state_file.path == tmp_path / "kept" / "state.npz"
        assert edge.interval_ns == 100_000_000  # twice a slot of the scene
        assert edge.consumers.sink is None and edge.consumers.learner is None
        assert (tmp_path / "kept").is_dir()


def test_store_of_a_site_is_open_while_its_edge_is(tmp_path: Path) -> None:
    site = write_site(tmp_path, '[events]\n[store]\npath = "live.db"\nkeep = "2d"\n')
    with ExitStack() as stack:
        edge = edge_of(site, stack)
        sink = edge.consumers.sink
        assert isinstance(sink, EventSink) and sink.status().problem is None
        assert edge.consumers.asks == sink.request
    assert (tmp_path / "live.db").is_file()


def test_two_edges_do_not_keep_one_state(tmp_path: Path) -> None:
    site = write_site(tmp_path)
    with ExitStack() as stack:
        edge_of(site, stack)
        with pytest.raises(InputError, match=f"process {os.getpid()}"):
            edge_of(site, stack)
    with ExitStack() as stack:  # the first is gone
        edge_of(site, stack)


def test_link_over_tls_has_the_certificate_and_the_list(tmp_path: Path) -> None:
    init_keys(tmp_path / "keys", "lab", [], NOW)
    add_keys(tmp_path / "keys", "c0", NOW)
    link, roll = edge_link(write_site(tmp_path, f'{TLS}upstream = ["tls/house.local:7447"]\n'))
    assert link.role == "edge" and link.certificates is not None
    assert link.upstream == (read_endpoint("tls/house.local:7447"),)
    assert link.certificates.certificate == tmp_path / "keys" / "edge.pem"
    assert roll is not None and set(roll.cameras) == {"c0"}


def test_link_without_certificates_is_plain_and_on_this_machine(tmp_path: Path) -> None:
    link, roll = edge_link(write_site(tmp_path, '[link]\nendpoint = "tcp/127.0.0.1:7001"\n'))
    assert link.certificates is None and roll is None
    with pytest.raises(InputError, match="plain tcp beyond this machine"):
        edge_link(write_site(tmp_path, '[link]\nendpoint = "tcp/0.0.0.0:7001"\n'))


def test_edge_joins_anew_once_for_each_change_of_the_list(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    init_keys(keys, "lab", [], NOW)
    add_keys(keys, "c0", NOW)
    site = write_site(tmp_path, TLS)
    hub, messages = Hub(), list[str]()
    rolls: list[set[str]] = []

    def join(link: Link, roll: Roll | None) -> MemoryTransport:
        assert roll is not None and link.role == "edge"
        rolls.append(set(roll.cameras))
        return hub.join()

    with ExitStack() as stack:
        server = edge_of(site, stack)
        admission = Admission(site, server, join, messages.append)
        admission.update()
        assert not rolls and not messages
        add_keys(keys, "c1", NOW)
        admission.update()
        admission.update()
        assert rolls == [{"c0", "c1"}] and len(messages) == 1
        revoke_keys(keys, "c0")
        admission.update()
        assert rolls[-1] == {"c1"}
        assert server.inbox.problems()[0] == "certificate revoked: e3pose keys add c0"
        # A list that is invalid is reported once, and changes nothing.
        good = (keys / "keys.toml").read_text()
        (keys / "keys.toml").write_text("no list [")
        before = len(messages)
        admission.update()
        admission.update()
        assert len(rolls) == 2 and len(messages) == before + 1
        (keys / "keys.toml").write_text(good)
        admission.update()
        assert rolls[-1] == {"c1"} and len(rolls) == 3
