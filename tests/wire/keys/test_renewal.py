"""Certificates are renewed without revoking the old ones, and what expires is reported."""

from __future__ import annotations

import datetime
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from e3pose.base.errors import InputError
from e3pose.site.admission import AGAIN, LOOK_S, ExpiryWatch
from e3pose.wire.keys.authority import (
    LEAF_DAYS,
    common_name,
    expires,
    hosts_of,
    make_authority,
    make_certificate,
)
from e3pose.wire.keys.folder import (
    add_keys,
    certificates_in,
    check_certificates,
    holder,
    init_keys,
    read_roll,
    revoke_keys,
)
from e3pose.wire.keys.renewal import expiring, renew_keys

NOW = datetime.datetime(2026, 11, 23, 12, tzinfo=datetime.timezone.utc)
DAY = datetime.timedelta(days=1)
END = NOW + LEAF_DAYS * DAY


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    folder = tmp_path / "keys"
    init_keys(folder, "lab", ["edge.local", "192.168.0.7"], NOW)
    add_keys(folder, "cam1", NOW)
    add_keys(folder, "desk", NOW, kind="operator")
    add_keys(folder, "house", NOW, kind="hub")
    return folder


@pytest.mark.parametrize(("name", "place", "role"), [
    ("edge", ".", "edge"),
    ("cam1", "cameras/cam1", "camera"),
    ("desk", "operators/desk", "operator"),
    ("house", "hubs/house", "hub"),
])  # fmt: skip
def test_renewed_certificate_is_the_holder_s(keys: Path, name: str, place: str, role: str) -> None:
    path = keys / place / f"{role}.pem"
    before, roll, later = path.read_bytes(), read_roll(keys), END - 10 * DAY
    assert renew_keys(keys, name, later) == keys / place
    after = path.read_bytes()
    assert common_name(after) == common_name(before) and hosts_of(after) == hosts_of(before)
    assert expires(after) == later + LEAF_DAYS * DAY and expires(before) == END
    assert read_roll(keys) == roll  # nothing is revoked
    check_certificates(certificates_in(keys / place, role), later + 100 * DAY)  # type: ignore[arg-type]
    assert path.with_suffix(".key").stat().st_mode & 0o077 == 0


COMMANDS: dict[str, Callable[[Path], object]] = {
    "init": lambda keys: init_keys(keys / "new", "lab", [], NOW),
    "add": lambda keys: add_keys(keys, "cam2", NOW),
    "add --again": lambda keys: add_keys(keys, "cam1", NOW, again=True),
    "renew edge": lambda keys: renew_keys(keys, "edge", NOW),
    "renew cam1": lambda keys: renew_keys(keys, "cam1", NOW),
    "revoke": lambda keys: revoke_keys(keys, "cam1"),
}


class Killed(BaseException):
    """Stands for the end of a program in the middle of its work."""


