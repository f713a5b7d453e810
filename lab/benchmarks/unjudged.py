"""Judge tuned numbers that nothing judged: halve, double and leave them out, by the truth.

E3POSE_SHARED=... python lab/benchmarks/unjudged.py rests --seeds 811,812
E3POSE_SHARED=... python lab/benchmarks/unjudged.py failures per-slot information faces ...

Each group has cases, of every seed, and values. Every value is replayed on every case, paired with
the value of the source; a cell is the mean change with its standard error over the cases.
"""

import argparse
import contextlib
import importlib
import math
import subprocess
import sys
import time
from dataclasses import replace
from functools import lru_cache

import numpy as np

from e3pose.evaluate.faults import downsampled
from e3pose.evaluate.held_out import judge, turns
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose.recording import load_recording
from e3pose_lab.datasets import shared_folder


def M(name):
    return importlib.import_module("e3pose." + name)


PERCENT = ("mm", "W", "cams", "px", "wasted_s")  # their changes are shares; others are differences


def S(**k):
    usual = dict(pipeline="memory", policy="information", lead_slots=4, num_selected=1.0)
    return ReplaySettings(**{**usual, **k})


@lru_cache(None)
def scene(name, seed, seconds, fps=12.5, people=None):
    from detector_errors import simulated
    from e3pose.simulate import SCENES, SceneSettings, simulate

    if name[-1] in "+-":
        return simulated(name, seed, seconds=seconds, fps=fps)
    fps = fps if SCENES[name].fps > fps else None
    return simulate(SceneSettings(scene=name, seconds=seconds, fps=fps, people=people), seed)


@lru_cache(None)
def pizza(fps=6.0):
    from filter_terms import half

    whole = half(load_recording(shared_folder() / "data/pizza/recording"), second=False)
    return downsampled(whole, fps)


def truth(recording, settings, after=lambda *_: {}, **k):
    records = list(replay(recording, settings, **k))
    found = accuracy(recording, records)
    row = {"mm": found.mpjpe_mm, "missed": 100 * (1 - (found.recall_500mm or 0))}
    if found.precision_500mm is not None:
        row["false"] = 100 * (1 - found.precision_500mm)
    if found.id_switches is not None:
        row["switches"] = float(found.id_switches)
    row["cams"] = float(np.mean([r.selected.sum() for r in records]))
    return {**row, **after(recording, records, settings)}


def held_out(settings):
    rows = [judge(by, list(replay(rest, settings))).mean for rest, by in turns(pizza(), ["each"])[1:]]
    return {
        "mm": float(np.mean([r.median_mm for r in rows])),
        "missed": float(np.mean([r.missed_percent for r in rows])),
    }


@contextlib.contextmanager
def patched(**attributes):
    """Set `module__NAME`s, dots as single underscores of a table below, and forget what was cached."""
    old = {}
    try:
        for place, value in attributes.items():
            module, _, name = place.partition("__")
            module = M(PLACES[module])
            old[module, name] = getattr(module, name)
            setattr(module, name, value)
        forget()
        yield
    finally:
        for (module, name), value in old.items():
            setattr(module, name, value)
        forget()


def forget():
    for name, module in list(sys.modules.items()):
        if name.startswith("e3pose."):
            for value in list(vars(module).values()):
                if hasattr(value, "cache_clear"):
                    value.cache_clear()


@contextlib.contextmanager
def compiled_anew(**attributes):
    """Likewise for constants that kernels of `select` take over when they are compiled."""
    from numba.core.caching import NullCache

    from e3pose.base.kernel import Kernel

    for name in ("select.expected_information", "select.policies", "pipeline", "select.awake"):
        M(name)
    kernels = {
        id(value): value
        for name, module in list(sys.modules.items())
        if name.startswith("e3pose.") and ".select" in name
        for value in vars(module).values()
        if isinstance(value, Kernel)
    }.values()
    kept = [(kernel, kernel.__dict__.pop("compiled", None)) for kernel in kernels]
    with patched(**attributes):
        for kernel in kernels:
            kernel.compiled._cache = NullCache()
        yield
    for kernel, old in kept:
        kernel.__dict__.pop("compiled", None)
        if old is not None:
            kernel.__dict__["compiled"] = old


PLACES = {
    "rest": "select.rest_plan", "awake": "select.awake", "foresight": "select.kernels.foresight",
    "occlusion": "select.occlusion", "failures": "select.failure_detector",
    "slot": "estimate.per_slot.estimator", "lasting": "estimate.filter.lasting",
    "tree": "estimate.filter.tree", "still": "estimate.filter.unchanged", "pi": "camera.picamera",
}  # fmt: skip


# ------------------------------------------------------------------------------------------ rests


