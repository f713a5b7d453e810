"""Halve and double numbers of selection, rests, smoothing and failures; print what changes.

E3POSE_SHARED=... python lab/benchmarks/halved.py info fail slot smooth budget near rest check
"""

import sys, time, warnings, importlib, math
import subprocess
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
import numpy as np
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose.evaluate.faults import downsampled
from e3pose.evaluate.held_out import judge, turns
from e3pose.recording import load_recording
from e3pose.settings.faults import Faults, Kill
from e3pose_lab.datasets import shared_folder

SH = shared_folder()
M = lambda n: importlib.import_module("e3pose." + n)


@lru_cache(None)
def scene(name, seed, seconds, fps=12.5):
    from e3pose.simulate import SCENES, SceneSettings, simulate

    return simulate(
        SceneSettings(scene=name, seconds=seconds, fps=fps if SCENES[name].fps > fps else None),
        seed,
    )


@lru_cache(None)
def pizza(fps=6.0, seconds=20):
    w = load_recording(SH / "data/pizza/recording")
    from e3pose.simulate.detections import until

    n = min(w.num_slots, round(seconds / w.interval_s))
    return downsampled(
        replace(w, num_slots=n, views=tuple(until(v, n) for v in w.views), truth=None), fps
    )


@lru_cache(None)
def shelf():
    from e3pose_lab.datasets.shelf import import_shelf

    return import_shelf(SH / "data/shelf/shelf.npz")


@lru_cache(None)
def motion(which=1, fps=6.0):
    from choice_of_cameras import made

    return made(f"motion-{which}", fps, 20, 0)


S = lambda **k: ReplaySettings(
    **{**dict(pipeline="memory", policy="information", lead_slots=4, num_selected=1.0), **k}
)


def held(rec, s):
    out = [judge(by, list(replay(rest, s))).mean for rest, by in turns(rec, ["each"])[1:] if by]
    return {
        "mm": float(np.mean([o.median_mm for o in out])),
        "missed": float(np.mean([o.missed_percent for o in out])),
    }


def truth(rec, s, after=None):
    r = list(replay(rec, s))
    f = accuracy(rec, r)
    d = {"mm": f.mpjpe_mm, "missed": 100 * (1 - f.recall_500mm)}
    if f.id_switches is not None:
        d["sw"] = f.id_switches
    d["cams"] = float(np.mean([x.selected.sum() for x in r]))
    if after:
        d.update(after(rec, r, s))
    pcp = getattr(f, "pcp", None)
    if rec.name.startswith("shelf") and pcp is not None:
        try:
            d["pcp"] = float(pcp.average)
        except Exception as e:
            pass
    return d


def costs(rec):
    from e3pose.energy.profiles import load_profile, modes_of
    from e3pose.energy.modes import Rest
    from e3pose.energy.rest_costs import rest_costs

    p = load_profile("xavier-nx")
    n = len(rec.rig)
    m = modes_of(p)
    rest = Rest("asleep", 0.5, 0.5, 1.0, 0.2, "assumed")
    return m, rest, n


def restcosts(rec):
    from e3pose.energy.rest_costs import RestCosts, rest_costs
    from e3pose.energy.modes import Rest

    n = len(rec.rig)
    rest = Rest("asleep", 0.5, 0.5, 1.0, 0.2, "assumed")
    act = np.full(n, 12.5)
    idle = np.full(n, 6.25)
    return rest_costs(tuple(act), tuple(idle), [rest] * n)


def power(rec, r, s):
    from e3pose.evaluate.waking import asleep_in

    a = asleep_in(r, s.lead_slots)
    c = s.rest_costs
    sel = np.stack([x.selected for x in r])
    w = np.where(a, 0.5, c.idle_w + sel * c.look_w)
    return {"W": float(w.mean())}


