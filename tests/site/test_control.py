"""Control of an edge: what operators ask for is used from the next slot, or refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import cast

import pytest
from tests.cases import each_case
from tests.manual_clock import ManualClock
from tests.memory_transport import Hub
from tests.rigs import looking
from tests.site.left_by_site import nobody
from tests.site.tables import HEAD, resolved_site, write_site

from e3pose.base.errors import InputError
from e3pose.edge.camera_state import State
from e3pose.edge.consumers import NOTHING_ASKED, Consumers
from e3pose.edge.pipeline_owner import PipelineOwner
from e3pose.edge.server import EdgeServer
from e3pose.pipeline import Pipeline, SlotRecord
from e3pose.select.policies.information import Information
from e3pose.site.control import BURST, COUNT_S, TOO_MANY, SiteControls
from e3pose.site.edge_program import check_edge, make_edge
from e3pose.site.event_sink import EventSink
from e3pose.store import Retention
from e3pose.wire.codec import decode, encode
from e3pose.wire.site_messages import Control, Controlled

RIG = looking((4, 0), (0, 4), (-4, 0), (0, -4))


@contextmanager
def edge(folder: Path, more: str = "") -> Iterator[tuple[EdgeServer, Hub]]:
    """Yield an edge that was made and not started, and the air around it."""
    live, hub = resolved_site(folder, RIG, more), Hub()
    with ExitStack() as stack:
        parts, clock = check_edge(live), ManualClock(10**18)
        made = make_edge(live, parts, hub.join(), clock, lambda _: None, stack)
        made.consumers.listen(made.membership.transport, "lab")
        yield made, hub


def controls(made: EdgeServer) -> SiteControls:
    assert isinstance(made.consumers.controls, SiteControls)
    return made.consumers.controls


def next_pipeline(consumers: Consumers, pipeline: Pipeline) -> tuple[Pipeline, list[str]]:
    """Return the pipeline of the next slot and the messages, without a learner."""
    owner = PipelineOwner(pipeline)
    events = owner.after_slot(consumers, cast("SlotRecord", None))
    return owner.pipeline, [line for kind, line, _ in events if kind == "control"]


def policy(pipeline: Pipeline) -> Information:
    assert isinstance(pipeline.policy, Information)
    return pipeline.policy


def test_number_of_cameras_and_its_budget_change_with_the_next_slot(tmp_path: Path) -> None:
    with edge(tmp_path) as (made, hub):
        status = made.status()
        assert (status.num_selected, status.target_error_mm) == (2, None)
        assert status.quality_weight == 10 and status.cameras[0].budget == pytest.approx(0.7)
        before, _ = next_pipeline(made.consumers, made.pipeline)
        assert policy(before).num_selected == 2 and before.queue.budget.tolist() == [0.7] * 4
        answer = hub.join().ask("e3pose/lab/control/desk", encode(Control(cameras=3)), 1.0)
        assert answer is not None
        assert decode(answer, Controlled, "edge") == Controlled(said="3 cameras per slot")
        after, messages = next_pipeline(made.consumers, before)
        assert policy(after).num_selected == 3 and messages == ["3 cameras per slot"]
        assert after.queue.budget.tolist() == [0.95] * 4
        assert next_pipeline(made.consumers, after) == (after, [])
        answer = hub.join().ask("e3pose/lab/control/desk", b"garbage", 1.0)
        assert answer is not None and decode(answer, Controlled, "edge").problem


def test_target_replaces_the_number_and_a_paused_camera_is_left_out(tmp_path: Path) -> None:
    with edge(tmp_path) as (made, _):
        asked = controls(made)
        asked.take(Control(target_error_mm=40, quality_weight=3))
        pipeline, messages = next_pipeline(made.consumers, made.pipeline)
        assert policy(pipeline).target_error_m == 0.04 and policy(pipeline).quality_weight == 3
        assert messages == ["target error 40 mm, quality weight 3"]
        asked.take(Control(cameras=1.5))
        pipeline, _ = next_pipeline(made.consumers, pipeline)
        found = policy(pipeline)
        assert (found.target_error_m, found.num_selected, found.quality_weight) == (None, 1.5, 3)
        # Paused camera is left out until it is resumed.
        assert controls(made).take(Control(camera_id="c1", paused=True)) == "c1: paused"
        assert made.inbox.problems()[1] == "paused" and made.inbox.states()[1] == State.BARRED
        status = made.status().cameras
        assert [camera.paused for camera in status] == [False, True, False, False]
        controls(made).take(Control(camera_id="c1", paused=False))
        assert made.inbox.problems()[1] == "never connected"


def test_budget_of_a_camera_is_its_own_and_stays(tmp_path: Path) -> None:
    with edge(tmp_path, '[[camera]]\nid = "c2"\nbudget = "90%"\n') as (made, _):
        controls(made).take(Control(camera_id="c1", budget="30%"))
        pipeline, messages = next_pipeline(made.consumers, made.pipeline)
        assert pipeline.queue.budget.round(3).tolist() == [0.7, 0.3, 0.9, 0.7]
        assert messages == ["c1: budget 30%"]
        controls(made).take(Control(cameras=1))
        pipeline, _ = next_pipeline(made.consumers, pipeline)
        assert pipeline.queue.budget.round(3).tolist() == [0.45, 0.3, 0.9, 0.45]


@each_case(
    ("control", "messages"),
    [
        (Control(), "control: found nothing to change"),
        (Control(cameras=9), "cameras: found 9 per slot"),
        (Control(cameras=0), "cameras: found 0 per slot"),
        (
            Control(cameras=2, target_error_mm=40),
            "target_error_mm: found a number of cameras as well",
        ),
        (Control(target_error_mm=5000), "target_error: found 5000 mm"),
        (Control(camera_id="c9", paused=True), "camera_id: found c9, expected one of c0"),
        (Control(camera_id="c1", cameras=2), "camera_id: found with a setting of the site"),
        (Control(camera_id="c1", budget="much"), "budget: found 'much'"),
        (Control(paused=True), "camera_id: found none"),
    ],
)
def test_what_cannot_be_had_changes_nothing(
    tmp_path: Path, control: Control, messages: str
) -> None:
    with edge(tmp_path) as (made, hub):
        with pytest.raises(InputError, match=messages):
            controls(made).take(control)
        answer = hub.join().ask("e3pose/lab/control/desk", encode(control), 1.0)
        assert answer is not None and messages in decode(answer, Controlled, "edge").problem
        assert controls(made).applied() == NOTHING_ASKED
        assert not controls(made).paused


def test_policy_without_a_number_cannot_be_given_one(tmp_path: Path) -> None:
    with edge(tmp_path, '[loop]\npolicy = "all"\n') as (made, _):
        with pytest.raises(InputError, match="which has no number of cameras"):
            controls(made).take(Control(cameras=2))
        assert made.status().num_selected is None


def test_operators_who_flood_are_refused_each_and_together(tmp_path: Path) -> None:
    with edge(tmp_path) as (made, _):
        now_s = [0.0]
        asked = SiteControls(controls(made)._site, None, lambda: now_s[0])

        def ask(operator: str) -> str:
            answer = asked.answer(operator, encode(Control(cameras=3)))
            return decode(answer, Controlled, "edge").problem

        problems = [ask("desk") for _ in range(2000)]
        assert problems[: int(BURST)] == [""] * int(BURST)
        assert all("more than 2 requests per second" in one for one in problems[int(BURST) :])
        assert ask("hall") == ""  # another operator is heard
        lines = asked.applied().lines
        assert len(lines) == BURST + 1
        now_s[0] = COUNT_S
        assert asked.applied().lines == [
            "1980 requests refused, most of operator desk: too many per second"
        ]
        assert not asked.applied().lines and ask("desk") == ""
        # Many names of operators have a rate together.
        request = encode(Control(cameras=3))
        answers = [controls(made).answer(f"desk{i}", request) for i in range(500)]
        assert 400 < answers.count(TOO_MANY) < 500


ZONE = '[[zone]]\nname = "door"\ncorners = [[0, 0], [1, 0], [1, 1]]\n'
STORE = '[store]\npath = "lab.db"\n'


def test_a_running_edge_takes_zones_budgets_and_storage_of_its_file(tmp_path: Path) -> None:
    with edge(tmp_path, STORE) as (made, hub):
        taking, sink = controls(made), made.consumers.sink
        assert isinstance(sink, EventSink)
        assert taking.take(Control(reread=True)) == "nothing new from the site file"
        write_site(tmp_path, f'budget = "60%"\n{STORE}keep = "30d"\nmax_size = "1GB"\n{ZONE}')
        question = encode(Control(reread=True))
        said = hub.join().ask("e3pose/lab/control/desk", question, 1.0)
        assert said is not None
        assert decode(said, Controlled, "edge").said == "zones, storage, budget from the site file"
        assert sink.writer.settings.retention == Retention(30 * 86_400.0, 10**9)
        sink.append(nobody(1, 0.05, 4), time_ns=10**18)
        assert [zone.name for zone in sink.zones.tables] == ["door"]
        with pytest.raises(InputError, match="one of them at a time"):
            taking.take(Control(reread=True, cameras=2.0))


def test_a_file_that_is_wrong_changes_nothing(tmp_path: Path) -> None:
    with edge(tmp_path, STORE) as (made, _):
        (tmp_path / "site.toml").write_text(f'{HEAD}budget = "often"\n{STORE}{ZONE}')
        with pytest.raises(InputError, match="budget"):
            controls(made).take(Control(reread=True))
        assert controls(made)._site.file.zone == ()