def rest_costs_of(recording):
    from e3pose.energy.modes import Rest
    from e3pose.energy.rest_costs import rest_costs

    n = len(recording.rig)
    rest = Rest("asleep", 0.5, 0.5, 1.0, 0.2, "assumed")
    return rest_costs((12.5,) * n, (6.25,) * n, [rest] * n)


def watts(recording, records, settings):
    from e3pose.evaluate.waking import asleep_in

    costs = settings.rest_costs
    selected = np.stack([r.selected for r in records])
    deep = costs.deep(asleep_in(records, settings.lead_slots), recording.interval_s)
    return {"W": float(costs.drawn_w(selected, deep).mean())}


@lru_cache(None)
def day(name, seed, seconds, busy, cameras=None):
    """A day of visits, by the script of the diary's page on what rests cost."""
    from typing import Sequence
    from unittest.mock import patch

    from e3pose.simulate import SCENES, SceneSettings, simulate
    from e3pose.simulate.activities import Play, _Task

    words = ["git", "show", "4de5ca09:lab/benchmarks/day.py"]
    source = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    first, last = source.index("def visits("), source.index("@dataclass(frozen=True, slots=True)\nclass Way")
    names = dict(
        np=np, Sequence=Sequence, Play=Play, _Task=_Task, SCENES=SCENES, simulate=simulate,
        SceneSettings=lambda **k: SceneSettings(**k, cameras=cameras), patch=patch, Recording=object, VISIT_S=(10.0, 22.0),
        LEAVING_S=3.0, PEOPLE=4, NEVER_S=1e9, FPS=12.5,
    )  # fmt: skip
    exec("from __future__ import annotations\n" + source[first:last], names)
    return names["day"](name, seconds, busy, seed)


def rests(recording, **k):
    return truth(recording, S(num_selected=2.0, rest="asleep", rest_costs=rest_costs_of(recording), **k), watts)


def g_rests(seeds):
    cases = {}
    for name in ("two-rooms", "ring", "one-sided"):
        for seed in seeds:
            cases[f"day {name} {seed}"] = lambda name=name, seed=seed: rests(day(name, seed, 80, 0.4))
    for seed in seeds:
        cases[f"two-rooms {seed}"] = lambda seed=seed: rests(scene("two-rooms", seed, 40))
        for cameras in (7, 10):
            cases[f"day ring, {cameras} cameras {seed}"] = lambda seed=seed, n=cameras: rests(day("ring", seed, 80, 0.3, n))
    values = {
        "together": patched(rest__LONGER=1e9, rest__STAGGER=0.0, awake__CELL_M=0.75, awake__MARGIN_M=3.0, awake__SEEN_SHARE=1.0),
        "LONGER 1.5": patched(rest__LONGER=1.5), "LONGER 4": patched(rest__LONGER=4.0),
        "LONGER 1e9": patched(rest__LONGER=1e9),
        "STAGGER 0": patched(rest__STAGGER=0.0), "STAGGER 0.25": patched(rest__STAGGER=0.25),
        "STAGGER 1": patched(rest__STAGGER=1.0),
        "CELL 0.25": patched(awake__CELL_M=0.25), "CELL 0.75": patched(awake__CELL_M=0.75),
        "CELL 1": patched(awake__CELL_M=1.0),
        "MARGIN 0": patched(awake__MARGIN_M=0.0), "MARGIN 1": patched(awake__MARGIN_M=1.0),
        "MARGIN 3": patched(awake__MARGIN_M=3.0), "MARGIN 4": patched(awake__MARGIN_M=4.0),
        "FAR 6": patched(awake__FAR_M=6.0), "FAR 24": patched(awake__FAR_M=24.0),
        "SEEN 0.3": patched(awake__SEEN_SHARE=0.3), "SEEN 1": patched(awake__SEEN_SHARE=1.0),
    }  # fmt: skip
    return cases, values


def g_watts(seeds):
    cases = {}
    for seed in seeds:
        cases[f"one-sided 26 W {seed}"] = lambda seed=seed: rests(scene("one-sided", seed, 40), watts=26.0)
        cases[f"two-rooms 24 W {seed}"] = lambda seed=seed: rests(scene("two-rooms", seed, 40), watts=24.0)
        cases[f"day ring 20 W {seed}"] = lambda seed=seed: rests(day("ring", seed, 80, 0.4), watts=20.0)
    values = {
        f"CREDIT {c:g}, REPAY {r:g}": patched(rest__CREDIT_S=c, awake__CREDIT_S=c, rest__REPAY_S=r)
        for c, r in ((5.0, 5.0), (20.0, 5.0), (10.0, 2.5), (10.0, 10.0), (8.0, 4.0), (8.0, 8.0), (4.0, 4.0))
    }
    return cases, values


