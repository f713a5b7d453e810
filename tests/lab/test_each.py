"""One verb over many recordings: a result each, once, whoever does the work and however it ends."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from tests.cli.commands import run as run_verb

from e3pose.base.errors import InputError
from e3pose.output.report.overlay import write_movie
from e3pose.recording import load_recording, save_recording
from e3pose.recording.calibration import save_rig
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose.simulate.films import frames
from e3pose_lab import each
from e3pose_lab.each import check_words, make_plan, result_of, rows_of, write_rows

pytestmark = pytest.mark.slow

WORDS = ("replay", "--policy", "round-robin", "--cameras", "1")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("recordings")
    made = []
    for seed in range(3):
        scene = SceneSettings(
            people=1, seconds=1.0, fps=10, cameras=2, detector=DetectorSettings(perfect=True)
        )
        made.append(folder / f"walk {seed}")
        save_recording(simulate(scene, seed), made[-1])
    return made


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run verbs in this process: one of their own takes seconds to start."""
    monkeypatch.setattr(each, "_run", lambda *words: "failed" if run_verb(*words) else "")


def test_results_are_one_table_and_a_second_run_does_what_is_missing(
    here: None, recordings: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import pandas

    verb, dest = " ".join(WORDS), tmp_path / "results"
    words = ("each", dest, *recordings[:2], "--verb", verb, "--jobs", "1")
    assert run_verb(*words, "--plan") == 0
    assert "To do: 2 recordings" in capsys.readouterr().out and not dest.exists()
    assert run_verb(*words) == 0
    assert "2 results, 0 failed" in capsys.readouterr().out
    result_of(dest, recordings[0], WORDS).unlink()  # as if it had been killed before
    stays = result_of(dest, recordings[1], WORDS)
    written_ns = stays.stat().st_mtime_ns
    assert run_verb("each", dest, *recordings, "--verb", verb, "--jobs", "1", "--plan") == 0
    shown = capsys.readouterr().out
    assert "To do: 2 recordings" in shown and "hours of one worker; done: 1" in shown
    assert run_verb("each", dest, *recordings, "--verb", verb, "--jobs", "1") == 0
    assert stays.stat().st_mtime_ns == written_ns
    table = pandas.read_parquet(dest)
    assert sorted(table.folder) == [str(one) for one in recordings]


def test_a_recording_that_fails_is_told_and_leaves_the_others(
    recordings: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken"
    broken.mkdir()
    dest, verb = tmp_path / "results", " ".join(WORDS)
    assert run_verb("each", dest, broken, recordings[0], "--verb", verb, "--jobs", "1") == 1
    told = capsys.readouterr()
    assert f"{broken}: e3pose: " in told.err and "1 result, 1 failed" in told.out
    assert make_plan(dest, [broken, recordings[0]], WORDS).to_do == (broken,)


def test_films_become_recordings_with_a_row_each(
    here: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import pandas

    recording = simulate(SceneSettings(people=1, seconds=0.5, fps=10, cameras=2), 1)
    folders = [tmp_path / "monday", tmp_path / "tuesday"]
    for folder in folders:
        folder.mkdir()
        for index, camera_id in enumerate(recording.rig.camera_ids):
            write_movie(folder / f"{camera_id}.mp4", frames(recording, index), recording.fps)
    save_rig(recording.rig, folders[0] / "calibration.toml")
    (tmp_path / "empty").mkdir()
    dest, verb = tmp_path / "results", "detect --model e3pose.detectors.drawn:Drawn"
    words = ("each", dest, *folders, tmp_path / "empty", "--verb", verb, "--jobs", "1")
    assert run_verb(*words) == 1
    assert "empty: found no films" in capsys.readouterr().err
    table = pandas.read_parquet(dest)
    assert sorted(table.folder) == [str(one) for one in folders]
    made = sorted((dest / "_recordings").iterdir())
    assert [load_recording(one).num_slots for one in made] == [5, 5]
    assert load_recording(made[0]).rig.placed and not load_recording(made[1]).rig.placed
    # As if it had been killed between recording and row: that is not detected again.
    written_ns = made[0].stat().st_mtime_ns
    (dest / f"{made[0].name}.parquet").unlink()
    assert run_verb(*words[:3], *words[5:]) == 0
    assert made[0].stat().st_mtime_ns == written_ns and len(pandas.read_parquet(dest)) == 2


def test_another_recording_option_or_content_is_another_result(
    recordings: list[Path], tmp_path: Path
) -> None:
    one = result_of(tmp_path, recordings[0], WORDS)
    assert one.parent == tmp_path and one.name.startswith("walk_0-")
    assert len({one, result_of(tmp_path, recordings[1], WORDS),
                result_of(tmp_path, recordings[0], (*WORDS, "--lead", "2"))}) == 3  # fmt: skip
    path = next(path for path in recordings[2].rglob("*") if path.is_file())
    before = result_of(tmp_path, recordings[2], WORDS)
    os.utime(path, ns=(1, 1))
    assert result_of(tmp_path, recordings[2], WORDS) != before


@pytest.mark.parametrize(
    "words", [["query"], ["calibrate"], [], ["replay", "--json=x"], ["detect", "--overwrite"]]
)
def test_what_it_does_not_do_is_told(words: list[str]) -> None:
    with pytest.raises(InputError, match="--verb"):
        check_words(words)


def test_rows_have_one_schema_whatever_is_missing(tmp_path: Path) -> None:
    import pandas

    write_rows(tmp_path / "a.parquet", rows_of({"mm": None, "n": 1, "of": [1]}, "a"), 1.0)
    write_rows(
        tmp_path / "b.parquet", rows_of({"rows": [{"mm": 2.5, "n": 2, "of": [2]}]}, "b"), 1.0
    )
    table = pandas.read_parquet(tmp_path)
    assert table.n.tolist() == [1.0, 2.0] and table.of.tolist() == ["[1]", "[2]"]
