"""Replay and detection that read_view anew at videos, at the parts in which people are expected."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run
from tests.simulate.filmed import film

from e3pose.base.errors import InputError
from e3pose.camera.detect import DetectSettings, detect_videos, partial_folder
from e3pose.detectors import make_detector
from e3pose.detectors.base import Image
from e3pose.detectors.focus import Part
from e3pose.evaluate.detect_again import PixelViews, open_pixels
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import ProcessorTime, Recording, load_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose_lab.evaluate.compare import replay_stored

pytestmark = pytest.mark.slow

ALL = ReplaySettings(policy="all", feedback=True, whole_every=4)


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return film(tmp_path_factory.mktemp("films") / "films", cameras=3, seconds=2.4, seed=702)


@pytest.fixture(scope="module")
def recording(films: Path) -> Recording:
    return load_recording(films)


class Counting:
    """The detector `drawn`, which counts the pixels that it looks at."""

    def __init__(self) -> None:
        self.drawn = make_detector("drawn")
        self.skeleton = self.drawn.skeleton
        self.person_px, self.long_side, self.multiple = np.inf, 1, 1
        self.pixels: list[int] = []

    def detect(self, image: Image) -> Poses2D:
        return self.detect_part(image, Part(0, 0, image.shape[1], image.shape[0], 1))

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        self.pixels.append(part.width * part.height)
        found: Poses2D = self.drawn.detect_part(image, part)  # type: ignore[attr-defined]
        return found


def test_feedback_looks_at_fewer_pixels_and_finds_the_same_people(
    films: Path, recording: Recording
) -> None:
    found, pixels = [], []
    for feedback in (False, True):
        detector = Counting()
        read_view = PixelViews(recording, detector, films)
        settings = ReplaySettings(policy="all", feedback=feedback, whole_every=4)
        records = list(replay(recording, settings, read_view=read_view))
        found.append(accuracy(recording, records))
        pixels.append(sum(detector.pixels))
        parts = [part for _, _, part, _ in read_view.detections_s]
        assert len(parts) == 3 * recording.num_slots and any(parts) == feedback
    assert pixels[1] < 0.8 * pixels[0]
    usual, focused = ((f.recall_500mm, f.mpjpe_mm) for f in found)
    assert usual[0] and focused[0] and focused[0] > usual[0] - 0.02
    assert usual[1] and focused[1] and focused[1] < usual[1] + 3.0


def test_processor_time_is_that_of_the_looks_that_were_made_again(
    films: Path, recording: Recording
) -> None:
    before = {name: ProcessorTime(100.0, 0.25, 9) for name in recording.rig.camera_ids}
    read_view = PixelViews(replace(recording, processor=before), make_detector("drawn"), films)
    list(replay(recording, ALL, read_view=read_view))
    for time in read_view.processor().values():
        assert 0 < time.look_s < 1.0 and time.frame_s == 0.25
        assert time.looks == recording.num_slots
    assert not PixelViews(recording, make_detector("drawn"), films).processor()


def test_detection_with_feedback_measures_processor_time(films: Path, tmp_path: Path) -> None:
    recording, dest = load_recording(films), tmp_path / "again"
    videos = [f"{name}={films / 'videos' / file}" for name, file in recording.videos.items()]
    settings = DetectSettings(feedback=True, max_slots=12)
    detect_videos(videos, recording.rig, make_detector("drawn"), dest, settings, "drawn")
    found = load_recording(dest).processor
    assert found.keys() == set(recording.rig.camera_ids)
    assert all(time.look_s > 0 and time.frame_s > 0 and time.looks == 12 for time in found.values())


def test_look_at_a_stored_recording_repeats_exactly(films: Path, recording: Recording) -> None:
    runs = [list(replay_stored(recording, ALL, films, "drawn")) for _ in range(2)]
    for first, second in zip(*runs, strict=True):
        np.testing.assert_array_equal(first.people.joints_m, second.people.joints_m)


def test_feedback_without_pixels_is_refused(films: Path, recording: Recording) -> None:
    blind = simulate(SceneSettings("ring", people=1, seconds=0.5, fps=10, cameras=2), 701)
    with pytest.raises(InputError, match="without pixels"):
        replay(recording, ALL)
    with pytest.raises(InputError, match="no video of cam0, cam1"):
        open_pixels(blind, films, "drawn")
    with pytest.raises(InputError, match="found one of coco17, expected one of coco18"):
        from e3pose.model.skeleton import COCO18
        from e3pose.recording import ViewSeries

        views = (ViewSeries.from_views([], [], [], len(COCO18)),) * 3
        other = replace(recording, skeleton=COCO18, views=views)
        PixelViews(other, make_detector("drawn"), films)


def test_commands_compare_a_policy_with_and_without_feedback(
    films: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = tmp_path / "rows.json"
    both = ("--policies", "all,all+feedback", "--seeds", 1, "--jobs", 1, "--detector", "drawn")
    assert run("evaluate", films, *both, "--json", rows) == 0
    assert [row["policy"] for row in json.loads(rows.read_text())["rows"]] == [
        "all", "all+feedback",
    ]  # fmt: skip
    words = ("--policy", "round-robin", "--feedback", "--detector", "drawn", "--whole-every", 3)
    assert run("replay", films, *words) == 0
    assert " of 58 in the part where people were expected" in capsys.readouterr().out
    assert run("replay", films, "--policy", "all", "--detector", "drawn") == 0
    assert "detections: 0 of 72 in the part where people were expected" in capsys.readouterr().out


def test_command_says_what_feedback_lacks(
    films: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("simulate", tmp_path / "blind", "--people", 1, "--seconds", 0.4) == 0
    assert run("replay", tmp_path / "blind", "--feedback", "--detector", "drawn") == 2
    assert "--feedback: found no video of cam0" in capsys.readouterr().err
    assert run("replay", films, "--feedback") == 2
    assert "--detector: found 'simulated'" in capsys.readouterr().err  # nobody can run it
    assert run("replay", films, "--feedback", "--whole-every", 0) == 2
    assert "--whole-every" in capsys.readouterr().err


class Plain:
    """Knows whole images alone."""

    skeleton = COCO17

    def detect(self, image: Image) -> Poses2D:
        raise AssertionError("refused before anything is looked at")


def test_feedback_for_a_detector_without_a_use_for_it_is_refused(
    films: Path,
    recording: Recording,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    video = f"cam0={films / 'videos' / recording.videos['cam0']}"
    focused = DetectSettings(feedback=True)
    with pytest.raises(InputError, match="found with mine, which detects in whole images"):
        detect_videos([video], recording.rig, Plain(), tmp_path / "out", focused, "mine 1234")
    assert not partial_folder(tmp_path / "out").exists()
    (tmp_path / "mine.py").write_text(
        "from e3pose.model.skeleton import COCO17\n\n\nclass Plain:\n    skeleton = COCO17\n"
    )
    own = f"{tmp_path}/mine.py:Plain"
    for words in (
        ("replay", "--policy", "all", "--feedback"),
        ("evaluate", "--policies", "all+feedback"),
    ):
        assert run(words[0], films, *words[1:], "--detector", own) == 2
        assert "--feedback: found with" in capsys.readouterr().err


class Interrupted(Counting):
    """Ends after so many looks, as Ctrl-C does."""

    def __init__(self, looks: int) -> None:
        super().__init__()
        self.left = looks

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return super().detect_part(image, part, expected)


def test_detection_with_feedback_goes_on_after_an_interruption(
    films: Path, recording: Recording, tmp_path: Path
) -> None:
    videos = [f"{name}={films / 'videos' / file}" for name, file in recording.videos.items()]
    settings = DetectSettings(feedback=True, whole_every=4)

    def detect(detector: Counting, dest: Path) -> int:
        report = detect_videos(videos, recording.rig, detector, dest, settings, "drawn")
        return report.resumed_slots

    assert detect(Counting(), tmp_path / "whole") == 0
    with pytest.raises(KeyboardInterrupt):
        detect(Interrupted(30), tmp_path / "halves")
    assert partial_folder(tmp_path / "halves").is_dir()
    again = Counting()
    assert detect(again, tmp_path / "halves") == 30
    assert len(again.pixels) == 3 * recording.num_slots - 30
    whole, halves = (load_recording(tmp_path / name) for name in ("whole", "halves"))
    for one, other in zip(whole.views, halves.views, strict=True):
        np.testing.assert_array_equal(one.slots, other.slots)
        np.testing.assert_allclose(one.keypoints_px, other.keypoints_px, atol=1.0)


def test_detection_with_feedback_needs_the_places_of_cameras(films: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="without camera positions"):
        detect_videos(
            [films / "videos" / "cam0.mp4"], None, Counting(), tmp_path / "out",
            DetectSettings(feedback=True),
        )  # fmt: skip