def g_falls(seeds):
    from e3pose.simulate import SceneSettings
    from event_detection import Tally, home

    def one(seed, asked_w):
        tally = Tally()
        made = SceneSettings(scene="home-fall", seconds=180.0, fps=12.5)
        home(made, seed, replace(ReplaySettings(lead_slots=4), rest="asleep", watts=asked_w), tally)
        due = sum(n for (kind, _), n in tally.tried.items() if kind == "fall")
        met = sum(n for (kind, _), n in tally.found.items() if kind == "fall")
        return {"W": tally.joules / (3600 * tally.hours), "due": float(due), "found": float(met)}

    cases = {f"falls {w:g} W {s}": lambda s=s, w=w: one(s, w) for s in seeds for w in (26.0,)}
    return cases, {k: v for k, v in g_watts(seeds)[1].items()}


# ----------------------------------------------------------------------------------------- failures


def link(seed, loss, burst_s, fps, asked, slots, num=400):
    """Cameras behind a link that loses, in bursts; every tenth dies for a while, at a known time."""
    rng = np.random.default_rng(seed)
    F = M("select.failure_detector")
    dt = 1 / fps
    silence = F.Silence.none(num)
    lost = rng.random(num) < loss
    alive, until = np.ones(num, bool), rng.exponential(200.0, num)
    noticed = np.full(num, np.nan)
    died_at = np.zeros(num)
    delays, false, out, wasted, living = [], 0, 0, 0, 0
    change = min(1.0, dt / burst_s) if burst_s else 1.0
    for slot in range(slots):
        t = slot * dt
        flip = until < t
        dies, returns = flip & alive, flip & ~alive
        alive ^= flip
        died_at[dies], noticed[dies] = t, np.nan
        until[dies] = t + rng.uniform(10, 40, dies.sum())
        until[returns] = t + rng.exponential(200.0, returns.sum())
        delays += list(np.where(np.isnan(noticed[returns]), 30.0, noticed[returns]))
        lost = np.where(rng.random(num) < change, rng.random(num) < loss, lost)
        answering = silence.answering(slot)
        ordered = answering & (rng.random(num) < asked)
        before = silence.failures
        silence = F.listen(silence, slot, ordered, ordered & alive & ~lost, dt)
        gave = silence.failures > before
        false += int((gave & alive & (before == 0)).sum())
        fresh = gave & ~alive & np.isnan(noticed)
        noticed[fresh] = t - died_at[fresh]
        out += int((alive & ~answering).sum())
        living += int(alive.sum())
        wasted += int((ordered & ~alive).sum())
    hours = living * dt / 3600
    return {
        "false/h": false / hours, "out%": 100 * out / living, "notice_s": float(np.median(delays)),
        "notice95_s": float(np.quantile(delays, 0.95)), "wasted_s": wasted * dt / max(len(delays), 1),
    }  # fmt: skip


LINKS = {
    "steady 5 %": (0.05, 0.0, 12.5, 0.4), "steady 30 %": (0.3, 0.0, 12.5, 0.4),
    "none": (0.0, 0.0, 12.5, 0.4), "bursts of 0.2 s, 5 %": (0.05, 0.2, 12.5, 0.4),
    "bursts of 0.2 s, 20 %": (0.2, 0.2, 12.5, 0.4), "60 %": (0.6, 0.0, 12.5, 0.4),
    "25 a second": (0.1, 0.0, 25.0, 0.4), "6 a second, all": (0.1, 0.0, 6.0, 1.0),
}  # fmt: skip


def failure_values():
    return {
        "LIFE 3600": patched(failures__MEAN_LIFE_S=3600.0), "LIFE half": patched(failures__MEAN_LIFE_S=43200.0),
        "LIFE twice": patched(failures__MEAN_LIFE_S=172800.0), "LIFE 1e6": patched(failures__MEAN_LIFE_S=1e6),
        "LEAST LOSS 0.025": patched(failures__LOSS_RANGE=(0.025, 0.5)),
        "LEAST LOSS 0.1": patched(failures__LOSS_RANGE=(0.1, 0.5)),
        "MOST LOSS 0.25": patched(failures__LOSS_RANGE=(0.05, 0.25)),
        "MOST LOSS 0.9": patched(failures__LOSS_RANGE=(0.05, 0.9)),
        "LOSS 0.3 always": patched(failures__LOSS_RANGE=(0.3, 0.3)),
        "LOSS 0.5 always": patched(failures__LOSS_RANGE=(0.5, 0.5)),
        "MEMORY 100": patched(failures__MEMORY_ORDERS=100), "MEMORY 400": patched(failures__MEMORY_ORDERS=400),
        "MEMORY 50": patched(failures__MEMORY_ORDERS=50), "MEMORY 1000": patched(failures__MEMORY_ORDERS=1000),
    }  # fmt: skip


