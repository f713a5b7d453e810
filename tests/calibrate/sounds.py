"""What microphones hear of a room: claps and voices, an echo each, and noise of their own."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

Floats = NDArray[np.float64]


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
    """Return what a microphone hears from `begin_s` on.

    Args:
        sound: of the room.
        rng: of its echo and noise.
        rate: samples per second.
        begin_s: when it began.
        seconds: how long.
        noise_share: root mean square of its noise over that of the sound.
        fast: share by which its clock is fast.
    """
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
