"""The webhook: signed, tried again, bounded; what was not delivered is told."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.cases import each_case
from tests.ports import free_port
from tests.site.streams.test_streams import FELL, OF_AN_EVENT, WATCH, slot
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.model.skeleton import COCO17
from e3pose.settings.events_table import EventsTable
from e3pose.site.connect import Names, no_name
from e3pose.site.streams import Source, open_stream
from e3pose.site.streams.as_json import event_words
from e3pose.site.streams.webhook import (
    MAX_POSTS,
    MAX_WAITING,
    Notice,
    Notices,
    RetryPolicy,
    WebhookStream,
    address,
)
from e3pose.site.trial_notices import Answerer, send_test

HERE = Path(__file__).parent
PAGE = HERE.parents[2] / "docs" / "how-to" / "events.md"
SECRET = b"correct horse battery staple"
QUICK = RetryPolicy(answer_s=0.5, first_s=0.05, most_s=0.1, give_up_s=20.0)
IMPATIENT = replace(QUICK, give_up_s=0.3)


class Receiver:
    """A receiver in a process of its own, which can end and start again on its port."""

    def __init__(self, folder: Path) -> None:
        self.port, self.file = free_port(), folder / "received.jsonl"
        self.program: subprocess.Popen[bytes] | None = None

    def start(self, habit: str) -> None:
        words = [str(HERE / "receiver.py"), str(self.port), habit, str(self.file)]
        self.program = subprocess.Popen([sys.executable, *words])

    def end(self) -> None:
        if self.program is not None:
            self.program.kill()
            self.program.wait()

    def got(self) -> list[dict[str, Any]]:
        if not self.file.exists():
            return []
        return [json.loads(line) for line in self.file.read_text().splitlines()]


@pytest.fixture
def receiver(tmp_path: Path) -> Iterator[Receiver]:
    receiver = Receiver(tmp_path)
    yield receiver
    receiver.end()


@contextmanager
def sending(
    receiver: Receiver,
    retry: RetryPolicy = QUICK,
    told: EventsTable | None = None,
    names: Names = no_name,
) -> Iterator[tuple[WebhookStream, list[str]]]:
    said: list[str] = []
    source = Source(
        "lab", COCO17, 12.5, said.append, kinds=("fall",), told=told or EventsTable(), names=names
    )
    url = address(f"http://127.0.0.1:{receiver.port}/hook?room=2")
    stream = WebhookStream(url, SECRET, source, retry)
    try:
        yield stream, said
    finally:
        stream.close()


def checker() -> Callable[[bytes, str, bytes], bool]:
    """Return the receiver's check as the page shows it."""
    (code,) = re.findall(r"```python\n(import hashlib.*?)```", PAGE.read_text(), flags=re.S)
    names: dict[str, Any] = {}
    exec(code, names)
    return names["is_genuine"]  # type: ignore[no-any-return]


def test_notice_is_delivered_once_and_checked_as_the_page_says(receiver: Receiver) -> None:
    receiver.start("takes")
    with sending(receiver) as (stream, said):
        stream.slot(slot(7))
        stream.people(WATCH, [FELL, replace(FELL, kind="on-floor", phase="ended")])
        assert eventually(lambda: stream.delivered == 1)
    (one,) = receiver.got()
    assert one["path"] == "/hook?room=2"
    body = json.loads(one["body"])
    assert (body["site"], body["kind"], body["track"], body["zone"]) == ("lab", "fall", 7, "bed")
    assert set(body) == {*OF_AN_EVENT, "id", "site"} and body["name"] == ""
    assert body["sentence"].startswith("Person 7 fell") and "secret" not in one["body"].lower()
    genuine, sent = checker(), one["body"].encode()
    assert genuine(sent, one["signature"], SECRET)
    assert not genuine(sent.replace(b"7", b"8"), one["signature"], SECRET)
    assert not genuine(sent, one["signature"], SECRET + b"!")
    assert not genuine(sent, "t=1,v1=" + one["signature"].partition("v1=")[2], SECRET)
    assert not genuine(sent, "nonsense", SECRET)
    assert said[-1].endswith("1 notice delivered")


@pytest.mark.parametrize("habit", ["takes", "refuses"])
def test_the_page_tests_webhooks_and_is_told(
    receiver: Receiver, tmp_path: Path, habit: str
) -> None:
    site = tmp_path / "site.toml"
    with pytest.raises(InputError, match="no webhook is at work"):
        send_test(site, 0.3)
    receiver.start(habit)
    quiet = EventsTable(quiet="00:00-23:59")
    with sending(receiver, told=quiet) as (stream, _):
        answerer, ended = Answerer(site, [stream, object()]), threading.Event()
        answerer.update()
        assert answerer._thread is None, "the question is an old one"

        def answer() -> None:
            while not ended.wait(0.05):
                answerer.update()

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            assert eventually(lambda: "refused" not in stream.test())  # it has started
            before = len(receiver.got())
            (said,) = send_test(site)
        finally:
            ended.set()
            thread.join()
            answerer.close()
        assert stream.delivered == 0 and not stream.problem, "no event is counted"
    how = "delivered" if habit == "takes" else "not delivered (status 404)"
    assert said == f"webhook 127.0.0.1:{receiver.port}: test notice {how}"
    (one,) = receiver.got()[before:]
    body = json.loads(one["body"])
    assert body["kind"] == "test" and "nothing happened" in body["sentence"]
    assert checker()(one["body"].encode(), one["signature"], SECRET)
    assert not list((tmp_path / "stream-problems").glob("*.answer"))