def g_failures(seeds):
    cases = {
        f"{name} {seed}": lambda seed=seed, how=how: link(seed, *how, slots=round(180 * how[2]))
        for name, how in LINKS.items() for seed in seeds
    }  # fmt: skip
    return cases, failure_values()


def g_lost(seeds):
    """Errors of poses while cameras are lost and links lose."""
    from e3pose.settings.faults import Faults, Kill

    def one(seed, loss, die, C):
        recording = scene("ring", seed, 24)
        kills = tuple(Kill(recording.rig.camera_ids[i], 6.0 + 4 * i) for i in range(die))
        return truth(recording, S(num_selected=C, faults=Faults(kills=kills, loss=loss), seed=seed))

    cases = {}
    for seed in seeds:
        for loss, die, C in ((0.0, 3, 1.0), (0.2, 2, 2.0), (0.4, 1, 2.0), (0.05, 3, 2.0)):
            cases[f"{die} die, loss {loss:g}, C {C:g} {seed}"] = lambda a=(seed, loss, die, C): one(*a)
    return cases, failure_values()


# -------------------------------------------------------------------------------- published pipeline


def P(**k):
    return S(pipeline="paper", **{**dict(policy="e3pose", num_selected=3.0, lead_slots=1), **k})


@lru_cache(None)
def motion(which, fps):
    from predictor_in_the_loop import captured, seen

    found = [m for k, m in captured(shared_folder()) if k == which]
    return downsampled(seen(found[0][:600], 30.0), fps)


@lru_cache(None)
def shelf():
    from e3pose_lab.datasets.shelf import import_shelf

    return import_shelf(shared_folder() / "data/shelf/shelf.npz")


def g_gates(seeds):
    cases = {f"Shelf C {C:g}": lambda C=C: truth(shelf(), P(num_selected=C)) for C in (2.0, 3.0, 5.0)}
    for seed in seeds:
        for name, fps in (
            ("crossing", 6.0),
            ("crossing", 25.0),
            ("round-table", 12.5),
            ("crowd", 6.0),
            ("ring-", 25.0),
            ("two-rooms", 12.5),
        ):
            cases[f"{name} {fps:g} {seed}"] = lambda a=(name, seed, 16, fps): truth(scene(*a), P())
    values = {
        "GATE 0": patched(slot__GATE_M=0.0), "GATE 0.1": patched(slot__GATE_M=0.1),
        "GATE 0.2": patched(slot__GATE_M=0.2), "GATE 0.8": patched(slot__GATE_M=0.8),
        "LIMIT 0.75": patched(slot__GATE_LIMIT_M=0.75), "LIMIT 3": patched(slot__GATE_LIMIT_M=3.0),
        "LIMIT none": patched(slot__GATE_LIMIT_M=50.0),
        "GATE 0.35, LIMIT none": patched(slot__GATE_M=0.35, slot__GATE_LIMIT_M=50.0),
        "GATE 0, LIMIT none": patched(slot__GATE_M=0.0, slot__GATE_LIMIT_M=50.0),
    }  # fmt: skip
    return cases, values


def g_unseen(seeds):
    cases = {"pizza": lambda: held_out(P(policy="information"))}
    for seed in seeds:
        for name in ("crossing", "ring", "one-sided"):
            for C in (2.0, 3.0):
                cases[f"{name} C {C:g} {seed}"] = lambda a=(name, seed, 16), C=C: truth(scene(*a), P(policy="information", num_selected=C))
        for name in ("ring", "crossing"):
            cases[f"{name} 40 mm {seed}"] = lambda a=(name, seed, 16): truth(
                scene(*a), P(policy="information", num_selected=None, target_error_m=0.04)
            )
    values = {f"UNSEEN {v:g}": patched(slot__UNSEEN_SIGMA_M=v) for v in (0.1, 0.15, 0.5, 0.6, 1.0, 2.0, 4.0)}
    return cases, values


def g_spread(seeds):
    def cases_of(seed):
        for name, busy in (("ring", 0.7), ("two-rooms", 0.7)):
            for k in (dict(), dict(budget=0.7), dict(budget=0.7, quality_weight=3.0)):
                yield f"day {name} {k} {seed}", lambda name=name, k=k: truth(day(name, seed, 240, busy), P(num_selected=2.0, **k), debts)

    def debts(recording, records, settings):
        return {"owed": float(max(r.deficit.max() for r in records)), "end": float(records[-1].deficit.max())}

    cases = dict(c for seed in seeds for c in cases_of(seed))
    values = {f"SPREAD {v:g}": patched(occlusion__SPREAD_MEMORY_S=v) for v in (15.0, 30.0, 120.0, 1e12)}
    return cases, values


