from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.recording.arrays import Shape, floats, integers, load_arrays

SHAPES: dict[str, Shape] = {"a": ("n", 2), "b": ("n",), "c?": (1,)}


def _save(path: Path, **arrays: object) -> Path:
    np.savez(path, **arrays)  # type: ignore[arg-type]
    return path


def test_named_axes_must_agree(tmp_path: Path) -> None:
    path, array = tmp_path / "x.npz", np.arange(6.0).reshape(3, 2)
    np.savez_compressed(path, a=np.asfortranarray(array), b=np.arange(3))
    arrays = load_arrays(path, SHAPES)
    assert sorted(arrays) == ["a", "b"]
    np.testing.assert_array_equal(arrays["a"], array)
    np.testing.assert_array_equal(arrays["b"], [0, 1, 2])
    wrong = _save(tmp_path / "y.npz", a=np.ones((3, 2)), b=np.arange(4))
    with pytest.raises(InputError, match=r"'b': found shape \(4,\), expected \(3\)"):
        load_arrays(wrong, SHAPES)


def test_a_pickle_is_never_opened(tmp_path: Path) -> None:
    path = _save(tmp_path / "x.npz", a=np.array([[{}, 1]], dtype=object), b=np.arange(1))
    with pytest.raises(InputError, match=r"'a': found object, expected numbers"):
        load_arrays(path, SHAPES)


def test_a_header_that_promises_terabytes_allocates_nothing(tmp_path: Path) -> None:
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (500000000000, 2), }"
    header += b" " * (64 - (10 + len(header) + 1) % 64) + b"\n"
    content = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"\0" * 16
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("a.npy", content)
    with pytest.raises(InputError, match="header promises 8000000000000 bytes"):
        load_arrays(tmp_path / "x.npz", {"a": ("n", 2)})


def test_what_unpacks_to_far_more_than_its_file_is_refused(tmp_path: Path) -> None:
    large = np.zeros((10**7, 2))
    np.savez_compressed(tmp_path / "x.npz", a=large, b=np.zeros(3))
    with pytest.raises(InputError, match=r"'a': found 160000128 bytes packed into \d+"):
        load_arrays(tmp_path / "x.npz", SHAPES)
    np.savez(tmp_path / "y.npz", a=large[:10], b=np.zeros(10))
    assert len(load_arrays(tmp_path / "y.npz", SHAPES)["a"]) == 10


@each_case("large", [False, True])
def test_archive_of_a_million_names_is_not_listed(
    large: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python would take a minute and gigabytes for what a file of 100 MB can list."""
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        for number in range(20_000 if large else 14_000):
            archive.writestr(f"array-{number:06d}-{'x' * 20}.npy", b"")
    if large:  # the same in the form for more than 65 535 names, which says 0 in the usual place
        content = bytearray((tmp_path / "x.npz").read_bytes())
        at = content.rindex(b"PK\5\6")
        locator = struct.pack("<4sLQL", b"PK\6\7", 0, at, 1)
        content[at + 12 : at + 16] = bytes(4)
        (tmp_path / "x.npz").write_bytes(content[:at] + locator + content[at:])
    monkeypatch.setattr(zipfile, "ZipFile", None)
    with pytest.raises(InputError, match=r"x\.npz: found too many arrays"):
        load_arrays(tmp_path / "x.npz", SHAPES)


@each_case(
    "member",
    [
        b"",
        b"\x93NUMPY",
        b"\x93NUMPY\x01\x00\x10\x00" + b"(" * 16,
        b"\x93NUMPY\x01\x00\x0c\x00{'descr': 1}",
        b"\x93NUMPY\x09\x00" + b"\0" * 50,
        b"not an array at all, but long enough to be read as one",
    ],
)
def test_a_member_that_is_no_array_is_named(tmp_path: Path, member: bytes) -> None:
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("a.npy", member)
    with pytest.raises(InputError, match=r"x\.npz: array 'a': ") as caught:
        load_arrays(tmp_path / "x.npz", {"a": ("n",)})
    assert "\n" not in str(caught.value)


def test_every_truncation_and_flipped_byte_is_an_input_error_or_harmless(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, a=np.random.default_rng(1).random((20, 2)), b=np.arange(20))
    content, path, refused = bytearray(buffer.getvalue()), tmp_path / "x.npz", 0
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        with pytest.raises(InputError, match="truncated"):
            load_arrays(path, SHAPES)
    for place in range(0, len(content), 3):
        broken = content.copy()
        broken[place] ^= 0xFF
        path.write_bytes(broken)
        try:
            load_arrays(path, SHAPES)
        except InputError:
            refused += 1
    assert refused > len(content) / 3 / 2


def test_numbers_are_checked_for_kind_range_and_nan() -> None:
    path = Path("x.npz")
    with pytest.raises(InputError, match="'v': found <U1, expected numbers"):
        floats(path, "v", np.array(["a"]), finite=True)
    with pytest.raises(InputError, match="'v': found a value that is not finite"):
        floats(path, "v", np.array([np.nan]), finite=True)
    assert np.isnan(floats(path, "v", np.array([np.nan]), finite=False)).all()
    with pytest.raises(InputError, match="not finite"):
        floats(path, "v", np.array([np.inf]), finite=False)
    with pytest.raises(InputError, match="'v': found 5, expected 0 to 4"):
        integers(path, "v", np.array([0, 5]), below=5)
    with pytest.raises(InputError, match="'v': found -1, expected 0 to 4"):
        integers(path, "v", np.array([-1], dtype=np.int8), below=5)
    with pytest.raises(InputError, match="expected whole numbers"):
        integers(path, "v", np.array([0.5]), below=5)
