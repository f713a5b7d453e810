"""Versions: numbered, checked, bounded, and the way back."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.edge.learn.versions import COPY, MANIFEST, Version, VersionStore


def describe(parent: int) -> Version:
    return Version(0, parent, 1.8e9, "", (1, 5), (0.01, 0.02), (0.02, 0.03), 300)


def filled(folder: Path, count: int, keep: int = 5) -> VersionStore:
    store = VersionStore(folder, keep)
    for number in range(1, count + 1):
        made = store.add(f"weights {number}".encode(), "# Card\n", describe(number - 1))
        assert made.number == number
    return store


def test_versions_are_kept_over_restarts(tmp_path: Path) -> None:
    manifest = VersionStore(tmp_path).read()
    assert manifest.current == 0 and manifest.versions == () and manifest.find(0) is None
    filled(tmp_path, 2)
    manifest = VersionStore(tmp_path).read()
    assert manifest.current == 2 and [v.number for v in manifest.versions] == [1, 2]
    for version in manifest.versions:
        weights = VersionStore(tmp_path).weights(version)
        assert weights.read_bytes() == f"weights {version.number}".encode()
        assert weights.with_suffix(".md").read_text() == "# Card\n"


def test_the_way_back_leads_to_the_parent_and_to_the_beginning(tmp_path: Path) -> None:
    store = filled(tmp_path, 3)
    assert [store.back(), store.back(), store.back()] == [2, 1, 0]
    with pytest.raises(InputError, match="nothing is before it"):
        store.back()
    store.use(3)
    assert store.read().current == 3
    with pytest.raises(InputError, match="version: found 9, expected one of 0, 1, 2, 3"):
        store.use(9)
    store.use(0)
    assert store.add(b"other", "", describe(0)).number == 4  # no number is given twice


def test_only_so_many_are_kept(tmp_path: Path) -> None:
    store = filled(tmp_path, 7, keep=3)
    assert [v.number for v in store.read().versions] == [5, 6, 7]
    assert sorted(p.stem for p in tmp_path.glob("*.onnx")) == ["000005", "000006", "000007"]
    assert len(list(tmp_path.glob("*.md"))) == 3
    store.use(5)
    assert store.add(b"child of 5", "", describe(5)).number == 8
    assert [v.number for v in store.read().versions] == [5, 6, 7, 8]  # the way back stays
    store.use(5)
    assert store.back() == 0  # 4 is no longer kept


@pytest.mark.parametrize("damage", [b"", b"weights 1 and more"])
def test_damaged_weights_are_refused(tmp_path: Path, damage: bytes) -> None:
    store = filled(tmp_path, 2)
    (tmp_path / "000001.onnx").write_bytes(damage)
    with pytest.raises(InputError, match=r"000001\.onnx: found a damaged file"):
        store.use(1)
    assert store.read().current == 2
    (tmp_path / "000001.onnx").unlink()
    with pytest.raises(InputError, match=r"000001\.onnx"):
        store.back()


@each_case(
    "content",
    [b"", b"{", b"[1]", b'{"format": "something else"}', b'{"current": "x"}', b'{"extra": 1}'],
)
def test_a_damaged_list_is_refused_and_put_aside(tmp_path: Path, content: bytes) -> None:
    store = filled(tmp_path, 2)
    (tmp_path / MANIFEST).write_bytes(content)
    with pytest.raises(InputError, match=r"versions\.json"):
        store.read()
    aside, manifest = store.put_aside()
    assert aside.read_bytes() == content
    assert store.read().current == manifest.current == 2, "its copy takes its place"
    (tmp_path / MANIFEST).write_bytes(content)
    (tmp_path / COPY).write_bytes(content)
    aside, manifest = store.put_aside()
    assert store.read().current == manifest.current == 0
    assert store.add(b"new", "", describe(0)).number == 3  # 1 and 2 lie there still


SAVING = """
import sys
from pathlib import Path
from e3pose.edge.learn.versions import Version, VersionStore
store = VersionStore(Path(sys.argv[1]))
print("ready", flush=True)
while True:
    parent = store.read().current
    describe = Version(0, parent, 1.8e9, "", (1, 5), (0.01, 0.02), (0.02, 0.03), 300)
    store.add(b"%d" % parent * 200_000, "# Card", describe)
"""


def test_kill_9_while_a_version_is_saved_leaves_a_good_one(tmp_path: Path) -> None:
    newest = 0
    for after_s in (0.003, 0.02, 0.05, 0.08):
        child = subprocess.Popen(
            [sys.executable, "-c", SAVING, str(tmp_path)], stdout=subprocess.PIPE, text=True
        )
        assert child.stdout is not None
        with child.stdout:
            assert child.stdout.readline() == "ready\n"
            time.sleep(after_s)  # whatever it does then
            child.send_signal(signal.SIGKILL)
            child.wait()
        store = VersionStore(tmp_path)
        manifest = store.read()
        assert manifest.current >= newest
        newest = manifest.current
        for version in manifest.versions:
            assert store.weights(version).is_file()
    assert newest > 0
    store.add(b"weights", "# Card", describe(newest))
    assert not list(tmp_path.glob(".[0-9]*.onnx.*")), "what was cut off is removed"


@each_case("place", range(0, 1500, 47))
def test_flipped_bit_of_the_list_is_never_taken_for_another(tmp_path: Path, place: int) -> None:
    store = filled(tmp_path, 3)
    good = store.read()
    content = bytearray((tmp_path / MANIFEST).read_bytes())
    content[place % len(content)] ^= 0x04
    (tmp_path / MANIFEST).write_bytes(content)
    try:
        found = store.read()
        for version in found.versions:
            if version.sha256 != {v.number: v.sha256 for v in good.versions}.get(version.number):
                with pytest.raises(InputError, match=r"damaged|not found"):
                    store.weights(version)
    except InputError:
        assert store.put_aside()[1] == good
