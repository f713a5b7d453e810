"""Measure the predictors: time against people and lead, memory of an edge process with them."""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.skeleton import COCO17
from e3pose.predict import PREDICTORS, make_predictor
from e3pose.predict.attention_lstm import AttentionLstm
from e3pose.predict.kernels.network import run_network
from e3pose.predict.normalise import NUM_COMMON, NUM_CONTEXT, NUM_FEATURES
from e3pose_lab.evaluate.drawing import check_svg
from e3pose_lab.prediction.normalise import Normalised, normalise, to_common
from reference import attention_network as runtime

Lines = dict[str, list[tuple[int, float | None]]]
Curves = tuple[Lines, Lines]

TARGETS_MS = {(4, 5): 1.0, (16, 5): 2.5}  # people and lead: median of attention-lstm
OURS, WITHOUT = "attention-lstm", "constant-velocity"
PLOTTED_LEADS, PLOTTED_PEOPLE = (1, 2, 3, 5, 8, 10, 15), (1, 2, 4, 8, 16, 32, 64)
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


def call_ms(name: str, num_people: int, leads: int, calls: int) -> float:
    """Return the time of a call from Python, as the loop makes it."""
    predict = make_predictor(name).predict
    return median_ms(partial(predict, people(num_people), 0.04, leads), calls)


def torch_ms(num_people: int, leads: int, calls: int) -> float | None:
    """Return the time of the network alone in eager torch, or None where torch is missing."""
    try:
        import torch
    except ImportError:
        return None
    from e3pose_lab.train.network import AttentionLstm as Network
    from e3pose_lab.train.network import NetworkSettings

    torch.set_num_threads(1)
    network = Network(NetworkSettings())
    network.eval()
    features = torch.zeros(HISTORY_SLOTS, num_people, NUM_FEATURES)
    context = torch.zeros(num_people, NUM_CONTEXT)
    with torch.no_grad():
        return median_ms(lambda: network(features, context, leads), calls)


def network_inputs(num_people: int) -> Normalised:
    """Return what the network is given of people."""
    predictor = AttentionLstm(COCO17)
    return normalise(to_common(people(num_people), predictor.columns), 0.04, HISTORY_SLOTS)


def kernel_ms(num_people: int, leads: int, calls: int) -> float:
    """Return the time of the network alone as it is compiled here."""
    normal, weights = network_inputs(num_people), AttentionLstm(COCO17).weights
    places = np.empty((leads, num_people, 3 * NUM_COMMON), dtype=np.float32)
    errors = np.empty((leads, num_people, NUM_COMMON), dtype=np.float32)
    return median_ms(
        lambda: run_network(weights, normal.features, normal.context, places, errors), calls
    )


def onnx_ms(num_people: int, leads: int, calls: int) -> float | None:
    """Return the time of the network alone in ONNX Runtime, or None where that is missing."""
    try:
        session = runtime.open_session()
    except ImportError:
        return None
    normal = network_inputs(num_people)
    return median_ms(lambda: runtime.run_network(session, normal, leads), calls)


def memory_mb(recording: Path, predictor: str) -> float:
    """Return what a fresh process holds that runs the loop of the edge with `predictor`, MB."""
    code = (
        "import sys; from e3pose.recording import load_recording;"
        "from e3pose.evaluate.replay import ReplaySettings, replay;"
        "settings = ReplaySettings('paper', predictor=sys.argv[2], lead_slots=5);"
        "[None for _ in replay(load_recording(sys.argv[1]), settings)];"
        "print(next(l.split()[1] for l in open('/proc/self/status') if l.startswith('VmRSS')))"
    )
    command = [sys.executable, "-c", code, str(recording), predictor]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return int(output) / 1024


def edge_memory_mb() -> dict[str, float]:
    """Return the memory of an edge process by predictor, after two seconds of four people."""
    from e3pose.recording import save_recording
    from e3pose.simulate import SceneSettings, simulate

    with tempfile.TemporaryDirectory(prefix="e3pose-") as folder:
        recording = Path(folder) / "scene"
        save_recording(simulate(SceneSettings(people=4, seconds=2.0), seed=0), recording)
        memory_mb(recording, WITHOUT)  # compiled kernels are kept from here on
        return {name: memory_mb(recording, name) for name in (WITHOUT, OURS)}


