"""The picture of a camera with the skeletons of its slot, where the site allows it."""

from __future__ import annotations

import asyncio
import base64
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from tests.site.web.watched import RIG, Watched, poses, record

from e3pose.site.connect import live_slot
from e3pose.site.web.access import Client, Rules
from e3pose.site.web.feed import Feed
from e3pose.site.web.pictures import make_pictures, reprojected
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import Picture

PICTURE = Picture("c0", 3, (1000, 800), b"jpeg", 7, 0.5)


def get(path: str, answer: bytes | None) -> httpx.Response:
    feed = Feed("lab")
    feed.recent[3] = live_slot(poses(3))
    app = FastAPI()
    app.include_router(make_pictures(RIG, feed, {"c0": lambda _: answer}))

    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return await client.get(path)

    return asyncio.run(ask())


def test_picture_comes_with_the_skeletons_of_its_slot() -> None:
    found: dict[str, Any] = get("/api/pictures/c0", encode(PICTURE)).json()
    assert base64.b64decode(found["jpeg"]) == b"jpeg"
    assert (found["slot"], found["count"], found["energy_j"]) == (3, 7, 0.5)
    people = {person["track"]: person["joints_px"] for person in found["people"]}
    joints_m = record(3).poses.joints_m
    expected = RIG.cameras[0].project(joints_m[0, 5])
    assert people[10][5] == pytest.approx(expected.tolist(), abs=0.1)
    assert people[10][3] == [None, None]


def test_slot_that_is_long_gone_has_no_skeletons() -> None:
    old = Picture("c0", 1, (1000, 800), b"jpeg")
    assert get("/api/pictures/c0", encode(old)).json()["people"] == []


@pytest.mark.parametrize(
    ("path", "answer", "status"),
    [("c9", b"", 404), ("c0", None, 404), ("c0", b"garbage", 502)],
)
def test_without_a_picture_it_is_said_why(path: str, answer: bytes | None, status: int) -> None:
    found = get(f"/api/pictures/{path}", answer)
    assert found.status_code == status and found.json()["detail"]


def test_only_operators_see_pictures_and_only_where_the_site_allows_it(watched: Watched) -> None:
    rules: Rules = watched.view.rules
    headers = {"host": "localhost"}
    assert rules.judge("/api/pictures/c0", headers, Client("a"))[1] is not None
    read = headers | {"authorization": f"Bearer {rules.tokens.read}"}
    refusal = rules.judge("/api/pictures/c0", read, Client("a"))[1]
    assert refusal is not None and refusal.status == 403
    with watched.client(rules.tokens.write) as client:
        assert client.get("/api/site").json()["pictures"] is False
        assert client.get("/api/pictures/c0").status_code == 404


def test_joints_behind_a_camera_are_not_drawn() -> None:
    slot = live_slot(poses(3))
    behind = slot.joints_m.copy()
    behind[0, 0] = [9.0, 0.0, 1.0]  # c0 stands at x = 4 m and looks to x = 0
    moved = type(slot)(
        slot.slot, slot.time_ns, slot.joints, slot.track_ids, behind, slot.sigma_m, slot.measured,
        slot.selected, slot.arrived, slot.published_ns,
    )  # fmt: skip
    assert np.isnan(RIG.cameras[0].project(behind[0, 0].astype(float))).all()
    assert reprojected(moved, RIG.cameras[0])[0]["joints_px"][0] == [None, None]