# --------------------------------------------------------------------------------------- information


def g_behind(seeds):
    cases = {"pizza": lambda: held_out(S())}
    for seed in seeds:
        for name in ("crossing", "round-table", "buffet", "crowd", "lab"):
            cases[f"{name} {seed}"] = lambda a=(name, seed, 16): truth(scene(*a), S())
    return cases, {f"BEHIND {v:g}": compiled_anew(foresight__BEHIND_M=v) for v in (0.0, 0.05, 0.2, 0.5)}


def g_ratio(seeds):
    cases = {}
    for seed in seeds:
        for name in ("dying-cameras", "l-hall", "shaft", "pillar", "one-sided", "two-rooms"):
            for C in (1.0, 2.0):
                cases[f"{name} C {C:g} {seed}"] = lambda a=(name, seed, 16), C=C: truth(scene(*a), S(num_selected=C))
    return cases, {f"RATIO {v:g}": compiled_anew(foresight__INFORMATION_RATIO=v) for v in (1e-6, 10.0, 50.0, 200.0, 1000.0)}


# ------------------------------------------------------------------------------------------- filter


def face_mm(recording, records, joints=slice(0, 5)):
    off = []
    for r in records:
        true = recording.truth.joints_m[r.slot]
        if r.slot < 14 or not len(r.people.joints_m):
            continue
        e = np.linalg.norm(r.people.joints_m[:, None, joints] - true[None, :, joints], axis=-1)
        whole = np.linalg.norm(r.people.joints_m[:, None] - true[None], axis=-1)
        near = np.nan_to_num(np.nanmean(whole, axis=-1), nan=9.0).argmin(axis=0)
        for person, track in enumerate(near):
            mean = np.nanmean(e[track, person])
            if mean < 0.5:
                off.append(mean)
    return 1000 * float(np.mean(off))


def g_faces(seeds):
    T = M("estimate.filter.tree")

    def one(recording, C):
        records = list(replay(recording, S(num_selected=C, policy="round-robin")))
        return {"mm": face_mm(recording, records), "body": accuracy(recording, records).mpjpe_mm}

    cases = {}
    for which in ("CMU", "Panoptic"):
        for fps in (15.0, 30.0):
            for C in (1.0, 2.0, 5.0):
                cases[f"{which} {fps:g} C {C:g}"] = lambda which=which, fps=fps, C=C: one(motion(which, fps), C)
    for seed in seeds:
        for name in ("ring-", "buffet+"):
            cases[f"{name} {seed}"] = lambda a=(name, seed, 12): one(scene(*a), 1.0)

    def pizza_heads(fps):
        rows = []
        for rest, by in turns(pizza(fps), ["each"])[1:]:
            said = judge(by, list(replay(rest, S(num_selected=2.0, policy="round-robin")))).mean
            found = [v.median_mm for k, v in said.joints.items() if any(w in k.lower() for w in ("nose", "eye", "ear"))]
            rows.append((np.nanmean([f for f in found if f is not None]), said.median_mm))
        return {"mm": float(np.mean([r[0] for r in rows])), "body": float(np.mean([r[1] for r in rows]))}

    for fps in (6.0, 15.0):
        cases[f"pizza {fps:g}"] = lambda fps=fps: pizza_heads(fps)

    def table(habit):
        return patched(tree__HABITS={**T.HABITS, "face": habit, "skin": habit})

    F = T.FACE
    values = {
        "half acceleration": table(F._replace(acceleration_mps2=0.8)),
        "twice acceleration": table(F._replace(acceleration_mps2=3.2)),
        "half lasts": table(F._replace(lasts_s=0.2)), "twice lasts": table(F._replace(lasts_s=0.8)),
        "STIFF": table(T.STIFF),
    }  # fmt: skip
    return cases, values