@pytest.mark.parametrize("command", COMMANDS)
def test_command_that_is_killed_leaves_whole_pairs_and_can_be_repeated(
    keys: Path, tmp_path: Path, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace, left = os.replace, 0

    def cut_off(*places: Path) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            raise Killed
        replace(*places)

    monkeypatch.setattr(os, "replace", cut_off)
    for step in range(1, 30):
        folder, left = tmp_path / f"{step}", step
        shutil.copytree(keys, folder)
        try:
            COMMANDS[command](folder)
        except Killed:
            left = 0
            for certificate in (path for path in folder.rglob("*.pem") if "/." not in str(path)):
                role = certificate.stem
                if role != "authority":
                    check_certificates(certificates_in(certificate.parent, role), NOW)  # type: ignore[arg-type]
            if not (command == "init" and (folder / "new").exists()):
                COMMANDS[command](folder)
            continue
        assert step > 1, "nothing was replaced"
        return
    raise AssertionError("never done")


def test_renewal_keeps_a_private_key_and_replaces_one_that_does_not_fit(keys: Path) -> None:
    files = certificates_in(keys / "cameras/cam1", "camera")
    before = files.key.read_bytes()
    renew_keys(keys, "cam1", NOW)
    assert files.key.read_bytes() == before
    files.key.write_bytes((keys / "edge.key").read_bytes())
    with pytest.raises(InputError, match=r"another certificate, .* `e3pose keys renew`"):
        check_certificates(files, NOW)
    renew_keys(keys, "cam1", NOW)
    check_certificates(files, NOW)
    files.key.write_text("damaged")
    renew_keys(keys, "cam1", NOW)
    check_certificates(files, NOW)
    moved = files.key.read_bytes()
    files.key.unlink()  # it is on the camera alone
    renew_keys(keys, "cam1", NOW)
    assert not files.key.exists()
    files.key.write_bytes(moved)
    check_certificates(files, NOW)
    for name, place in (("edge", "edge.key"), ("desk", "operators/desk/operator.key")):
        (keys / place).unlink()
        renew_keys(keys, name, NOW)
        assert (keys / place).exists()


def test_who_has_no_certificate_gets_none(keys: Path) -> None:
    revoke_keys(keys, "cam1")
    with pytest.raises(InputError, match="found no certificate of cam1, expected one of: edge, "):
        renew_keys(keys, "cam1", NOW)
    with pytest.raises(InputError, match=r"found no certificate of \.\./\.\./x"):
        renew_keys(keys, "../../x", NOW)


def test_file_of_another_holder_is_not_renewed(keys: Path) -> None:
    (keys / "cameras/cam1/camera.pem").write_bytes(
        (keys / "operators/desk/operator.pem").read_bytes()
    )
    with pytest.raises(InputError, match=r"certificate of cam1 is that of desk#2, expected cam1#1"):
        renew_keys(keys, "cam1", NOW)
    (keys / "cameras/cam1/camera.pem").write_text("garbage")
    with pytest.raises(InputError, match=r"camera\.pem: found no certificate"):
        renew_keys(keys, "cam1", NOW)


def test_certificate_of_others_has_no_holder(keys: Path) -> None:
    files = certificates_in(keys / "operators/desk", "operator")
    assert holder(files) == "desk"
    pair = make_authority("lab", NOW)
    for name in ("*#1", "a/b#1", "desk", "../x#1"):
        files.certificate.write_bytes(make_certificate(*pair, name, [], NOW)[0])
        with pytest.raises(InputError, match=r"operator\.pem: certificate.* expected one that"):
            holder(files)


def test_what_expires_soon_is_named(keys: Path) -> None:
    assert list(expiring(keys, END - 31 * DAY)) == []
    assert [name for name, _ in expiring(keys, END - 29 * DAY)] == ["edge", "cam1", "desk", "house"]
    renew_keys(keys, "edge", END - 29 * DAY)
    assert [name for name, _ in expiring(keys, END + DAY)] == ["cam1", "desk", "house"]
    assert "authority" in dict(expiring(keys, NOW + 3640 * DAY))


def test_expiry_is_reported_once_a_day_and_again_when_it_has_come(keys: Path) -> None:
    said: list[str] = []
    now, now_s = [END - 40 * DAY], [0.0]

    def pass_by(time: datetime.timedelta) -> list[str]:
        now[0] += time
        now_s[0] += LOOK_S
        said.clear()
        watch.update()
        watch.update()
        return list(said)

    ExpiryWatch(None, lambda *_: pytest.fail("reported")).update()
    watch = ExpiryWatch(keys, lambda _, line: said.append(line), lambda: now[0], lambda: now_s[0])
    assert pass_by(DAY) == []
    lines = pass_by(25 * DAY)
    assert (
        len(lines) == 4 and "edge expires on 2029-02-25, in 14 days: e3pose keys renew" in lines[0]
    )
    assert pass_by(DAY / 2) == [] and len(pass_by(AGAIN)) == 4
    assert len(pass_by(-2 * DAY)) == 4  # the clock was set back
    lines = pass_by(16 * DAY)
    assert "cam1 expired on 2029-02-25 12:00 UTC: no new connection is accepted with it" in lines[1]
    renew_keys(keys, "edge", now[0])
    assert len(pass_by(2 * AGAIN)) == 3