def curves(calls: int) -> Curves:
    """Return median times in ms against lead for four people, and against people for five slots."""
    makers: dict[str, Callable[[int, int], float | None]] = {
        OURS: partial(call_ms, OURS, calls=calls),
        WITHOUT: partial(call_ms, WITHOUT, calls=calls),
        "network in eager torch": partial(torch_ms, calls=calls),
    }
    by_lead = {name: [(n, make(4, n)) for n in PLOTTED_LEADS] for name, make in makers.items()}
    by_people = {name: [(n, make(n, 5)) for n in PLOTTED_PEOPLE] for name, make in makers.items()}
    return by_lead, by_people


def draw(path: Path, drawn: Curves) -> None:
    """Draw cost against lead and against people."""
    from e3pose_lab.evaluate.drawing import COLOURS, MARKERS, legend_above, picture
    from e3pose_lab.prediction.colours import PREDICTOR_COLOURS

    headings = (("4 people", "slots ahead"), ("5 slots ahead", "people"))
    with picture(path, 7.2, 2.9) as figure:
        for axes, lines, (title, label) in zip(figure.subplots(1, 2), drawn, headings, strict=True):
            for number, (name, points) in enumerate(lines.items()):
                known = [(x, y) for x, y in points if y is not None]
                if known:
                    axes.plot(
                        *zip(*known, strict=True),
                        color=PREDICTOR_COLOURS.get(name, COLOURS[3]),
                        marker=MARKERS[number],
                        label=name,
                    )
            axes.set(xlabel=label, yscale="log")
            axes.set_title(f"ms a call, {title}")
            axes.yaxis.set_major_formatter("{x:g}")
            axes.grid(which="minor", linewidth=0.3)
        figure.axes[1].set_xscale("log", base=2)
        figure.axes[1].set_xticks(PLOTTED_PEOPLE, [str(n) for n in PLOTTED_PEOPLE])
        legend_above(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=200, help="calls a figure")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    parser.add_argument("--plot", type=Path, help="draw cost against lead and people, an .svg file")
    options = parser.parse_args()
    if options.plot is not None:
        check_svg("--plot", options.plot)
    rows = []
    print(f"{'predictor':<18} people  lead   median  ({options.calls} calls, one thread)")
    for name in PREDICTORS:
        for num_people in (1, 4, 16):
            for leads in (1, 5, 15):
                spent = call_ms(name, num_people, leads, options.calls)
                rows.append(
                    {"predictor": name, "people": num_people, "lead": leads, "median_ms": spent}
                )
                target = TARGETS_MS.get((num_people, leads)) if name == "attention-lstm" else None
                about = "" if target is None else f"  target {target} ms"
                print(f"{name:<18} {num_people:6d} {leads:5d} {spent:8.3f} ms{about}")
    figures: dict[str, object] = {"times": rows, "network": print_networks(options.calls)}
    memory = edge_memory_mb()
    print(
        f"memory of an edge process: {memory[OURS]:.0f} MB with {OURS} loaded, "
        f"{memory[WITHOUT]:.0f} MB with {WITHOUT} instead"
    )
    figures["edge_memory_mb"] = memory
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2), encoding="utf-8")
    if options.plot is not None:
        draw(options.plot, curves(options.calls))


def print_networks(calls: int) -> list[dict[str, float | None]]:
    """Print the network alone, compiled, in ONNX Runtime and in eager torch in the same run."""
    rows: list[dict[str, float | None]] = []
    for num_people in (4, 16):
        ours = kernel_ms(num_people, 5, calls)
        graph, eager = onnx_ms(num_people, 5, calls), torch_ms(num_people, 5, calls)
        rows.append({"people": num_people, "kernel_ms": ours, "onnx_ms": graph, "torch_ms": eager})
        others = [
            f"{name}: not installed"
            if spent is None
            else f"{name} {spent:.3f} ms, {spent / ours:.1f} times it"
            for name, spent in (("ONNX Runtime", graph), ("eager torch", eager))
        ]
        print(f"network alone, {num_people} people, lead 5: {ours:.3f} ms; {'; '.join(others)}")
    return rows


if __name__ == "__main__":
    main()