def g_lasting(seeds):
    from e3pose.evaluate.figures import expected_figures, plain
    from e3pose.evaluate.smoothed import smooth_records

    def within(recording, records):
        return plain(expected_figures(recording, records)).get("coverage_90")

    def one(recording, C):
        posteriors = []
        keep = lambda estimate: posteriors.append(estimate.posterior)
        records = list(replay(recording, S(num_selected=C, policy="round-robin"), publish=keep))
        smooth = smooth_records(records, posteriors, recording.skeleton)
        return {
            "in90": within(recording, records), "first 3 s": within(recording, records[:37]),
            "late in90": within(recording, smooth), "mm": accuracy(recording, records).mpjpe_mm,
            "late mm": accuracy(recording, smooth).mpjpe_mm,
        }  # fmt: skip

    cases = {}
    for seed in seeds:
        for name in ("lab+", "two-rooms", "buffet+", "ring"):
            for C in (2.0, 4.0):
                cases[f"{name} C {C:g} {seed}"] = lambda a=(name, seed, 14), C=C: one(scene(*a), C)

    @contextlib.contextmanager
    def prior(seconds):
        L = M("estimate.filter.lasting")
        old = L.Lasting.__init__.__defaults__
        L.Lasting.__init__.__defaults__ = (L.USUAL * seconds, seconds)
        yield
        L.Lasting.__init__.__defaults__ = old

    values = {f"MEMORY {v:g}": patched(lasting__MEMORY_S=v) for v in (0.75, 1.5, 6.0, 1e9)}
    values |= {f"PRIOR {v:g}": prior(v) for v in (0.0, 0.1, 0.4, 1.0)}
    return cases, values


# ------------------------------------------------------------------------------------ unchanged images


def hidden_px(seed):
    """The motion of people that the gate does not see, in images of 1032 pixels, of real images."""
    import cv2

    from e3pose.camera.gate import CHANGED, FEWEST_CHANGED, small_grey

    rng = np.random.default_rng(seed)
    recording = load_recording(shared_folder() / "data/pizza/recording")
    folder = shared_folder() / "data/pizza/images"
    moved, seen = [], []
    for camera, place in enumerate(sorted(folder.iterdir())):
        for frame in (0, 200):  # of the first half
            path = place / f"frame{frame}_{place.name[-2:]}.jpg"
            image = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB).astype(np.float32)
            view = recording.view(frame, camera)
            if view is None:
                continue
            high, wide = image.shape[:2]
            unit = max(high, wide) / 1032
            noise = [rng.normal(scale=2.0, size=image.shape) for _ in range(2)]
            before = small_grey(np.clip(image + noise[0], 0, 255).astype(np.uint8))
            for points, scores in list(zip(view.keypoints_px, view.scores, strict=True))[:4]:
                points = points[scores > 0.3]
                if len(points) < 6:
                    continue
                low, top = points.min(axis=0), points.max(axis=0)
                middle, reach = (low + top) / 2, 0.6 * (top - low) + 8
                y, x = np.mgrid[:high, :wide].astype(np.float32)
                r = np.maximum(abs(x - middle[0]) / reach[0], abs(y - middle[1]) / reach[1])
                soft = np.clip(2 - r / 0.8, 0, 1).astype(np.float32)  # all of the body moves, and drags what is around
                for px in (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0):
                    angle = rng.uniform(0, 2 * np.pi)
                    dx, dy = (np.float32(px * unit * f(angle)) * soft for f in (np.cos, np.sin))
                    after = cv2.remap(
                        image, (x - dx).astype(np.float32), (y - dy).astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
                    )
                    shown = small_grey(np.clip(after + noise[1], 0, 255).astype(np.uint8))
                    apart = np.abs(before.astype(np.int16) - shown)
                    moved.append(px)
                    seen.append((apart > CHANGED).sum() >= FEWEST_CHANGED)
    moved, seen = np.array(moved), np.array(seen)
    steps = np.unique(moved)
    share = np.array([(~seen[moved == px]).mean() for px in steps])
    for px, one in zip(steps, share, strict=True):
        print(f"   moved {px:g} px of 1032: unchanged {100 * one:.1f} % of {(moved == px).sum()}")
    weight = np.gradient(steps) * share
    print(
        f"   root mean square of what is hidden, if all motions are as likely: {math.sqrt((weight * steps**2).sum() / weight.sum()):.2f} px along the motion"
    )


def g_still(seeds):
    from e3pose.model.noise import IMAGE_PX
    from e3pose.model.pose import MOST_UNCHANGED_S

    def one(name, seed, hides_px):
        recording = scene(name, seed, 24)
        T = recording.truth.joints_m
        px = []
        for P_, camera in zip(recording.rig.projections, recording.rig.cameras, strict=True):
            h = np.concatenate([T.reshape(-1, 3), np.ones((T[..., 0].size, 1))], 1) @ P_.T
            px.append((h[:, :2] / h[:, 2:]).reshape(*T.shape[:-1], 2) * IMAGE_PX / max(camera.image_size))
        last, counts = {}, [0, 0]

        def view(slot, camera, expected):
            now = recording.view(slot, camera)
            counts[1] += 1
            if camera in last:
                slot0, then = last[camera]
                off = np.linalg.norm(px[camera][slot] - px[camera][slot0], axis=-1)
                most = np.nanmax(off) if np.isfinite(off).any() else 0
                since_s = (slot - slot0) * recording.interval_s
                if then is not None and most < hides_px and since_s < MOST_UNCHANGED_S:
                    counts[0] += 1
                    return replace(then, unchanged_s=since_s)
            last[camera] = (slot, now)
            return now

        row = truth(recording, S(num_selected=2.0), read_view=view)
        return {**row, "unchanged": 100 * counts[0] / max(counts[1], 1)}

    cases = {
        f"{name}, hides {h:g} px {seed}": lambda a=(name, seed, h): one(*a)
        for name in ("home-night", "lab", "home") for h in (2.0, 4.0) for seed in seeds
    }  # fmt: skip
    return cases, {f"STILL {v:g}": patched(still__STILL_PX=v) for v in (0.5, 1.0, 2.0, 8.0, 16.0, 1e6)}