def test_a_notice_has_the_name_of_the_moment_it_is_delivered(
    receiver: Receiver,
) -> None:
    known = {7: "Ada"}
    receiver.start("fails")
    with sending(receiver, names=lambda track: known.get(track, "")) as (stream, said):
        stream.people(WATCH, [FELL])
        assert eventually(lambda: bool(receiver.got())), "it was tried"
        assert eventually(lambda: "1 notice waiting" in stream.problem), stream.problem
        assert stream.problem.startswith("webhook 127.0.0.1") and "hook?" not in stream.problem
        tried = json.loads(receiver.got()[0]["body"])
        assert tried["name"] == "Ada" and tried["sentence"].startswith("Ada fell")
        known.clear()  # forgotten meanwhile
        receiver.end()
        receiver.start("takes")
        assert eventually(lambda: stream.delivered == 1 and not stream.problem)
    last = receiver.got()[-1]["body"]
    assert "Ada" not in last and json.loads(last)["id"] == tried["id"]
    assert not any("Ada" in line for line in said), "what is printed is kept"


def test_a_name_stays_with_somebody_whose_number_changed() -> None:
    changed = replace(FELL, track=12, first=7)
    assert event_words(changed, lambda track: "Ada" if track == 7 else "")["name"] == "Ada"
    assert event_words(changed, lambda track: "Bob" if track == 12 else "Ada")["name"] == "Bob"


@pytest.mark.parametrize("habit", ["fails", "hangs", "drips"])
def test_trouble_is_told_and_who_comes_back_gets_the_notice(receiver: Receiver, habit: str) -> None:
    receiver.start(habit)
    with sending(receiver) as (stream, said):
        stream.people(WATCH, [FELL])
        assert eventually(lambda: len(receiver.got()) >= 2), "tried again"
        receiver.end()
        assert stream.delivered == 0 and len(said) == 1 and "trying again" in said[0]
        receiver.start("talks")  # an answer without an end, which is not read
        assert eventually(lambda: stream.delivered == 1)
    assert len({json.loads(one["body"])["id"] for one in receiver.got()}) == 1
    assert "delivers again" in said[1] and said[2].endswith("1 notice delivered")


def test_a_fall_does_not_wait_for_a_notice_that_is_refused(receiver: Receiver) -> None:
    receiver.start("hates-waves")
    with sending(receiver, RetryPolicy(first_s=600.0, most_s=600.0)) as (stream, said):
        assert eventually(lambda: "refused" not in stream.test())  # it has started
        stream.people(WATCH, [replace(FELL, kind="waved", phase="ended", says="waved")])
        assert eventually(lambda: "status 500" in stream.problem)
        stream.people(WATCH, [FELL])
        assert eventually(lambda: stream.delivered == 1), "the first waits for ten minutes"
        assert "1 notice waiting" in stream.problem, "one that is delivered hides no other"
    assert "Person 7 waved" in said[-2] and said[-2].endswith(" attempts)"), said


@given(
    st.lists(
        st.tuples(
            st.floats(0, 300),  # when it is reported
            st.booleans(),  # urgent
            st.sampled_from(["takes", "fails", "hangs", "refuses"]),
        ),
        max_size=2 * MAX_WAITING,
    )
)
def test_every_notice_is_tried_at_once_whatever_others_do(
    told: list[tuple[float, bool, str]],
) -> None:
    """A clock moved by hand, in steps of a second; an attempt takes as long as its policy lets."""
    notices, habits, under_way = Notices(RetryPolicy()), dict[Notice, str](), list[Any]()
    told, given_up, now_s = sorted(told), 0, 0.0
    while told or notices.waiting or under_way:
        for end_s, notice in [one for one in under_way if one[0] <= now_s]:
            under_way.remove((end_s, notice))
            if notice in notices.waiting:
                habit = habits[notice]
                given_up += not notices.tried(
                    notice, habit != "takes", habit != "refuses", now_s
                ) and habit in ("fails", "hangs")
                assert notice.attempts <= 40, "bounded"
        while told and told[0][0] <= now_s:
            _, urgent, habit = told.pop(0)
            out = notices.add(FELL, urgent, now_s)
            habits[out if out is not None and out not in habits else notices.waiting[-1]] = habit
            assert out is None or not urgent or out.urgent <= urgent
        for notice in notices.due(now_s, MAX_POSTS - len(under_way)):
            under_way.append((now_s + 10.0 * (habits[notice] == "hangs"), notice))
        for notice in notices.waiting:
            assert notice.attempts or now_s - notice.since_s < 2.0
        assert len(notices.waiting) <= MAX_WAITING and len(under_way) <= MAX_POSTS
        now_s += 1.0
        assert now_s < 2000.0, "every notice ends"