@lru_cache(None)
def day(name, seed, seconds, busy):
    src = subprocess.run(
        ["git", "show", "4de5ca09:lab/benchmarks/day.py"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    a = src.index("def visits(")
    b = src.index("@dataclass(frozen=True, slots=True)\nclass Way")
    ns = dict(np=np, Sequence=list, Play=None)
    from e3pose.simulate.activities import Play, _Task
    from e3pose.simulate import SCENES, SceneSettings, simulate
    from unittest.mock import patch
    from typing import Sequence

    ns.update(
        Play=Play,
        _Task=_Task,
        SCENES=SCENES,
        SceneSettings=SceneSettings,
        simulate=simulate,
        patch=patch,
        Sequence=Sequence,
        Recording=object,
        VISIT_S=(10.0, 22.0),
        LEAVING_S=3.0,
        PEOPLE=4,
        NEVER_S=1e9,
        FPS=12.5,
    )
    exec("from __future__ import annotations\n" + src[a:b], ns)
    return ns["day"](name, seconds, busy, seed)


def rests(rec, **k):
    s = S(num_selected=2.0, rest="asleep", rest_costs=restcosts(rec), **k)
    return truth(rec, s, power)


GROUPS = {}


def group(cases, *patches):
    return cases, patches


def half_double(mod, attr, both=(0.5, 2.0)):
    v = getattr(M(mod), attr)
    out = []
    for f in both:
        if isinstance(v, tuple):
            new = tuple(x * f for x in v)
        elif isinstance(v, int):
            new = max(1, round(v * f))
        else:
            new = v * f
        out.append((f"{mod}.{attr} {v} => {new}", mod, attr, new))
    return out


def run(cases, patches, limit):
    t0 = time.time()
    base = {}
    for n, c in list(cases.items()):
        try:
            base[n] = c()
        except Exception as e:
            import traceback

            print(
                "CASE", n, "ERR", repr(e)[:200], traceback.format_exc(limit=-2)[-300:], flush=True
            )
    cases = {n: cases[n] for n in base}
    print(
        "base",
        {
            n: {k: round(v, 3) for k, v in b.items() if isinstance(v, (int, float))}
            for n, b in base.items()
        },
        f"{time.time() - t0:.0f}s",
        flush=True,
    )
    for label, mod, attr, new in patches:
        t1 = time.time()
        m = M(mod)
        old = getattr(m, attr)
        setattr(m, attr, new)
        try:
            for mm in ("select.awake", "select.rest_plan"):
                for fn in vars(M(mm)).values():
                    if hasattr(fn, "cache_clear"):
                        fn.cache_clear()
            for f in ():
                M(f).spread_order.cache_clear()
            row = {}
            for n, c in cases.items():
                v = c()
                d = {}
                for k in v:
                    if v[k] is None or base[n][k] is None:
                        continue
                    if abs(v[k] - base[n][k]) > 1e-9:
                        d[k] = (
                            f"{100 * (v[k] / base[n][k] - 1):+.1f}%"
                            if k in ("mm", "W", "cams")
                            else f"{v[k] - base[n][k]:+.2f}"
                        )
                row[n] = d or 0
            print(label, row, f"{time.time() - t1:.0f}s", flush=True)
        except Exception as e:
            print(label, "ERR", repr(e)[:200], flush=True)
        finally:
            setattr(m, attr, old)


def main():
    for g in sys.argv[1:] + (["check"] if "fail" in sys.argv else []):
        print("##", g, flush=True)
        c, p = ALL[g]()
        run(c, p, 0)


def g_info():
    sc = [("two-rooms", 702), ("l-hall", 703)]
    c = {"pizza6": lambda: held(pizza(), S()), "motion6": lambda: truth(motion(), S())}
    for n, s in sc:
        c[n] = lambda n=n, s=s: truth(scene(n, s, 16), S())
    for n, s in sc + [("one-sided", 704)]:
        c[n + " 40mm"] = lambda n=n, s=s: truth(
            scene(n, s, 16), S(num_selected=None, target_error_m=0.04)
        )
    c["one-sided 15mm"] = lambda: truth(
        scene("one-sided", 704, 16), S(num_selected=None, target_error_m=0.015)
    )
    p = []
    for a in ("WATCH_LIMIT_S", "BURST_S", "NEAR_NATS", "NO_BETTER"):
        p += half_double("select.policies.information", a)
    p += half_double("select.stated_error", "MOST", (0.6, 2.0))
    return c, p


def g_fail():
    def one(k):
        return lambda: {
            q: float(
                np.mean(
                    [
                        truth(shelf(), S(num_selected=1.02, phase=ph, seed=ph, **k(ph)))[q]
                        for ph in (0, 1)
                    ]
                )
            )
            for q in ("mm", "missed")
        }

    c = {
        "killed": one(lambda ph: dict(faults=Faults(kills=(Kill("each", 4.0, 100),)))),
        "lost": one(lambda ph: dict(faults=Faults(loss=0.3))),
        "plain": one(lambda ph: {}),
    }
    p = []
    for a in ("MEAN_LIFE_S", "MEMORY_ORDERS"):
        p += half_double("select.failure_detector", a)
    p += [
        ("LOSS 0.025,0.5", "select.failure_detector", "LOSS_RANGE", (0.025, 0.5)),
        ("LOSS 0.1,0.5", "select.failure_detector", "LOSS_RANGE", (0.1, 0.5)),
        ("LOSS 0.05,0.25", "select.failure_detector", "LOSS_RANGE", (0.05, 0.25)),
        ("LOSS 0.05,0.9", "select.failure_detector", "LOSS_RANGE", (0.05, 0.9)),
    ]
    return c, p


def g_slot():
    P = lambda **k: S(
        pipeline="paper", **{**dict(policy="e3pose", num_selected=3.0, lead_slots=1), **k}
    )
    c = {
        "shelf e3pose": lambda: truth(shelf(), P()),
        "shelf information": lambda: truth(shelf(), P(policy="information")),
        "pizza6 e3pose": lambda: held(pizza(), P()),
        "pizza6 information": lambda: held(pizza(), P(policy="information")),
        "crossing": lambda: truth(scene("crossing", 703, 16), P()),
    }
    p = []
    for a in ("FILLED_SIGMA_M", "FILLED_SCORE", "UNSEEN_SIGMA_M", "GATE_M", "GATE_LIMIT_M"):
        p += half_double("estimate.per_slot.estimator", a)
    p += half_double("select.occlusion", "SPREAD_MEMORY_S")
    return c, p


def g_rest():
    c = {}
    for n, s in (("two-rooms", 702), ("ring", 703)):
        c[n] = lambda n=n, s=s: rests(scene(n, s, 40))
    c["one-sided 24W"] = lambda: rests(scene("one-sided", 704, 30), watts=26.0)
    c["two-rooms 40mm"] = lambda: truth(
        scene("two-rooms", 702, 40),
        S(
            num_selected=None,
            target_error_m=0.04,
            rest="asleep",
            rest_costs=restcosts(scene("two-rooms", 702, 40)),
        ),
        power,
    )
    c["day"] = lambda: rests(day("two-rooms", 711, 90, 0.4))
    p = []
    for a in ("PLAN_S", "KEPT_S", "CELL_M", "MARGIN_M", "FAR_M", "NEWCOMERS"):
        p += half_double("select.awake", a)
    p += half_double("select.awake", "SEEN_SHARE", (0.5, 1.6))
    for a in ("FIRST_REST_S", "LONGEST_REST_S", "EMPTY_REST_S", "STAGGER", "CREDIT_S", "REPAY_S"):
        p += half_double("select.rest_plan", a)
    p += half_double("select.rest_plan", "LONGER", (0.75, 2.0))
    return c, p


from dataclasses import replace as rp


@lru_cache(None)
def played(which):
    rec = {
        "motion": lambda: motion(1, 15.0),
        "ring": lambda: scene("ring", 701, 15),
        "crossing": lambda: scene("crossing", 702, 12),
    }[which]()
    post = []
    recs = list(replay(rec, S(num_selected=2.0), publish=lambda p: post.append(p.posterior)))
    return rec, recs, post


def judged(rec, late):
    from e3pose.evaluate.figures import expected_figures, plain

    s = {**plain(expected_figures(rec, late)), **plain(accuracy(rec, late))}
    acc = [k for k in s if "acceleration" in k or "mps2" in k]
    return {"mm": s["mpjpe_mm"], "in90": s.get("coverage_90"), "W": s[acc[0]] if acc else None}


def kept_(which, method, blind=False):
    from e3pose.estimate.smooth import SmoothSettings
    from e3pose.evaluate.smoothed import smooth_poses

    rec, recs, _ = played(which)
    if blind:
        recs = [
            rp(
                r,
                people=rp(
                    r.people,
                    full_covariance_m2=None,
                    sigma_m=np.full(r.people.scores.shape, np.nan),
                    **({"dynamics": None} if hasattr(r.people, "dynamics") else {}),
                ),
            )
            for r in recs
        ]
    return judged(rec, smooth_poses(recs, rec.skeleton, rec.interval_s, SmoothSettings(method)))


def g_smooth():
    c = {}
    for w in ("motion", "ring", "crossing"):
        c[w + " 1euro"] = lambda w=w: kept_(w, "one-euro")
        c[w + " rts"] = lambda w=w: kept_(w, "rts")
        c[w + " rts unstated"] = lambda w=w: kept_(w, "rts", True)
    p = (
        half_double("estimate.smooth", "BETA_PER_M")
        + half_double("estimate.smooth", "TELLING_M")
        + half_double("estimate.smooth", "UNKNOWN_SIGMA_M")
        + [("UNKNOWN 0.025", "estimate.smooth", "UNKNOWN_SIGMA_M", 0.025)]
    )
    return c, p


def g_lasting():
    L = M("estimate.filter.lasting")

    def one(which):
        from e3pose.evaluate.smoothed import smooth_records

        rec = {
            "motion": lambda: motion(1, 15.0),
            "lab+": lambda: plus("lab", 701),
            "two-rooms": lambda: scene("two-rooms", 702, 12),
        }[which]()
        post = []
        recs = list(
            replay(
                rec,
                S(num_selected=float(len(rec.rig)), policy="all"),
                publish=lambda p: post.append(p.posterior),
            )
        )
        a = judged(rec, recs)
        b = judged(rec, smooth_records(recs, post, rec.skeleton))
        return {"in90": a["in90"], "mm": a["mm"], "late90": b["in90"], "late": b["mm"]}

    c = {w: (lambda w=w: one(w)) for w in ("motion", "lab+", "two-rooms")}
    return c, half_double("estimate.filter.lasting", "MEMORY_S")


def plus(name, seed):
    from choice_of_cameras import made

    return made(name + "+", 12.5, 10, seed)


def g_prior():
    c, _ = g_lasting()
    L = M("estimate.filter.lasting").Lasting

    class P:
        pass

    m = M("estimate.filter.lasting")
    import types

    # patched through the defaults of the dataclass
    def setd(x):
        L.__init__.__defaults__ = (m.USUAL * x, x)

    P = types.ModuleType("p")

    class Mod(types.ModuleType):
        def __setattr__(s, k, v):
            if k == "PRIOR_S":
                setd(v)
            types.ModuleType.__setattr__(s, k, v)

    q = Mod("e3pose.q")
    q.PRIOR_S = 0.2
    sys.modules["e3pose.q"] = q
    return c, [("PRIOR_S 0.1", "q", "PRIOR_S", 0.1), ("PRIOR_S 0.4", "q", "PRIOR_S", 0.4)]


def g_face():
    t = M("estimate.filter.tree")
    table = [v for k, v in vars(t).items() if isinstance(v, dict) and "skin" in v and "face" in v][
        0
    ]
    from e3pose.evaluate.metrics import mean_errors_m

    def one(which):
        from predictor_in_the_loop import captured, seen

        recs = dict()
        ms = [m for k, m in captured(SH) if k == ("CMU" if which == "cmu" else "Panoptic")]
        rec = downsampled(seen(ms[0][:600], 30.0), 15.0)
        out = []
        for r in replay(rec, S(num_selected=2.0)):
            if r.slot < 14:
                continue
            true = rec.truth.joints_m[r.slot]
            if len(r.people.joints_m) == 0:
                continue
            e = np.linalg.norm(r.people.joints_m[:, None, :5] - true[None, :, :5], axis=-1)
            out.append(np.nanmin(np.nanmean(e, axis=-1)))
        return {"mm": 1000 * float(np.nanmean(out))}

    c = {w: (lambda w=w: one(w)) for w in ("cmu", "pan")}
    import types

    H = t.FACE

    class Mod(types.ModuleType):
        def __setattr__(s, k, v):
            if k == "FACE":
                table["face"] = v
                table["skin"] = v
                for n in ("grow",):
                    f = getattr(t, n)
                    if hasattr(f, "cache_clear"):
                        f.cache_clear()
            types.ModuleType.__setattr__(s, k, v)

    q = Mod("e3pose.qf")
    q.FACE = H
    sys.modules["e3pose.qf"] = q
    return c, [
        ("FACE half accel", "qf", "FACE", H._replace(acceleration_mps2=0.8)),
        ("FACE twice accel", "qf", "FACE", H._replace(acceleration_mps2=3.2)),
        ("FACE half lasts", "qf", "FACE", H._replace(lasts_s=0.2)),
        ("FACE twice lasts", "qf", "FACE", H._replace(lasts_s=0.8)),
        ("FACE = STIFF", "qf", "FACE", t.STIFF),
    ]


def nocache(only=("select",)):
    from numba.core.caching import NullCache
    from e3pose.base.kernel import Kernel

    for n, m in list(sys.modules.items()):
        if n.startswith("e3pose.") and any("." + o in n for o in only):
            for k, v in list(vars(m).items()):
                if isinstance(v, Kernel):
                    v.__dict__.pop("compiled", None)
                    v.compiled._cache = NullCache()


def g_info2():
    c, _ = g_info()
    return c, []


def g_budget():
    c = {}
    for n, s in (("two-rooms", 702), ("l-hall", 703), ("one-sided", 704)):
        for b in (0.1, 0.2):
            c[f"{n} {b}"] = lambda n=n, s=s, b=b: truth(
                scene(n, s, 16),
                S(num_selected=None, target_error_m=0.03, budget=(b,) * len(scene(n, s, 16).rig)),
            )
        c[f"{n} turns"] = lambda n=n, s=s: truth(
            scene(n, s, 16),
            S(
                policy="round-robin",
                num_selected=1.0,
                budget=(0.1,) + (0.5,) * (len(scene(n, s, 16).rig) - 1),
            ),
        )
    return c, half_double("select.policies.information", "BURST_S") + [
        ("BURST 0", "select.policies.information", "BURST_S", 0.0),
        ("BURST 1000", "select.policies.information", "BURST_S", 1000.0),
    ]


def g_near():
    I = M("select.policies.information")
    from numba.core.caching import NullCache
    import types

    class Mod(types.ModuleType):
        def __setattr__(s, k, v):
            if k == "NEAR":
                I.NEAR_NATS = v
                I.choose.__dict__.pop("compiled", None)
                I.choose.compiled._cache = NullCache()
            types.ModuleType.__setattr__(s, k, v)

    q = Mod("e3pose.qn")
    q.NEAR = 0.02
    sys.modules["e3pose.qn"] = q
    return g_info()[0], [(f"NEAR {v}", "qn", "NEAR", v) for v in (0.02, 0.01, 0.04, 1e-7)]


def g_rest2():
    c, p = g_rest()
    c = {k: c[k] for k in ("two-rooms", "day")}
    c["one-sided 26W"] = lambda: rests(scene("one-sided", 705, 24), watts=26.0)
    return c, [
        x
        for x in p
        if not any(w in x[0] for w in ("PLAN_S", "KEPT_S", "NEWCOMERS", "FIRST_REST_S"))
    ]


def g_check():
    """RestCheck by errors of known rise: share of rounds in the wrong state."""
    R = M("select.rest_plan")

    def one(rise, seed, hours=8, sd=0.12):
        rng = np.random.default_rng(seed)
        check = R.RestCheck()
        dt = 2.0
        wrong = n = 0
        for k in range(int(hours * 3600 / dt)):
            awake = check.wakes(k, dt)
            # stated error wanders with what people do: an AR(1) of 20 s
            if k == 0:
                x = 0.0
            a = math.exp(-dt / 20.0)
            x = a * x + math.sqrt(1 - a * a) * sd * rng.standard_normal()
            e = 0.03 * math.exp(x) * (1.0 if awake else rise)
            check = check.after(k, dt, not awake, e)
            bad = (check.idle and rise < 1.1) or (not check.idle and rise > 1.1)
            wrong += bad
            n += 1
        return 100 * wrong / n

    def share(rise):
        return lambda: {"wrong%": float(np.mean([one(rise, s) for s in range(3)]))}

    c = {f"rise {r}": share(r) for r in (1.0, 1.05, 1.15, 1.3)}
    p = []
    for a in (
        "STRETCH_S",
        "STRETCHES",
        "SETTLE_S",
        "MEMORY",
        "LEAST_ROUNDS",
        "LEAST_SPREAD",
        "BACK",
    ):
        p += half_double("select.rest_plan", a)
    return c, p


def g_still():
    from e3pose.model.pose import MOST_UNCHANGED_S
    from e3pose.model.noise import IMAGE_PX
    from e3pose.simulate.activities import Play

    def one(name, seed):
        rec = scene(name, seed, 24)
        cams = rec.rig.cameras
        T = rec.truth.joints_m
        px = []
        for P, c in zip(rec.rig.projections, cams):
            h = np.concatenate([T.reshape(-1, 3), np.ones((T[..., 0].size, 1))], 1) @ P.T
            px.append((h[:, :2] / h[:, 2:]).reshape(*T.shape[:-1], 2) * IMAGE_PX / c.image_size[0])
        last = {}
        n = [0, 0]

        def view(slot, camera, expected):
            v = rec.view(slot, camera)
            n[1] += 1
            if camera in last:
                s0, v0 = last[camera]
                d = (
                    np.nanmax(np.linalg.norm(px[camera][slot] - px[camera][s0], axis=-1))
                    if np.isfinite(px[camera][slot]).any()
                    else 0
                )
                if d < 4.0 and (slot - s0) * rec.interval_s < MOST_UNCHANGED_S:
                    n[0] += 1
                    return rp(v0, unchanged_s=(slot - s0) * rec.interval_s)
            last[camera] = (slot, v)
            return v

        r = list(replay(rec, S(num_selected=2.0), read_view=view))
        d = judged(rec, r)
        d["unchanged%"] = 100 * n[0] / max(n[1], 1)
        return d

    c = {w: (lambda w=w: one(*w)) for w in (("home-night", 701), ("home", 702))}
    return {str(k): v for k, v in c.items()}, half_double("estimate.filter.unchanged", "STILL_PX")


ALL = {k[2:]: v for k, v in globals().items() if k.startswith("g_")}
if __name__ == "__main__":
    a = sys.argv[1:]
    if a and a[0] == "kern":
        for spec in a[1:]:
            mod, attr, val = spec.split(":")
            m = M(mod)
            setattr(m, attr, float(val)) if val != "now" else None
            for n in (
                "select.expected_information",
                "select.policies.information",
                "select.policies.drift_plus_penalty",
                "select.stated_error",
                "select.awake",
                "select.kernels.foresight",
                "pipeline",
            ):
                M(n)
            if val != "now":
                nocache()
            print(spec)
            run(g_info()[0], [], 0)
    else:
        main()