# ------------------------------------------------------------------------------------------ picamera


AHEAD = [4]  # slots before a look at which the sensor is steered, as `camera.live` has it
RESETS = [False]  # the whole sensor where the next slot has no order, as `camera.live` has it


def g_picamera(seeds):
    P_ = M("camera.picamera")

    def one(name, seed, count):
        recording = scene(name, seed, 24)
        T = recording.truth.joints_m
        sources, true_px, stats = {}, [], {"lost": 0, "looks": 0, "cut": 0, "points": 0, "side": 0.0}
        for P3, camera in zip(recording.rig.projections, recording.rig.cameras, strict=True):
            h = np.concatenate([T.reshape(-1, 3), np.ones((T[..., 0].size, 1))], 1) @ P3.T
            true_px.append((h[:, :2] / h[:, 2:]).reshape(*T.shape[:-1], 2))

        def view(slot, camera, expected):
            """As `camera.live` and the sensor do it, frame after frame, since the last look."""
            size = np.array(recording.rig.cameras[camera].image_size)
            if camera not in sources:
                s = P_.SensorSource.__new__(P_.SensorSource)
                s.size, s._region, s._settling = tuple(size), (0, 0, *P_.SENSOR_PX), 0
                s._device = type("D", (), {"set_inference_roi_abs": lambda self, r: None})()
                sources[camera] = [s, 0]
            s, first = sources[camera]
            for frame in range(first, slot):
                if s._settling:
                    s._settling -= 1
                elif frame >= slot - AHEAD[0]:
                    s.expect(expected)
                elif RESETS[0]:
                    s.expect(None)  # no order for the next slot
            stats["looks"] += 1
            sources[camera][1] = slot + 1 if s._settling else slot
            if s._settling:
                s._settling -= 1
                stats["lost"] += 1
                return None
            now = recording.view(slot, camera)
            region = np.array(s._region, dtype=np.float64)
            share = region[2] / P_.SENSOR_PX[0]
            stats["side"] += share
            if now is None or not len(now.scores):
                return now
            low = region[:2] / P_.SENSOR_PX * size
            high = low + region[2:] / P_.SENSOR_PX * size
            inside = ((now.keypoints_px >= low) & (now.keypoints_px <= high)).all(axis=-1)
            scores = np.where(inside, now.scores, 0.0)
            # Errors of the network are as large as its pixels: they shrink with the region.
            apart = np.linalg.norm(now.keypoints_px[:, None] - true_px[camera][slot][None], axis=-1)
            who = np.nan_to_num(np.nanmean(apart, axis=-1), nan=1e9).argmin(axis=1)
            true = true_px[camera][slot][who]
            points = np.where(np.isfinite(true), true + share * (now.keypoints_px - true), now.keypoints_px)
            stats["points"] += int((now.scores > 0).sum())
            stats["cut"] += int(((now.scores > 0) & ~inside).sum())
            points = np.where(scores[..., None] > 0, points, np.nan)
            kept = (scores > 0).any(axis=1)
            return replace(now, keypoints_px=points[kept], scores=scores[kept])

        row = truth(recording, S(num_selected=min(count, float(len(recording.rig))), feedback=True), read_view=view)
        looks = max(stats["looks"], 1)
        return {
            **row,
            "lost": 100 * stats["lost"] / looks,
            "cut": 100 * stats["cut"] / max(stats["points"], 1),
            "side": 100 * stats["side"] / looks,
        }

    cases = {
        f"{name}, {n:g} of all {seed}": lambda a=(name, seed, n): one(*a)
        for name in ("ring-", "one-sided", "home")
        for n in (2.0, 9.0)
        for seed in seeds
    }

    def region_before(expected, size):
        points = np.zeros((0, 2)) if expected is None else expected.keypoints_px.reshape(-1, 2)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            return (0, 0, *P_.SENSOR_PX)
        low, high = points.min(axis=0) / size, points.max(axis=0) / size
        side = float(np.clip((high - low).max() * (1 + 2 * LAW[0]), P_.LEAST_REGION, 1.0))
        corner = np.clip((low + high) / 2 - side / 2, 0, 1 - side)
        left, top = (corner * P_.SENSOR_PX).astype(int).tolist()
        return left, top, int(side * P_.SENSOR_PX[0]), int(side * P_.SENSOR_PX[1])

    def expect_before(self, expected):
        wanted = region_before(expected, self.size)
        apart = np.abs(np.subtract(wanted, self._region)).max()
        if apart > LAW[1] * max(self._region[2:]) or (expected is None and apart > 0):
            self._set(wanted)

    LAW = [0.5, 0.15]

    @contextlib.contextmanager
    def before(margin, moved, resets, ahead):
        kept = P_.SensorSource.expect, RESETS[0], AHEAD[0]
        P_.SensorSource.expect, RESETS[0], AHEAD[0], LAW[:] = expect_before, resets, ahead, (margin, moved)
        yield
        P_.SensorSource.expect, RESETS[0], AHEAD[0] = kept

    values = {
        "as before": before(0.5, 0.15, True, 1), "the law before, steered 4 ahead": before(0.5, 0.15, False, 4),
        "MARGIN 0.25, 4 ahead": before(0.25, 0.15, False, 4), "MARGIN 1, 4 ahead": before(1.0, 0.15, False, 4),
        "MOVED 0.075, 4 ahead": before(0.5, 0.075, False, 4), "MOVED 0.3, 4 ahead": before(0.5, 0.3, False, 4),
        "LOOSE 1": patched(pi__LOOSE=1), "LOOSE 4": patched(pi__LOOSE=4), "whole": before(1e3, 0.15, False, 4),
    }  # fmt: skip
    return cases, values


