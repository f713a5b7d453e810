"""Measure the predictors: time against people and lead, memory of an edge process with them."""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.predictors import PREDICTORS, make_predictor
from e3pose.predictors.normalise import NUM_COMMON, NUM_CONTEXT, NUM_FEATURES

Floats = NDArray[np.float64]

TARGETS_MS = {(4, 5): 1.0, (16, 5): 2.5}  # people and lead: median of attention-lstm
HISTORY_SLOTS = 10
MISSING = 0.1


def people(num_people: int) -> Floats:
    """Return histories `(HISTORY_SLOTS, num_people, 17, 3)` that are noisy and have gaps."""
    rng = np.random.default_rng(0)
    pose = rng.normal(scale=0.4, size=(num_people, 17, 3))
    history: Floats = pose + np.cumsum(
        rng.normal(scale=0.01, size=(HISTORY_SLOTS, num_people, 17, 3)), axis=0
    )
    history[rng.random(history.shape[:3]) < MISSING] = np.nan
    return history


def median_ms(call: Callable[[], object], calls: int) -> float:
    call()
    times = []
    for _ in range(calls):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1000 * statistics.median(times)


def torch_ms(num_people: int, leads: int, calls: int) -> float | None:
    """Return the time of the network alone in eager torch, or None where torch is missing."""
    try:
        import torch
    except ImportError:
        return None
    from e3pose.train.network import AttentionLstm, NetworkSettings

    torch.set_num_threads(1)
    network = AttentionLstm(NetworkSettings())
    network.eval()
    features = torch.zeros(HISTORY_SLOTS, num_people, NUM_FEATURES)
    context = torch.zeros(num_people, NUM_CONTEXT)
    with torch.no_grad():
        return median_ms(lambda: network(features, context, leads), calls)


def onnx_ms(num_people: int, leads: int, calls: int) -> float:
    """Return the time of the network alone in ONNX Runtime."""
    from e3pose.predictors.attention_lstm import AttentionLstm
    from e3pose.skeleton import COCO17

    session = AttentionLstm(COCO17).session
    inputs = {
        "features": np.zeros((HISTORY_SLOTS, num_people, 7 * NUM_COMMON), dtype=np.float32),
        "context": np.zeros((num_people, NUM_CONTEXT), dtype=np.float32),
        "num_leads": np.array([leads]),
    }
    return median_ms(lambda: session.run(None, inputs), calls)


def memory_mb(name: str) -> float:
    """Return the largest memory of a fresh process that predicts once with `name`."""
    code = (
        "import numpy as np; from e3pose.predictors import make_predictor;"
        f"make_predictor({name!r}).predict(np.zeros((10, 4, 17, 3)), 0.04, 5);"
        "print(next(l.split()[1] for l in open('/proc/self/status') if l.startswith('VmHWM')))"
    )
    output = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout
    return int(output) / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=200, help="calls a figure")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args()
    rows = []
    print(f"{'predictor':<18} people  lead   median  ({options.calls} calls, one thread)")
    for name in PREDICTORS:
        predictor = make_predictor(name)
        for num_people in (1, 4, 16):
            history = people(num_people)
            for leads in (1, 5, 15):
                spent = median_ms(partial(predictor.predict, history, 0.04, leads), options.calls)
                rows.append(
                    {"predictor": name, "people": num_people, "lead": leads, "median_ms": spent}
                )
                target = TARGETS_MS.get((num_people, leads)) if name == "attention-lstm" else None
                about = "" if target is None else f"  target {target} ms"
                print(f"{name:<18} {num_people:6d} {leads:5d} {spent:8.3f} ms{about}")
    graph, eager = onnx_ms(4, 5, options.calls), torch_ms(4, 5, options.calls)
    print(f"network alone, 4 people, lead 5: ONNX Runtime {graph:.3f} ms", end="")
    print("" if eager is None else f", torch eager {eager:.3f} ms, {eager / graph:.1f} times it")
    memory = {name: memory_mb(name) for name in PREDICTORS}
    for name, size in memory.items():
        print(f"memory of a process that predicts with {name}: {size:.0f} MB")
    if options.json is not None:
        figures = {"times": rows, "network_ms": graph, "torch_ms": eager, "memory_mb": memory}
        options.json.write_text(json.dumps(figures, indent=2), encoding="utf-8")


if __name__ == "__main__":
    main()
