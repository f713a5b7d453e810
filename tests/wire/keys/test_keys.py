"""Certificates: made, listed, replaced, revoked, and what is wrong with wrong ones."""

from __future__ import annotations

import datetime
import stat
import threading
from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.base.lock import hold
from e3pose.wire.keys.authority import common_name, expires
from e3pose.wire.keys.folder import (
    add_keys,
    certificates_in,
    check_certificates,
    init_keys,
    read_roll,
    revoke_keys,
)

NOW = datetime.datetime(2026, 6, 1, tzinfo=datetime.timezone.utc)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    init_keys(tmp_path / "keys", "lab", ["edge.local", "10.0.0.7"], NOW)
    return tmp_path / "keys"


def test_camera_folder_is_all_that_the_camera_needs_and_its_owner_s_alone(folder: Path) -> None:
    place = add_keys(folder, "cam1", NOW)
    check_certificates(certificates_in(place, "camera"), NOW)
    check_certificates(certificates_in(folder, "edge"), NOW)
    assert not any(p.name == "authority.key" for p in place.iterdir())
    assert read_roll(folder).cameras == {"cam1": common_name((place / "camera.pem").read_bytes())}
    check_certificates(certificates_in(add_keys(folder, "wall", NOW, kind="viewer"), "viewer"), NOW)
    roll = read_roll(folder)
    assert set(roll.viewers) == {"wall"} and set(roll.cameras) == {"cam1"}
    # Private keys are private.
    for key in folder.rglob("*.key"):
        assert stat.S_IMODE(key.stat().st_mode) == 0o600
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_certificates_sign_and_do_nothing_else(folder: Path) -> None:
    from cryptography import x509

    names = ("digital_signature", "content_commitment", "key_encipherment", "data_encipherment",
             "key_agreement", "key_cert_sign", "crl_sign")  # fmt: skip
    for file, signs in (("authority.pem", True), ("edge.pem", False)):
        found = x509.load_pem_x509_certificate((folder / file).read_bytes())
        usage = found.extensions.get_extension_for_class(x509.KeyUsage).value
        allowed = {name for name in names if getattr(usage, name)}
        assert allowed == {"digital_signature", *(["key_cert_sign", "crl_sign"] if signs else [])}


def test_certificates_made_at_the_same_time_are_all_listed(folder: Path) -> None:
    names = [f"cam{number}" for number in range(8)]
    threads = [threading.Thread(target=add_keys, args=(folder, name, NOW)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(read_roll(folder).cameras) == names


def test_list_that_another_changes_is_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("e3pose.wire.keys.folder.WAIT_S", 0.1)
    with hold(folder / "keys.toml"):
        for change in (lambda: add_keys(folder, "cam1", NOW), lambda: revoke_keys(folder, "cam1")):
            with pytest.raises(InputError, match=r"keys\.toml: process [0-9]+ .* writes there"):
                change()


def test_revoked_name_is_never_given_again_and_a_second_is_asked_for(
    folder: Path,
) -> None:
    add_keys(folder, "cam1", NOW)
    old = read_roll(folder).cameras["cam1"]
    with pytest.raises(InputError, match="expected one of: cam1"):
        revoke_keys(folder, "cam7")
    roll = revoke_keys(folder, "cam1")
    assert "cam1" not in roll.cameras and old in roll.revoked
    add_keys(folder, "cam1", NOW)
    assert read_roll(folder).cameras["cam1"] != old
    # Second certificate needs to be asked for.
    with pytest.raises(InputError, match="--again"):
        add_keys(folder, "cam1", NOW)
    old = read_roll(folder).cameras["cam1"]
    add_keys(folder, "cam1", NOW, again=True)
    roll = read_roll(folder)
    assert roll.cameras["cam1"] != old and roll.revoked[-1] == old


@each_case("name", ["../x", "", "a/b", "*", "x#1"])
def test_name_that_is_no_camera_makes_no_file(folder: Path, name: str) -> None:
    def files() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    before = files()
    with pytest.raises(InputError, match="camera id"):
        add_keys(folder, name, NOW)
    with pytest.raises(InputError, match="exists"):
        init_keys(folder, "lab", [], NOW)
    assert files() == before


def test_wrong_certificates_are_reported(folder: Path, tmp_path: Path) -> None:
    place = add_keys(folder, "cam1", NOW)
    files = certificates_in(place, "camera")
    with pytest.raises(InputError, match="expired on"):
        check_certificates(files, NOW + datetime.timedelta(days=1000))
    with pytest.raises(InputError, match="valid from"):
        check_certificates(files, NOW - datetime.timedelta(days=30))
    assert expires(files.certificate.read_bytes()) > NOW
    other = tmp_path / "other"
    init_keys(other, "lab", [], NOW)
    (place / "authority.pem").write_bytes((other / "authority.pem").read_bytes())
    with pytest.raises(InputError, match="another authority"):
        check_certificates(files, NOW)
    files.key.write_bytes((other / "edge.key").read_bytes())
    with pytest.raises(InputError, match="belongs to another"):
        check_certificates(files, NOW)
    files.key.write_bytes(b"nonsense")
    with pytest.raises(InputError, match=r"camera\.pem: found no certificate or key"):
        check_certificates(files, NOW)
    files.key.unlink()
    with pytest.raises(InputError, match=r"camera\.key: file not found"):
        certificates_in(place, "camera")


@each_case(
    "text",
    ["", "format = 'other'", "format = 'e3pose-keys'\nversion = 2", "[", "\x00"],
)
def test_damaged_list_is_reported(folder: Path, text: str) -> None:
    (folder / "keys.toml").write_text(text)
    with pytest.raises(InputError, match=r"keys\.toml"):
        read_roll(folder)
