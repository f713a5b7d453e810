"""Films are put in step by what they heard, and many cameras by the shifts of pairs."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import fftconvolve
from tests.cases import each_case
from tests.cli.commands import refused, run

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.synchronise import (
    RATE,
    disagreement,
    incidence,
    shifts_by_sound,
    spanning_tree_offsets,
    subsample_peak,
)
from e3pose.camera.source import open_video

pytestmark = pytest.mark.slow


def room(rng: np.random.Generator, seconds: float, rate: int, claps: int = 6) -> Floats:
    """Return `(num_samples,)` of claps and voices in a room."""
    sound = np.zeros(round(seconds * rate))
    for begin_s in rng.uniform(0, seconds - 0.5, claps):
        clap = np.arange(round(0.03 * rate)) / rate
        begin = round(begin_s * rate)
        sound[begin : begin + len(clap)] += 8 * rng.normal(size=len(clap)) * np.exp(-clap / 0.006)
    for begin_s in rng.uniform(0, seconds - 0.5, round(3 * seconds)):
        time_s = np.arange(round(rng.uniform(0.08, 0.25) * rate)) / rate
        pitch, begin = rng.uniform(120, 250), round(begin_s * rate)
        voice = sum(np.sin(2 * np.pi * pitch * n * time_s) / n for n in range(1, 12))
        sound[begin : begin + len(time_s)] += voice * np.hanning(len(time_s))
    return sound


def heard(
    sound: Floats,
    rng: np.random.Generator,
    rate: int,
    begin_s: float,
    seconds: float,
    noise_share: float = 0.3,
    fast: float = 0.0,
) -> Floats:
    """Return what a microphone hears from `begin_s` on."""
    time_s = np.arange(round(seconds * rate)) / rate * (1 + fast) + begin_s
    own = np.interp(time_s * rate, np.arange(len(sound)), sound)
    late_s = np.arange(1, round(0.3 * rate)) / rate
    echo = 0.15 * rng.normal(size=len(late_s)) * np.exp(-late_s / 0.05)
    own = fftconvolve(own, np.concatenate([[1.0], echo]))[: len(own)]
    return np.asarray(own + rng.normal(size=len(own)) * noise_share * np.sqrt((own**2).mean()))


def film(path: Path, sound: Floats | None, rate: int, seconds: float, fps: int = 15) -> None:
    """Write a film of grey pictures with a sound."""
    import av

    with av.open(str(path), "w") as container:
        video = container.add_stream("mpeg4", rate=fps)
        video.width, video.height, video.pix_fmt = 64, 48, "yuv420p"
        audio = None if sound is None else container.add_stream("aac", rate=rate, layout="mono")
        grey = np.full((48, 64, 3), 90, dtype=np.uint8)
        for index in range(round(seconds * fps)):
            picture = av.VideoFrame.from_ndarray(grey, format="rgb24")
            picture.pts, picture.time_base = index, Fraction(1, fps)
            container.mux(video.encode(picture))
        container.mux(video.encode(None))
        if sound is None or audio is None:
            return
        loud = (sound / np.abs(sound).max() * 0.8).astype(np.float32)
        for begin in range(0, len(loud), 1024):
            part = np.ascontiguousarray(loud[None, begin : begin + 1024])
            frame = av.AudioFrame.from_ndarray(part, format="fltp", layout="mono")
            frame.sample_rate, frame.pts, frame.time_base = rate, begin, Fraction(1, rate)
            container.mux(audio.encode(frame))
        container.mux(audio.encode(None))


BEGAN_S = {"cam0": 2.0, "cam1": 0.317, "cam2": 4.642}
QUARTER_FRAME_S = 0.25 / 25


@each_case("seed", [711, 712, 713])
def test_sound_tells_when_films_began(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sound = room(rng, 32.0, RATE)
    sounds = {
        name: heard(sound, rng, RATE, begin_s, 25.0, fast=fast)
        for (name, begin_s), fast in zip(BEGAN_S.items(), (0.0, 5e-5, -5e-5), strict=True)
    }
    found = shifts_by_sound(sounds, 10.0)
    wanted = np.array(list(BEGAN_S.values())) - BEGAN_S["cam0"]
    assert np.abs(found.offsets_s - wanted).max() < QUARTER_FRAME_S
    assert (found.sure_s < QUARTER_FRAME_S).all()


def test_films_that_heard_nothing_alike_are_reported() -> None:
    rng = np.random.default_rng(714)
    sound = room(rng, 20.0, RATE)
    sounds = {
        "cam0": heard(sound, rng, RATE, 0.0, 15.0),
        "cam1": heard(sound, rng, RATE, 1.0, 15.0),
        "other": heard(room(rng, 20.0, RATE), rng, RATE, 0.0, 15.0),
    }
    with pytest.raises(InputError, match="videos: other: the sound does not match that of cam0"):
        shifts_by_sound(sounds, 5.0)
    short = {name: sound[: RATE // 2] for name, sound in sounds.items()}
    with pytest.raises(InputError, match="cam1, other: the sound does not match"):
        shifts_by_sound(short, 5.0)
    silent = {name: np.zeros(10 * RATE) for name in sounds}
    with pytest.raises(InputError, match="cam1, other: the sound does not match"):
        shifts_by_sound(silent, 5.0)


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("films")
    rng, rate = np.random.default_rng(715), 48_000
    sound = room(rng, 18.0, rate)
    for (name, begin_s), kind in zip(BEGAN_S.items(), ("mp4", "mp4", "mkv"), strict=True):
        film(folder / f"{name}.{kind}", heard(sound, rng, rate, begin_s, 12.0), rate, 12.0)
    film(folder / "mute.mp4", None, rate, 2.0)
    return folder


def test_sound_begins_with_the_first_picture(films: Path) -> None:
    sound = open_video(films / "cam0.mp4").sound(RATE, 5.0)
    assert sound is not None and len(sound) == 5 * RATE and sound.std() > 0.01
    whole = open_video(films / "cam0.mp4").sound(RATE, 60.0)
    assert whole is not None and abs(len(whole) / RATE - 12.0) < 0.1
    assert open_video(films / "mute.mp4").sound(RATE, 5.0) is None


def test_sync_of_films_prints_offsets(films: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [films / "cam0.mp4", films / "cam1.mp4", films / "cam2.mkv"]
    assert run("sync", *paths, "--json", "-") == 0, capsys.readouterr().err
    output = json.loads(capsys.readouterr().out)
    for name, begin_s in BEGAN_S.items():
        assert output["offsets_s"][name] == pytest.approx(begin_s - BEGAN_S["cam0"], abs=0.01)
    assert run("sync", *paths) == 0
    assert "--offset cam0=0.0000 --offset cam1=-1.68" in capsys.readouterr().out


@each_case(
    ("words", "output"),
    [
        (
            ("cam0.mp4", "mute.mp4"),
            "mute.mp4: has no sound, expected videos that recorded the same",
        ),
        (("cam0.mp4", "none.mp4"), "none.mp4: found no file"),
        (("cam0.mp4", "cam1.mp4", "--overwrite"), "--overwrite: expected only with a recording"),
        (("one=cam0.mp4",), "found one video, expected at least two"),
    ],
)
def test_wrong_films_are_reported(
    films: Path,
    words: tuple[str, ...],
    output: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(films)
    assert output in refused(capsys, "sync", *words)


@each_case("peak", [3.0, 3.3, 2.6])
def test_peak_of_a_parabola_is_found_between_samples_and_at_an_end(peak: float) -> None:
    values = 5.0 - (np.arange(7, dtype=np.float64) - peak) ** 2
    best = int(values.argmax())
    assert best + subsample_peak(values, best) == pytest.approx(peak)
    assert subsample_peak(values[best:], 0) == 0.0
    assert subsample_peak(values[: best + 1], best) == 0.0


def test_most_certain_pairs_win_in_either_direction_and_who_has_none_has_no_offset() -> None:
    pairs = [(2, 1, -0.5), (0, 2, 2.0), (0, 1, 9.0), (3, 0, -4.0)]
    assert spanning_tree_offsets(4, pairs).tolist() == [0.0, 1.5, 2.0, 4.0]
    offsets = spanning_tree_offsets(4, [(2, 3, 1.0), (0, 1, 5.0)])
    assert offsets[:2].tolist() == [0.0, 5.0]
    assert np.isnan(offsets[2:]).all()


def test_disagreement_is_the_weighted_root_mean_square_of_a_cameras_pairs() -> None:
    pairs = [(0, 1, 1.0), (0, 2, 2.0), (1, 2, 1.4), (0, 3, 7.0)]
    rows = incidence(4, pairs)
    misses = rows @ np.array([0.0, 1.0, 2.0, 7.0]) - np.array([shift for *_, shift in pairs])
    found = disagreement(rows, misses, np.array([1.0, 1.0, 3.0, 1.0]))
    assert found[:3] == pytest.approx([0.0, 0.4 * np.sqrt(0.75), 0.4 * np.sqrt(0.75)])
    assert np.isnan(found[3])
