"""Messages come back from their bytes: fields, arrays, topics, and what a version keeps."""

from __future__ import annotations

import contextlib
import json
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cases import each_case
from tests.test_length import hooks

from e3pose.base.errors import InputError
from e3pose.model.camera_fields import check_camera_id
from e3pose.model.pose import Poses2D
from e3pose.wire.arrays import MAX_PERSONS, pack, pack_poses, poses_2d, unpack
from e3pose.wire.codec import MAX_BYTES, Message, decode, encode
from e3pose.wire.messages import (
    VERSION,
    Array,
    ClockAnswer,
    ClockQuestion,
    Heartbeat,
    Hello,
    Order,
    View,
)
from e3pose.wire.site_messages import CameraStatus, OutboxPart, Poses, Status
from e3pose.wire.topics import ANY, check_site, of_camera, sender

JOINTS = ("nose", "neck", "hip")


def view(people: int = 2, **changes: Any) -> View:
    rng = np.random.default_rng(1)
    keypoints = rng.uniform(0, 900, (people, 3, 2)).astype(np.float32)
    fields: dict[str, Any] = {
        "camera_id": "cam1",
        "session": 7,
        "slot": 12,
        "captured_edge_ns": 1_700_000_000_000_000_000,
        "keypoints_px": pack(keypoints),
        "scores": pack(rng.uniform(0.1, 1, (people, 3)).astype(np.float32)),
    }
    return View(**{**fields, **changes})


def poses() -> Poses:
    return Poses(
        slot=3,
        time_edge_ns=5,
        joints=JOINTS,
        track_ids=pack(np.array([4, 9])),
        joints_m=pack(np.ones((2, 3, 3), np.float32)),
        sigma_m=pack(np.full((2, 3), np.nan, np.float32)),
        measured=pack(np.array([[True, False, True]] * 2)),
    )


MESSAGES: list[Message] = [
    Hello("cam1", 7, JOINTS, (1920, 1080), 25.0, 0.4, "movenet", "0.1", 50.0),
    view(),
    view(people=0),
    Heartbeat("cam1", 7, 99, "active", power_w=4.5, energy_j=10.0, measured=True, battery_j=5.0),
    Order("cam1", 12, True, "aggressive-power-saving", 5, 40_000_000, 6, 8, 2),
    ClockQuestion("cam1", 12),
    ClockAnswer(12, 13, 14),
    poses(),
    OutboxPart(),
    Status("lab", 3, 25.0, 1, 2, (CameraStatus("cam1", True), CameraStatus("cam2", False, "dead"))),
]


