"""Whatever becomes of what a site writes to, it goes on: each channel of the page has its tests."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from pathlib import Path

import pytest
from tests.edge.one_process import Site, scene, site_at_work
from tests.live.processes import as_root
from tests.live.test_full_disk import SIZE, fill
from tests.waiting import eventually

from e3pose.edge import recorder as recording
from e3pose.edge.checkpoint import load_checkpoint
from e3pose.edge.consumers import Consumers
from e3pose.edge.events import EventLog
from e3pose.edge.recorder import Recorder, RecorderSettings
from e3pose.store import Run, Store, StoreWriter, WriterSettings

pytestmark = pytest.mark.slow
resource = pytest.importorskip("resource", reason="no limits of processes here")

TESTS = Path(__file__).parents[1]
PAGE = TESTS.parent / "docs" / "explanation" / "channels.md"
HERE = "site/test_channels::test_site_goes_on_where_no_file_takes_anything"
FULL, CODES = "live/test_full_disk::test_", "cli/test_exit_codes::test_"
EVERY = "live/test_channel_faults::test_every_program_outlasts_its_channels"
LOG, FAULTS = "base/test_log_stream::test_", "store/test_store_faults::test_"
# Channels as the page names them, and the tests that show what it says of each.
SHOWN = {
    "standard output and error, `logs/*.log`": (
        f"{LOG}lines_that_a_full_disk_drops_are_counted_once_there_is_room",
        f"{LOG}reader_that_reads_nothing_holds_nobody_up",
        f"{LOG}reader_that_went_away_is_no_error",
        f"{FULL}up_runs_where_no_file_can_grow_and_nothing_can_be_said",
        EVERY,
        "base/test_masking::test_secrets_of_an_address_are_masked",
    ),
    "log that cannot be opened": (
        "site/test_up::test_program_whose_log_cannot_be_opened_runs_without_one",
    ),
    "state (`state.npz`)": (
        HERE,
        f"{CODES}disk_that_is_full_from_the_start_is_no_refused_input",
    ),
    "store, SQLite": (
        HERE, f"{FAULTS}full_disk_goes_to_the_spool_and_comes_back",
        f"{FAULTS}full_queue_sheds_and_says_so",
    ),
    "store, PostgreSQL": (
        "store/test_hanging_server::test_nothing_is_lost_while_a_server_answers_nothing",
        "store/test_postgres::test_password_is_in_no_message",
    ),
    "spool": (
        HERE, f"{FAULTS}spool_is_bounded_and_keeps_the_newest",
        f"{FAULTS}disk_that_turns_read_only_goes_to_memory_and_comes_back",
    ),
    "locks (`.state.npz.lock`)": (
        "base/test_lock::test_a_folder_where_nothing_may_be_written_is_no_lock",
        "base/test_lock::test_lock_on_a_disk_that_turned_read_only_stays_and_ends_nothing",
    ),
    "recordings of a live site": (
        HERE, "edge/test_recorder::test_full_disk_costs_no_slot_that_the_queue_holds",
        "edge/test_recorder::test_slots_beyond_the_queue_are_counted",
    ),
    "MCAP file of `e3pose stream`": (
        "site/streams/test_streams::test_mcap_on_a_full_disk_says_so_and_leaves_what_it_took",
        EVERY,
    ),
    "recording of `e3pose record`": (f"{FULL}record_keeps_what_a_disk_took_before_it_was_full",),
    "videos of cameras": (
        "camera/test_video_recorder::test_full_disk_is_reported_and_tried_again",
        "camera/test_video_recorder::test_slow_disk_loses_frames_of_the_video_and_never_waits",
    ),
    "battery charge": (
        "energy/meters/test_charge_file::test_place_that_cannot_be_written_is_reported_once",
    ),
    "compiled kernels": ("base/test_kernel::test_full_disk_keeps_no_kernel_and_stops_none",),
    "learning folder": (
        "edge/learn/test_learner_faults::test_a_full_disk_loses_poses_and_nothing_else",
        "edge/learn/test_learner_faults::test_a_disk_that_never_answers_fills_no_memory",
    ),
    "stacks of a stalled edge": ("edge/test_watchdog::test_stacks_take_a_bounded_space",),
    "files that the page makes": (
        "site/web/test_keep::test_folder_disk_and_queue_are_bounded",
        "site/web/test_keep::test_a_folder_that_cannot_be_written_is_told",
    ),
    "keys, tokens, site file": (
        "wire/keys/test_renewal::"
        "test_command_that_is_killed_leaves_whole_pairs_and_can_be_repeated",
    ),
    "database of a hub": (
        f"{CODES}database_that_cannot_grow_is_a_fault",
        "hub/test_hub::test_full_disk_at_the_hub_is_told_and_nothing_is_lost",
        EVERY,
    ),
    "measured speeds, problems of streams": (
        "site/test_stream_problems::test_a_folder_that_cannot_be_written_stops_no_stream",
    ),
    "port of the edge, the metrics, a page": (
        "site/web/test_program::test_default_port_that_is_taken_gives_way_to_the_next_free_one",
        "wire/test_network::test_port_that_is_taken_is_reported_with_what_to_do",
    ),
    "network between the programs": (
        "wire/test_network::test_edge_that_comes_back_is_found_again",
        "edge/test_publisher::test_what_nobody_takes_does_not_grow",
        "edge/test_publisher::test_later_sender_takes_over_from_one_that_hangs",
    ),
    "standard input of a program of `up`": (
        "site/test_run::test_program_ends_with_its_parent_cleanly_or_soon",
    ),
    "closed standard input, output or error": (
        f"{CODES}closed_descriptors_change_no_code",
        EVERY,
        f"{FULL}up_runs_where_no_file_can_grow_and_nothing_can_be_said",
    ),
    "pipes of programs that make files or learn": (
        "edge/learn/test_learner_faults::test_a_trainer_that_hangs_is_ended",
        "site/web/test_keep::test_what_grows_too_large_is_ended",
    ),
    "webhooks, brokers and other targets of `stream`": (
        "site/streams/test_webhook::"
        "test_what_waits_is_bounded_and_lost_at_the_end_with_a_line_each",
        "site/streams/test_mqtt::test_wrong_password_is_reported_and_not_said",
        "cli/test_streaming::test_target_that_is_away_keeps_no_other_from_its_slots",
        "cli/test_streaming::test_target_that_comes_back_gets_slots",
    ),
    "argument lists": (
        "live/test_planted_secrets::test_no_output_of_a_run_holds_a_password_of_a_camera",
    ),
    "environment": (
        "site/streams/test_webhook::test_secret_comes_from_a_file_of_its_owner_alone",
    ),
    "threads of an edge or a camera": (f"{CODES}fault_while_it_runs_is_no_refused_input",),
}  # fmt: skip


def test_page_and_tests_have_the_same_channels() -> None:
    rows = re.findall(r"^\| (.+?) \|", PAGE.read_text(), re.MULTILINE)
    named = {re.sub(r" \(`E3POSE.*", "", row) for row in rows} - {"channel"}
    assert named == set(SHOWN)


def test_what_shows_a_channel_is_a_test() -> None:
    for channel, shown in SHOWN.items():
        assert shown, channel
        for place in shown:
            module, name = place.split("::")
            tree = ast.parse((TESTS / f"{module}.py").read_text())
            assert name in {each.name for each in tree.body if isinstance(each, ast.FunctionDef)}


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder, on a disk of its own where this machine lets us have one."""
    folder = tmp_path_factory.mktemp("disk")
    with ExitStack() as stack:
        try:
            as_root("mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(folder))
            stack.callback(as_root, "umount", "-l", str(folder))
        except pytest.skip.Exception:
            pass
        yield folder


@pytest.fixture(scope="module")
def site(disk: Path) -> Iterator[Site]:
    """A site that stores, records and keeps its state."""
    seen, rig = scene(), scene().rig
    run = Run("lab", "lab", 1, seen.interval_s, "coco17", seen.skeleton.joints, rig.camera_ids)
    wanted = RecorderSettings(
        disk / "recordings", "lab", [True] * len(rig), 20.0, 1.0, seen.skeleton, ""
    )
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.setattr(recording, "RETRY_S", 0.5)

        def consume(log: EventLog) -> Consumers:
            settings = WriterSettings(commit_s=0.1)
            sink = stack.enter_context(StoreWriter(disk / "live.db", run, settings, log.add))
            recorder = Recorder(wanted, rig, log.report)
            stack.callback(recorder.close)
            return Consumers(sink=sink, recorder=recorder)

        yield stack.enter_context(site_at_work(disk, consume=consume))


@contextmanager
def limit(_: Path) -> Iterator[Callable[[], object]]:
    """Let no file of this process grow, as `RLIMIT_FSIZE` does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield lambda: None
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@contextmanager
def full_disk(disk: Path) -> Iterator[Callable[[], object]]:
    """Leave no byte free; yield what takes room that was given back."""
    if not disk.is_mount():
        pytest.skip("no disk of its own here: it needs root")
    fill(disk / "filler")
    try:
        yield partial(fill, disk / "filler")
    finally:
        (disk / "filler").unlink()


@pytest.mark.parametrize("fault", [limit, full_disk])
def test_site_goes_on_where_no_file_takes_anything(
    fault: Callable[[Path], AbstractContextManager[Callable[[], object]]], site: Site, disk: Path
) -> None:
    def said(since: int = len(site.events)) -> Counter[str]:
        kinds = [event.kind for event in site.events[since:]]
        return Counter("store-full" if kind == "store-trouble" else kind for kind in kinds)

    def saved() -> int:
        return load_checkpoint(disk / "state.npz", site.edge.pipeline).state.slot

    troubles = {"store-full", "checkpoint", "record-trouble"}
    assert eventually(lambda: (disk / "state.npz").exists() and saved() > 0)
    lost, first = site.edge.status().slots_lost, site.poses[-1].slot
    with fault(disk) as again:
        assert eventually(lambda: "checkpoint" in said() or again()), said()
        assert eventually(lambda: troubles <= set(said())), (said(), site.events[-9:])
        kept = (disk / "state.npz").read_bytes()
        count = len(site.poses)
        assert eventually(lambda: len(site.poses) > count + 50)
        assert all(said()[kind] == 1 for kind in troubles), said()  # once, not once a second
        assert (disk / "state.npz").read_bytes() == kept
        assert saved() > 0
    back = {"store-recovered", "record-recovered"}
    assert eventually(lambda: back <= set(said()) and said()["checkpoint"] == 2), said()
    last = site.poses[-1].slot
    sink, recorder = site.edge.consumers.sink, site.edge.consumers.recorder
    assert sink is not None and recorder is not None
    assert eventually(lambda: sink.status().acknowledged_slot >= last)
    stored = {row["slot"] for row in Store(disk / "live.db").rows("slots")}
    assert {poses.slot for poses in site.poses if first <= poses.slot <= last} <= stored
    assert site.edge.status().slots_lost == lost and sink.status().shed == recorder.dropped == 0
    assert all(said()[kind] == 1 for kind in (troubles | back) - {"checkpoint"}), said()