# ---------------------------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("groups", nargs="+")
    parser.add_argument("--seeds", default="811,812")
    parser.add_argument("--only", default="", help="how names of values begin, with commas")
    parser.add_argument("--cases", default="", help="what names of cases begin with, with commas")
    options = parser.parse_args()
    seeds = [int(s) for s in options.seeds.split(",")]
    for group in options.groups:
        if group == "hidden":
            hidden_px(seeds[0])
            continue
        begun = time.time()
        cases, values = ALL[group](seeds)
        cases = {k: v for k, v in cases.items() if k.startswith(tuple(options.cases.split(",")))}
        base, took = {}, {}
        for name, case in cases.items():
            t = time.time()
            base[name] = case()
            took[name] = time.time() - t
        print(f"## {group}, seeds {options.seeds}, {len(cases)} cases, {time.time() - begun:.0f} s")
        for kind in dict.fromkeys(name.rsplit(" ", 1)[0] for name in cases):
            rows = [row for name, row in base.items() if name.rsplit(" ", 1)[0] == kind]
            words = {k: round(float(np.mean([r[k] for r in rows if r[k] is not None] or [np.nan])), 3) for k in rows[0]}
            print(f"   {kind}: {words} {np.mean([took[n] for n in cases if n.startswith(kind)]):.1f} s", flush=True)
        for label, change in values.items():
            if not label.startswith(tuple(options.only.split(","))):
                continue
            t = time.time()
            try:
                with change:
                    rows = {name: case() for name, case in cases.items()}
            except Exception as error:
                print(label, "fails:", repr(error)[:300], flush=True)
                continue
            print(f"{label}: {told(base, rows)}  ({time.time() - t:.0f} s)", flush=True)
            for kind in dict.fromkeys(name.rsplit(" ", 1)[0] for name in cases):
                part = [n for n in cases if n.rsplit(" ", 1)[0] == kind]
                print(f"      {kind}: {told({n: base[n] for n in part}, {n: rows[n] for n in part})}", flush=True)


def told(base, rows):
    words = []
    for key in next(iter(base.values())):
        pairs = [(base[n][key], rows[n][key]) for n in base if base[n].get(key) is not None and rows[n].get(key) is not None]
        if not pairs:
            continue
        apart = [100 * (b / a - 1) if key in PERCENT and a else b - a for a, b in pairs]
        if max(map(abs, apart)) < 1e-9:
            continue
        error = np.std(apart, ddof=1) / len(apart) ** 0.5 if len(apart) > 1 else float("nan")
        words.append(f"{key} {np.mean(apart):+.2f} ± {error:.2f}{' %' * (key in PERCENT)}")
    return "; ".join(words) or "the same"


ALL = {name[2:]: value for name, value in globals().items() if name.startswith("g_")}

if __name__ == "__main__":
    main()
