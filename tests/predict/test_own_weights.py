"""Weights of one's own, by the name of their file, wherever a predictor is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from e3pose.base.errors import InputError
from e3pose.model.skeleton import COCO17
from e3pose.predict import make_predictor

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install e3pose[edge]")

from e3pose.predict.attention_lstm import SHIPPED


def test_a_file_of_weights_predicts_as_it_does_when_shipped(tmp_path: Path) -> None:
    (tmp_path / "mine.onnx").write_bytes(SHIPPED.read_bytes())
    history = np.random.default_rng(0).normal(size=(10, 3, 17, 3))
    mine, shipped = (
        make_predictor(name, COCO17).predict(history, 0.04, 5).joints_m
        for name in (str(tmp_path / "mine.onnx"), "attention-lstm")
    )
    np.testing.assert_array_equal(mine, shipped)


def test_a_file_that_is_none_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.onnx: file not found"):
        make_predictor(str(tmp_path / "none.onnx"))
    (tmp_path / "damaged.onnx").write_bytes(b"damaged")
    with pytest.raises(InputError, match=r"damaged\.onnx: found no readable network"):
        make_predictor(str(tmp_path / "damaged.onnx"))


def test_an_unknown_name_lists_what_there_is() -> None:
    with pytest.raises(InputError, match=r"found 'nobody', expected one of zero.*\.onnx"):
        make_predictor("nobody")


def test_a_name_that_is_no_text_is_refused(tmp_path: Path) -> None:
    content = SHIPPED.read_bytes().replace(b"num_leads", b"\xffum_leads")
    (tmp_path / "flipped.onnx").write_bytes(content)
    with pytest.raises(InputError, match=r"flipped\.onnx: found no readable network"):
        make_predictor(str(tmp_path / "flipped.onnx"))