def test_urgent_notices_are_tried_first_and_kept_longest() -> None:
    notices = Notices(RetryPolicy())
    for urgent in (False, True):
        notices.add(FELL, urgent, 0.0)
    assert [one.urgent for one in notices.due(0.0, room=1)] == [True]
    for _ in range(MAX_WAITING):
        notices.add(FELL, True, 1.0)
    out = notices.add(FELL, False, 2.0)
    assert out is not None and (out.urgent, out.since_s) == (False, 2.0)


def test_notice_waits_for_a_receiver_that_is_not_there_yet(receiver: Receiver) -> None:
    with sending(receiver) as (stream, said):
        stream.people(WATCH, [FELL])
        assert eventually(lambda: "refused" in "".join(said))
        receiver.start("slow")
        assert eventually(lambda: len(receiver.got()) >= 1)
        receiver.end()
        receiver.start("takes")
        assert eventually(lambda: stream.delivered == 1)


@pytest.mark.parametrize(("habit", "status"), [("redirects", "307"), ("refuses", "404")])
def test_final_answer_is_not_asked_again(receiver: Receiver, habit: str, status: str) -> None:
    receiver.start(habit)
    with sending(receiver) as (stream, said):
        stream.people(WATCH, [FELL])
        assert eventually(lambda: stream.given_up == 1)
    assert [one["path"] for one in receiver.got()] == ["/hook?room=2"]
    assert f"not delivered (status {status}): Person 7 fell" in "".join(said)


def test_what_cannot_be_delivered_is_given_up_and_told(receiver: Receiver) -> None:
    with sending(receiver, IMPATIENT) as (stream, said):
        stream.people(WATCH, [FELL])
        assert eventually(lambda: stream.given_up == 1)
        stream.people(WATCH, [replace(FELL, track=8)])
        assert eventually(lambda: stream.given_up == 2)
    assert any("refused): Person 8 fell" in line for line in said)
    assert said[-1].endswith("0 notices delivered, 2 not delivered")


def test_what_waits_is_bounded_and_lost_at_the_end_with_a_line_each(receiver: Receiver) -> None:
    with sending(receiver) as (stream, said):
        for track in range(MAX_WAITING + 3):
            stream.people(WATCH, [replace(FELL, track=track)])
        assert stream.given_up == 3
    assert stream.given_up == MAX_WAITING + 3
    assert sum("not delivered (" in line for line in said) == MAX_WAITING + 3


def test_quiet_hours_keep_what_is_not_urgent(receiver: Receiver) -> None:
    receiver.start("takes")
    with sending(receiver, told=EventsTable(quiet="00:00-23:59")) as (stream, said):
        stream.people(WATCH, [replace(FELL, kind="waved", phase="ended"), FELL])
        assert eventually(lambda: stream.delivered == 1)
    assert [json.loads(one["body"])["kind"] for one in receiver.got()] == ["fall"]
    assert said[-1].endswith("1 notice delivered, 1 not sent in quiet hours")


@each_case(
    ("hours", "at", "quiet"),
    [
        ("", (3, 0), False), ("22:00-06:30", (22, 0), True), ("22:00-06:30", (6, 29), True),
        ("22:00-06:30", (6, 30), False), ("13:00-15:00", (14, 59), True),
        ("13:00-15:00", (15, 0), False), ("13:00-15:00", (12, 59), False),
    ],
)  # fmt: skip
def test_quiet_hours_may_go_over_midnight(hours: str, at: tuple[int, int], quiet: bool) -> None:
    assert EventsTable(quiet=hours).is_quiet(*at) is quiet


@each_case(
    "place", ["example.org", "ftp://example.org/", "https://", "https://a:b@example.org/",
              "https://example.org:port/", "https://example.org/a b",
              "https://example.org/\r\nX: y"],
)  # fmt: skip
def test_address_that_is_none_is_refused(place: str) -> None:
    with pytest.raises(InputError, match="expected webhook:https://HOST/PATH"):
        address(place)


def test_secret_comes_from_a_file_of_its_owner_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    source = Source("lab", COCO17, 12.5, said.append, kinds=("fall",))
    target, file = "webhook:http://192.0.2.1/hook", tmp_path / "secret"
    with pytest.raises(InputError, match="E3POSE_WEBHOOK_SECRET_FILE"):
        open_stream(target, source)
    monkeypatch.setenv("E3POSE_WEBHOOK_SECRET_FILE", str(file))
    with pytest.raises(InputError, match="expected a file that its owner alone"):
        open_stream(target, source)
    file.write_text("short\n")
    file.chmod(0o644)
    with pytest.raises(InputError, match="which others can read"):
        open_stream(target, source)
    file.chmod(0o600)
    with pytest.raises(InputError, match="found 5 characters"):
        open_stream(target, source)
    file.write_bytes(SECRET + b"\n")
    open_stream(target, source).close()
    assert "anybody on the way can read it" in said[0]
    with pytest.raises(InputError, match="no \\[events\\]"):
        open_stream(target, Source("lab", COCO17, 12.5))
