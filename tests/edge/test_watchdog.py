"""An edge rejoins its network when it is useless, and not when its cameras are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.edge.housekeeping import (
    CALM_S,
    LONGEST_WAIT_S,
    MAX_BYTES,
    MAX_FILES,
    STALL_S,
    WAIT_S,
    CameraSigns,
    StallWatch,
    dump_stacks,
    watch_for_stall,
)

LOOK_S = 0.5  # as often as heartbeats come
WELL = CameraSigns(True, 0, True, session=7, orders=100, sent=50, views=50, due=50)
Step = Callable[[CameraSigns], CameraSigns]


def works(camera: CameraSigns) -> CameraSigns:
    """Return a camera after half a second of 20 slots per second, every second one ordered."""
    return replace(
        camera,
        orders=camera.orders + 10,
        sent=camera.sent + 5,
        views=camera.views + 5,
        due=camera.due + 5,
    )


def deaf(camera: CameraSigns) -> CameraSigns:
    """Return a camera that received no order."""
    return replace(camera, due=camera.due + 5)


def unheard(camera: CameraSigns) -> CameraSigns:
    """Return a camera whose views were lost."""
    return replace(works(camera), views=camera.views)


def hung(camera: CameraSigns) -> CameraSigns:
    """Return a camera that received its orders, and whose detector hangs."""
    return replace(works(camera), views=camera.views, sent=camera.sent)


def slow(camera: CameraSigns) -> CameraSigns:
    """Return a camera that answers one order in forty."""
    one = (camera.orders // 10) % 8 == 0
    return replace(works(camera), views=camera.views + one, sent=camera.sent + one)


def asleep(camera: CameraSigns) -> CameraSigns:
    """Return a camera that was not ordered to detect."""
    return replace(camera, orders=camera.orders + 10)


def frozen(camera: CameraSigns) -> CameraSigns:
    """Return a camera that is connected and says nothing."""
    return replace(camera, fresh=False)


def gone(camera: CameraSigns) -> CameraSigns:
    """Return a camera that is not connected."""
    return replace(camera, fresh=False, present=False)


def alarms(
    steps: list[Step],
    seconds: float,
    watch: StallWatch | None = None,
    begin_s: float = 100.0,
    camera: CameraSigns = WELL,
) -> list[tuple[float, str]]:
    """Return when an alarm was raised while cameras did these things, seconds from the begin."""
    cameras = [replace(camera, heard_ns=round(begin_s * 1e9)) for _ in steps]
    watch, found, slots = watch or StallWatch(), [], 1000
    for number in range(round(seconds / LOOK_S)):
        now_ns = round((begin_s + number * LOOK_S) * 1e9)
        watch, why = watch_for_stall(watch, cameras, slots, None, now_ns)
        if why:
            found.append((number * LOOK_S, why))
        cameras = [step(camera) for step, camera in zip(steps, cameras, strict=True)]
        cameras = [replace(c, heard_ns=now_ns) if c.fresh else c for c in cameras]
        slots += 10
    return found


@each_case(
    ("step", "why"),
    [
        (deaf, "orders do not reach"),
        (unheard, "views do not arrive"),
        (frozen, "nothing arrives from cameras that are connected"),
    ],
)
@each_case("cameras", [1, 2, 5])
def test_useless_edge_is_noticed_within_four_seconds(step: Step, why: str, cameras: int) -> None:
    [(at_s, found), *_] = alarms([step] * cameras, 8.0)
    assert found.startswith(why)
    assert STALL_S <= at_s <= STALL_S + 2 * LOOK_S


@pytest.mark.parametrize("cameras", [1, 3])
def test_views_that_a_heartbeat_counts_after_they_came_are_not_lost(cameras: int) -> None:
    """The last views before orders are lost are counted by the next heartbeat only."""
    seen = 0

    def last_views(camera: CameraSigns) -> CameraSigns:
        nonlocal seen
        seen += 1
        late = replace(deaf(camera), sent=camera.sent + 5, orders=camera.orders + 10)
        return late if seen <= cameras else deaf(camera)

    ahead = replace(WELL, sent=WELL.sent - 5)  # of what its heartbeats have counted
    [(at_s, found), *_] = alarms([last_views] * cameras, 8.0, camera=ahead)
    assert found.startswith("orders do not reach") and at_s <= STALL_S + 3 * LOOK_S


@each_case("step", [works, hung, slow, asleep, gone])
@each_case("others", [[], [works], [hung, gone], [asleep, slow, works]])
def test_cameras_that_are_useless_themselves_are_no_reason(step: Step, others: list[Step]) -> None:
    assert alarms([step, *others], 60.0) == []


@each_case("step", [deaf, unheard, frozen])
def test_minority_of_cameras_can_neither_claim_nor_hide_it(step: Step) -> None:
    assert alarms([step, works], 60.0) == []
    assert alarms([step, step, works, works], 60.0) == []
    assert alarms([deaf, deaf, works], 8.0)


def test_camera_program_that_counts_nothing_is_no_reason() -> None:
    silent = replace(WELL, orders=0, sent=0)
    watch, why = StallWatch(), ""
    for number in range(100):
        camera = replace(silent, due=10 * number, heard_ns=round(number * 5e8))
        watch, why = watch_for_stall(watch, [camera], 10 * number, None, round(number * 5e8))
        assert not why


def test_message_that_cannot_be_sent_is_noticed() -> None:
    now_ns = round(100e9)
    for since_s, expected in ((STALL_S - 0.1, ""), (STALL_S, "a message could not be sent")):
        sending_ns, camera = now_ns - round(since_s * 1e9), replace(WELL, heard_ns=now_ns)
        assert watch_for_stall(StallWatch(), [camera], 0, sending_ns, now_ns)[1] == expected


def test_restarted_camera_begins_anew() -> None:
    watch, _ = watch_for_stall(StallWatch(), [WELL], 0, None, 0)
    again = replace(WELL, session=8, orders=0, sent=0, heard_ns=round(10e9))
    assert watch_for_stall(watch, [again], 100, None, round(10e9))[1] == ""


@each_case("away_s", [STALL_S, 5.0, 600.0])
def test_suspended_machine_is_no_reason(away_s: float) -> None:
    camera, watch = replace(WELL, heard_ns=round(100e9)), StallWatch()
    for second in range(20):
        now_s = 100.0 + second + away_s * (second >= 10)
        watch, why = watch_for_stall(watch, [camera] * 3, 100 * second, None, round(now_s * 1e9))
        assert not why
        camera = replace(works(camera), heard_ns=round(now_s * 1e9))
        if second >= 9:  # its next heartbeats have yet to come
            camera = replace(camera, orders=camera.orders - 10 * (second < 11))


def test_alarms_that_do_not_help_become_rare() -> None:
    times_s = [at_s for at_s, _ in alarms([deaf] * 3, 3000.0)]
    pauses_s = [b - a for a, b in pairwise(times_s)]
    assert pauses_s[:3] == pytest.approx([WAIT_S, 2 * WAIT_S, 4 * WAIT_S], abs=STALL_S + LOOK_S)
    assert max(pauses_s) <= LONGEST_WAIT_S + STALL_S + LOOK_S
    assert len(times_s) < 12


def test_alarm_after_a_calm_time_is_as_the_first() -> None:
    watch = StallWatch((), due_ns=0, wait_s=LONGEST_WAIT_S)
    now_ns = round(CALM_S * 1e9)
    watch, _ = watch_for_stall(watch, [replace(WELL, heard_ns=now_ns)], 0, None, now_ns)
    assert watch.wait_s == WAIT_S


def test_stacks_take_a_bounded_space(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    paths = [dump_stacks(folder, "edge") for _ in range(2 * MAX_FILES)]
    assert len(set(paths)) == len(list(folder.iterdir())) == MAX_FILES
    assert "test_stacks_take_a_bounded_space" in paths[-1].read_text()
    assert paths[-1].stat().st_size <= MAX_BYTES and paths[-1].stat().st_mode & 0o077 == 0
