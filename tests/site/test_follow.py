"""Following a site from outside, over the transport that tests use."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.memory_transport import Hub
from tests.site.tables import write_site

from e3pose.base.errors import InputError
from e3pose.site.follow import Follower, viewer_link
from e3pose.wire.arrays import pack, unpack
from e3pose.wire.codec import encode
from e3pose.wire.keys.folder import add_keys, init_keys
from e3pose.wire.site_messages import Poses, Status

NOW = datetime.datetime.now(datetime.timezone.utc)


def status(slot: int, site: str = "lab") -> Status:
    return Status(site, slot, 20.0, 2, 1, ())


def poses(slot: int) -> Poses:
    joints_m = np.full((1, 2, 3), slot, dtype=np.float32)
    return Poses(
        slot,
        0,
        ("nose", "neck"),
        pack(np.array([7], dtype=np.int64)),
        pack(joints_m),
        pack(np.zeros((1, 2), dtype=np.float32)),
        pack(np.ones((1, 2), dtype=bool)),
    )


def test_newest_status_and_poses_are_kept_and_handed_on() -> None:
    hub, follower = Hub(), Follower("lab")
    shown: list[Poses] = []
    statuses: list[Status] = []
    follower.listen(hub.join(), shown.append, statuses.append)
    edge = hub.join()
    edge.publish("e3pose/hall/status", encode(status(9, "hall")))
    edge.publish("e3pose/lab/order/cam0", encode(status(9)))
    assert follower.status is None and follower.poses is None and not follower.fresh.is_set()
    for slot in (3, 4):
        edge.publish("e3pose/lab/status", encode(status(slot)))
        edge.publish("e3pose/lab/poses", encode(poses(slot)))
    assert follower.status == status(4) and follower.fresh.is_set()
    assert [found.slot for found in shown] == [3, 4]
    assert [found.slot for found in statuses] == [3, 4]
    assert follower.poses is not None
    np.testing.assert_array_equal(unpack(follower.poses.joints_m), np.full((1, 2, 3), 4.0))
    assert follower.problem == ""


@each_case("topic", ["status", "poses"])
def test_message_that_makes_no_sense_is_reported_and_changes_nothing(topic: str) -> None:
    hub, follower, heard = Hub(), Follower("lab"), list[int]()
    follower.listen(
        hub.join(), lambda found: heard.append(found.slot), lambda found: heard.append(found.slot)
    )
    edge = hub.join()
    edge.publish("e3pose/lab/status", encode(status(3)))
    edge.publish("e3pose/lab/poses", encode(poses(3)))
    edge.publish(f"e3pose/lab/{topic}", b"garbage")
    assert follower.problem and heard == [3, 3]
    assert follower.status == status(3)
    assert follower.poses is not None and follower.poses.slot == 3
    edge.publish("e3pose/lab/status", encode(status(5)))  # it goes on
    assert follower.status == status(5)


@each_case(
    ("listens", "found"),
    [
        ("tcp/127.0.0.1:7001", "tcp/127.0.0.1:7001"),
        ("tcp/0.0.0.0:7001", "tcp/localhost:7001"),
        ("tcp/[::]:7001", "tcp/localhost:7001"),
        ("tcp/edge.local:7001", "tcp/edge.local:7001"),
    ],
)
def test_viewer_finds_an_edge_that_listens_everywhere_on_this_machine(
    tmp_path: Path, listens: str, found: str
) -> None:
    site = write_site(tmp_path, f'[link]\nendpoint = "{listens}"\ninsecure = true\n')
    link = viewer_link(site, None)
    assert (link.role, link.site, str(link.endpoint)) == ("viewer", "lab", found)
    assert link.certificates is None and link.insecure


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site") / "keys"
    init_keys(folder, "lab", [], NOW)
    add_keys(folder, "cam0", NOW)
    for viewer in ("wall", "desk"):
        add_keys(folder, viewer, NOW, kind="viewer")
    return folder


def test_viewer_over_tls_takes_the_certificate_that_is_named_or_the_first(keys: Path) -> None:
    site = write_site(keys.parent, '[link]\nendpoint = "tls/127.0.0.1:7001"\nkeys = "keys"\n')
    link = viewer_link(site, None)
    assert str(link.endpoint) == "tls/localhost:7001"  # the name in the certificate
    assert link.certificates is not None
    assert link.certificates.certificate == keys / "viewers" / "desk" / "viewer.pem"
    named = viewer_link(site, keys / "viewers" / "wall").certificates
    assert named is not None and named.certificate.parent.name == "wall"

    with pytest.raises(InputError, match=r"viewer\.(pem|key)"):
        viewer_link(site, keys / "cameras" / "cam0")


def test_site_without_a_viewer_names_the_command_that_makes_one(tmp_path: Path) -> None:
    init_keys(tmp_path / "keys", "lab", [], NOW)
    site = write_site(tmp_path, '[link]\nendpoint = "tls/0.0.0.0:7001"\nkeys = "keys"\n')
    with pytest.raises(InputError, match="e3pose keys add NAME --viewer"):
        viewer_link(site, None)
