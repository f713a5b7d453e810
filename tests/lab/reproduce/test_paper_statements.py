"""The page that goes through the paper names every item, and all that the paper numbers."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from tests.test_docs import ROOT

from e3pose_lab.reproduce.items import ITEMS

PAGE = ROOT / "docs" / "research" / "paper-statements.md"
LABEL = re.compile(r"\\label\{((?:fig|eq|table|alg):\w+)\}")
PART = re.compile(r"\\subfigure\[[^\]]*\]\{\s*\\label\{([^}]*)\}")


def test_every_item_of_a_picture_or_table_is_on_the_page() -> None:
    text = PAGE.read_text()
    for item in ITEMS:
        if item.label:
            assert f"`{item.key}`" in text, item.key


@pytest.mark.shared
def test_everything_that_the_paper_numbers_is_on_the_page() -> None:
    if not (shared := os.environ.get("E3POSE_SHARED")):
        pytest.skip("E3POSE_SHARED is not set")
    tex = (Path(shared) / "paper" / "e3pose.tex").read_text()
    wanted = set(LABEL.findall(tex)) - set(PART.findall(tex))
    text = PAGE.read_text()
    assert len(wanted) > 20
    assert not {label for label in wanted if label not in text}
    for item in ITEMS:
        assert all(label in tex for label in item.label.split(", ")), item.key
