"""The attention-LSTM network, run by ONNX Runtime from the graph in a file of weights."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.predict.attention_lstm import SHIPPED
from e3pose_lab.prediction.normalise import Normalised

Floats32 = NDArray[np.float32]


def open_session(path: Path = SHIPPED) -> Any:
    """Return a session of the network on one thread."""
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    return ort.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])


def run_network(session: Any, normal: Normalised, leads: int) -> tuple[Floats32, Floats32]:
    """Return places and logarithms of expected errors, as `kernels.network.run_network` does."""
    inputs = {
        "features": normal.features,
        "context": normal.context,
        "num_leads": np.array([leads]),
    }
    places, log_error = session.run(["places", "log_error"], inputs)
    return places, log_error