@each_case("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_message_comes_back_equal(message: Message) -> None:
    assert decode(encode(message), type(message), "cam1") == message


@each_case("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_other_kind_is_refused(message: Message) -> None:
    other = Order if not isinstance(message, Order) else View
    with pytest.raises(InputError, match=rf"^cam1: message: found .*, expected {other.__name__}$"):
        decode(encode(message), other, "cam1")


def test_four_people_take_less_than_a_kilobyte() -> None:
    message = view(
        keypoints_px=pack(np.zeros((4, 17, 2), np.float32)),
        scores=pack(np.ones((4, 17), np.float32)),
    )
    assert len(encode(message)) < 1000


def test_newer_program_may_append_fields() -> None:
    body: list[Any] = msgspec.msgpack.decode(encode(ClockQuestion("cam1", 12)))
    body[1].append("a field of tomorrow")
    assert decode(msgspec.msgpack.encode(body), ClockQuestion, "x") == ClockQuestion("cam1", 12)


def test_other_version_says_what_to_do() -> None:
    payload = msgspec.msgpack.encode((VERSION + 1, ClockQuestion("cam1", 12)))
    with pytest.raises(InputError, match=f"found version {VERSION + 1}, expected {VERSION}: run"):
        decode(payload, ClockQuestion, "cam1")


def f4(*shape: int, value: float = 0.5) -> Array:
    return pack(np.full(shape, value, np.float32))


def status(camera: dict[str, Any] | None = None, **changes: Any) -> Status:
    cameras = (CameraStatus(**{"camera_id": "cam1", "online": True, **(camera or {})}),)
    fields: dict[str, Any] = {"slot": 3, "fps": 25.0, "lead": 1, "people": 2, "cameras": cameras}
    return Status("lab", **{**fields, **changes})


INF, NAN = float("inf"), float("nan")
WRONG: dict[str, tuple[Message, str]] = {
    "endless battery": (status({"battery": INF}), "camera cam1: battery: found inf"),
    "overfull battery": (status({"battery": 1.5}), "camera cam1: battery: found 1.5"),
    "no share": (status({"duty": NAN}), "camera cam1: duty: found nan"),
    "endless watts": (status({"power_w": INF}), "power_w: found inf, expected 0 to 1e+15"),
    "never seen again": (status({"last_seen_s": INF}), "camera cam1: last_seen_s"),
    "owes nothing": (status({"deficit": NAN}), "camera cam1: deficit"),
    "endless offset": (status({"clock_offset_ms": -INF}), "camera cam1: clock_offset_ms"),
    "views lost": (status({"lost": -1}), "camera cam1: lost: found -1"),
    "endless rate": (status(fps=INF), "fps: found inf"),
    "no lead": (status(lead=-1), "lead: found -1, expected 0 to 4611686018427387904"),
    "less than no slots": (status(blind={"views-late": 3, "no-view": -1}), "blind: found -1, exp"),
    "an event of nowhen": (status(events_ns=(5, -1)), "events_ns: found -1, expected 0 to"),
    "a camera of nowhere": (status({"lost": -1, "camera_id": "../x"}), "camera id"),
    "no people": (status(people=-(2**62)), "people: found"),
    "endless step": (status(step_ms=(1.0, INF)), "step_ms: found inf"),
    "no latency": (status(latency_ms=(NAN, 1.0)), "latency_ms: found nan"),
    "always up": (status(uptime_s=INF), "uptime_s: found inf"),
    "no error": (
        status(expected_error_mm=NAN),
        "expected_error_mm: found nan",
    ),
    "more than all slots": (status(slots_lost=-5), "slots_lost: found -5"),
    "too many cameras": (status(cameras=(CameraStatus("a", True),) * 1001), "cameras: found 1001"),
    "too many events": (status(events=("x",) * 1001), "events: found 1001"),
    "camera": (view(camera_id="../x"), "camera id"),
    "slot": (view(slot=-1), "slot: found -1"),
    "far slot": (view(slot=2**60), "slot: found"),
    "time": (view(captured_edge_ns=-5), "captured_edge_ns"),
    "score above one": (view(scores=f4(2, 3, value=1.5)), "scores: found one outside"),
    "score not a number": (view(scores=f4(2, 3, value=np.nan)), "scores: found one outside"),
    "other joints": (view(scores=f4(2, 4)), "keypoints: found f4"),
    "other people": (view(scores=f4(3, 3)), "keypoints: found f4"),
    "crowd": (view(scores=f4(300, 3), keypoints_px=f4(300, 3, 2)), "found 300 people"),
    "many joints": (view(scores=f4(2, 600), keypoints_px=f4(2, 600, 2)), "scores: found f4"),
    "infinite": (view(keypoints_px=f4(2, 3, 2, value=np.inf)), "beyond"),
    "double": (view(scores=pack(np.ones((2, 3)))), "scores: found f8"),
    "flat": (view(scores=f4(6)), "scores: found f4"),
    "short": (view(scores=Array("f4", (2, 3), b"1234")), "scores: found 4 bytes"),
    "lying shape": (view(scores=Array("f4", (-2, -3), b"")), "people"),
    "no joints": (Hello("cam1", 7, (), (10, 10), 25.0), "joints: found 0"),
    "no image": (Hello("cam1", 7, JOINTS, (0, 10), 25.0), "width"),
    "no rate": (Hello("cam1", 7, JOINTS, (10, 10), float("nan")), "fps"),
    "terminal codes": (Hello("cam1", 7, JOINTS, (10, 10), 25.0, 0, "\x1b[2J"), "printable"),
    "negative power": (Heartbeat("cam1", 7, 99, "active", power_w=-1.0), "power_w"),
    "endless text": (Heartbeat("cam1", 7, 99, "active", problem="x" * 501), "printable"),
    "no interval": (Order("cam1", 1, True, "power-saving", 5, 0, 6, 8), "interval_ns"),
}


@each_case("name", sorted(WRONG))
def test_wrong_field_is_named_in_one_line(name: str) -> None:
    message, sent = WRONG[name]
    with pytest.raises(InputError) as error:
        decode(encode(message), type(message), "cam1")
    assert sent in str(error.value) and "\n" not in str(error.value)


def test_text_that_is_none_after_a_number_out_of_bounds_is_refused() -> None:
    hello = Hello("cam1", 7, JOINTS, (1920, 1080), -1.0, 0.4, "movenet", "0.1", 50.0)
    payload = encode(hello)
    assert payload.count(b"movenet") == 1
    with pytest.raises(InputError, match="cam1: message"):
        decode(payload.replace(b"movenet", b"\xffovenet"), Hello, "cam1")


def test_huge_message_is_refused_unread() -> None:
    with pytest.raises(InputError, match="expected at most"):
        decode(b"\x00" * (MAX_BYTES + 1), View, "cam1")


@settings(max_examples=300)
@given(st.binary(max_size=300))
def test_garbage_is_an_input_error_or_nothing(payload: bytes) -> None:
    with pytest.raises(InputError):
        decode(payload, View, "cam1")


@settings(max_examples=300)
@given(st.data())
def test_flipped_byte_never_raises_anything_else(data: st.DataObject) -> None:
    payload = bytearray(encode(view()))
    place = data.draw(st.integers(0, len(payload) - 1))
    payload[place] = data.draw(st.integers(0, 255))
    with contextlib.suppress(InputError):
        poses_2d(decode(bytes(payload), View, "cam1"))


def test_missing_keypoint_is_nan_with_score_0() -> None:
    keypoints = np.full((1, 3, 2), 5, np.float32)
    keypoints[0, 0] = np.nan
    scores = np.array([[0.9, 0.0, 0.4]], np.float32)
    found = poses_2d(view(keypoints_px=pack(keypoints), scores=pack(scores)))
    assert found.scores.tolist() == [[0.0, 0.0, pytest.approx(0.4)]]
    assert np.isnan(found.keypoints_px[0, :2]).all() and (found.keypoints_px[0, 2] == 5).all()


@each_case("bits", [0x7F800001, 0xFFA00000, 0x7FC00000])
def test_every_kind_of_nan_is_a_missing_keypoint(bits: int) -> None:
    keypoints = np.full((1, 3, 2), 5, np.float32)
    keypoints.view(np.uint32)[0, 1, 0] = bits  # signalling ones too, of which NumPy warns
    sent = view(1, keypoints_px=pack(keypoints))
    found = poses_2d(decode(encode(sent), View, "cam1"))
    assert np.isnan(found.keypoints_px[0, 1]).all() and found.scores[0, 1] == 0
    assert (found.keypoints_px[0, [0, 2]] == 5).all()


@each_case("dtype", ["f4", "f8", "i8", "b1"])
def test_array_comes_back(dtype: str) -> None:
    array = (np.arange(24).reshape(2, 3, 4) % 2).astype(dtype)
    assert (unpack(pack(array[:, ::-1])) == array[:, ::-1]).all()
    with pytest.raises(InputError, match="int32"):
        pack(array.astype(np.int32))


def test_of_too_many_people_those_of_best_score_are_sent() -> None:
    people = MAX_PERSONS + 3
    rng = np.random.default_rng(1)
    scores = rng.permutation(np.linspace(0.1, 0.9, people))[:, None].repeat(2, axis=1)
    keypoints_px = np.arange(people, dtype=float)[:, None, None] + np.zeros((people, 2, 2))
    packed_px, packed = (unpack(each) for each in pack_poses(Poses2D(keypoints_px, scores)))
    best = np.argsort(-scores[:, 0])[:MAX_PERSONS]
    np.testing.assert_array_equal(packed_px[:, 0, 0], best)
    np.testing.assert_allclose(packed, scores[best], rtol=1e-6)


def test_sender_of_a_cameras_topic() -> None:
    assert sender(of_camera("lab", "cam1", "view")) == "cam1"
    assert of_camera("lab", ANY, "view") == "e3pose/lab/camera/*/view"


@each_case("name", ["", "*", "**", "a/b", "../x", "a b", "a$*", "-x", "x" * 65, "ü"])
def test_names_that_would_reach_elsewhere_do_not_enter(name: str) -> None:
    with pytest.raises(InputError, match="site"):
        check_site(name)
    with pytest.raises(InputError, match="camera id"):
        check_camera_id(name)
    with pytest.raises(InputError):
        sender(of_camera("lab", name, "view"))


@each_case("topic", ["e3pose/lab/order/cam1", "x/lab/camera/cam1/view", "", "/////"])
def test_topic_of_no_camera_has_no_sender(topic: str) -> None:
    with pytest.raises(InputError):
        sender(topic)


SHAPES = hooks.message_shapes()
MORE = f"more: int{hooks.OPTIONAL}"


def test_messages_of_a_version_only_grow() -> None:
    version, stored = json.loads(hooks.MESSAGE_SHAPES.read_text())
    assert version == VERSION, "python docs/hooks.py writes the fields of the new version"
    broken = hooks.broken_messages(stored, SHAPES)
    assert broken == [], "make VERSION one more, or keep the fields"
    assert stored == SHAPES, "python docs/hooks.py notes the new fields"


@each_case("name", sorted(SHAPES))
def test_fields_that_go_move_or_change_are_found(name: str) -> None:
    form, first, *rest = SHAPES[name]
    other = "array" if form == "map" else "map"
    gone, typed, needed = rest, [f"{first}?", *rest], [first, *rest, "more: int"]
    inserted, added = [MORE, first, *rest], [first, *rest, MORE]
    cases = [(other, [first, *rest]), (form, gone), (form, typed), (form, needed)]
    for form_now, fields in cases + [(form, inserted)] * (form != "map"):
        after = {**SHAPES, name: [form_now, *fields]}
        assert hooks.broken_messages(SHAPES, after) == [name], fields
    for fields in [added] + [inserted] * (form == "map"):
        assert hooks.broken_messages(SHAPES, {**SHAPES, name: [form, *fields]}) == [], fields
