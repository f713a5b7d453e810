"""The program `e3pose view`: from a site file to a running web server."""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.errors import InputError
from e3pose.base.version import Watched
from e3pose.output.report.scene import FRUSTUM_SHARE, bounds, frustum, millimetres, neck
from e3pose.settings.resolved import ResolvedSite
from e3pose.settings.site_file import SiteTable, load_site
from e3pose.site.follow import LOCAL_OPERATOR, operator_of, viewer_link
from e3pose.site.joining import Joining
from e3pose.site.keep.jobs import FILES, Jobs
from e3pose.site.trial_notices import send_test
from e3pose.site.web.access import Rules
from e3pose.site.web.address import Address, address_of, take_port
from e3pose.site.web.app import PageContent, make_app
from e3pose.site.web.control import Ask
from e3pose.site.web.feed import Feed
from e3pose.site.web.keep import Keeping
from e3pose.site.web.notices import surroundings
from e3pose.site.web.pictures import PictureRules, make_pictures
from e3pose.site.web.postures import page_watch
from e3pose.site.web.server import PageServer, https_of, serve
from e3pose.site.web.tokens import PageTokens, Tokens, hub_tokens, open_tokens
from e3pose.site.zones import Zones
from e3pose.store import Store
from e3pose.store.names import StoredNames
from e3pose.wire.network import open_network
from e3pose.wire.topics import of_camera, of_control
from e3pose.wire.transport import Transport

ASK_S = 3.0  # for the edge to answer
PICTURE_S = 1.0  # for a camera to answer
NAMES_S = 5.0  # between two looks at names that others may have changed


@dataclass(slots=True, eq=False)
class Shown:
    """The site that a page shows.

    Attributes:
        site: with the zones that its file has now.
        feed: of the page.
    """

    site: ResolvedSite
    feed: Feed

    def body(self) -> dict[str, Any]:
        """Return the site for the page."""
        return describe(self.site)

    def rezone(self) -> None:
        """Take the zones of a site file that was changed."""
        with suppress(InputError):  # half written, or wrong: the edge says so
            zones = load_site(self.site.file.path).zone
            if zones != self.site.file.zone:
                self.site = replace(self.site, file=replace(self.site.file, zone=zones))
                self.feed.rezone(zones)


@dataclass(slots=True, eq=False)
class View(PageServer):
    """A site's page at work.

    Attributes:
        address: where it listens.
        rules: who may come in.
        feed: what it hands on.
    """

    address: Address
    rules: Rules[PageTokens]
    feed: Feed

    @property
    def tokens(self) -> Tokens:
        """Rights to read and write."""
        return self.rules.tokens.own


def open_view(
    site: ResolvedSite,
    listen: str | None = None,
    keys: Path | None = None,
    transport: Transport | None = None,
    report: Callable[[str], object] = lambda line: None,
    handle: int | None = None,
) -> View:
    """Serve a site over HTTP until the view is closed.

    Args:
        site: what its file says.
        listen: in place of the file's `HOST:PORT`.
        keys: folder of a viewer's certificate.
        transport: how to reach the edge; by default that of the site file.
        report: called with lines for operators.
        handle: of a socket that listens already, which the program was given.

    Raises:
        InputError: for a port that is taken, and all that is wrong in the file.
    """
    tokens = open_tokens(site.file.view.tokens)
    if handle is None:
        address, listening = take_port(site.file, listen, report)
    else:
        listening = socket.socket(fileno=handle)
        address = replace(address_of(site.file, listen), port=listening.getsockname()[1])
    here = address.is_open(site.file)
    rules = Rules(
        PageTokens(tokens, tuple(hub_tokens(site.file).values())),
        address.hosts,
        here,
        address.certificate is not None,
        frozenset(site.file.view.proxies),
        here,
    )
    rules.guesses.report = report
    feed = Feed(
        site.file.name,
        zones=Zones(site.file.zone),
        doing=page_watch(site),
        around=surroundings(site),
        names=StoredNames(
            None if site.file.store is None else site.file.store.place,
            site.file.name,
            kept_s=NAMES_S,
        ),
    )
    shown = Shown(site, feed)
    secure, watched = None, [Watched((site.file.path,), shown.rezone, lambda why: None)]
    with ExitStack() as stack:
        stack.callback(listening.close)
        if address.certificate is not None and address.key is not None:
            secure, renewal = https_of((address.certificate, address.key), report)
            watched.append(renewal)
        operator: str | None = LOCAL_OPERATOR
        if transport is None:
            link = viewer_link(site.file, keys, operates=True)
            operator, transport = operator_of(link), open_network(link)
        stack.callback(transport.close)
        feed.listen(transport)
        store = None if site.file.store is None else Store(site.file.store.place)

        def asking(topic: str, seconds: float) -> Ask:
            return lambda payload: transport.ask(topic, payload, seconds)

        ask = asking(of_control(site.file.name, operator), ASK_S) if operator is not None else None
        who, pictures = picture_rules(site.file, rules, operator is not None), None
        if who.shown:
            names = {i: of_camera(site.file.name, i, "picture") for i in site.rig.camera_ids}
            asks = {i: asking(name, PICTURE_S) for i, name in names.items()}
            pictures = make_pictures(
                site.rig, feed, asks, site.interval_s / site.file.pace, who.per_s
            )
        keep = keeping(site, report, stack)
        test = None if site.file.events is None else partial(send_test, site.file.path)
        joining = Joining(site.file, site.rig.camera_ids, report)
        made = PageContent(
            feed, store, shown.body, ask, pictures, who, report, keep, test, site.active_w,
            joining if joining.possible() else None,
        )  # fmt: skip
        serving = serve(make_app(made), rules, listening, secure)
        stack.callback(serving.close)
        ends = stack.pop_all()
    return View(address.url, serving, ends, tuple(watched), address, rules, feed)


def keeping(site: ResolvedSite, report: Callable[[str], object], stack: ExitStack) -> Keeping:
    """Return the clips, jobs and recordings that the page manages.

    Args:
        site: what its file says.
        report: called with lines for operators.
        stack: ends what is being made.
    """
    place, jobs = None, None
    if site.file.store is not None:
        place, jobs = (
            site.file.store.place,
            Jobs(site.file.folder.resolve() / FILES, site.file.path.resolve(), report),
        )
        stack.callback(jobs.close)
    recorded = any(camera.record is not None for camera in site.cameras.values())
    folder = site.file.record.path if recorded or site.file.record.path.is_dir() else None
    return Keeping(place, site.file.name, jobs, folder, report)


def picture_rules(site: SiteTable, rules: Rules[PageTokens], operates: bool) -> PictureRules:
    """Return the rules for pictures of a site.

    Args:
        site: its file.
        rules: of the page.
        operates: whether cameras admit the program's certificate.
    """
    wanted, here, why = site.view.pictures, rules.open_pictures, ""
    if wanted is None and not here:
        why = "Beyond loopback, pictures need pictures = true under [view] of the site file."
    elif wanted is not False and not operates:
        why = "Pictures need an operator's certificate: e3pose keys add desk --operator"
    shown = (here if wanted is None else wanted) and operates
    return PictureRules(shown, why, here, site.view.pictures_per_s)


def describe(site: ResolvedSite) -> dict[str, Any]:
    """Return a site as lists, numbers and strings; lengths of the drawing in millimetres.

    Args:
        site: what its file says.
    """
    low, high = bounds(site.rig, [])
    low[2] = min(low[2], 0.0)
    size_m = FRUSTUM_SHARE * float((high - low).max())
    return {
        "site": site.file.name,
        "fps": site.file.fps,
        "slots_per_s": site.file.fps * site.file.pace,
        "skeleton": site.skeleton.name,
        "joints": list(site.skeleton.joints),
        "limbs": [list(limb) for limb in site.skeleton.limbs],
        "neck": neck(site.skeleton),
        "cameras": list(site.rig.camera_ids),
        "titles": site.rig.titles,
        "centers_m": np.round(site.rig.centers_m, 4).tolist(),
        "frustums": [millimetres(frustum(camera, size_m)) for camera in site.rig.cameras],
        "low": millimetres(low),
        "high": millimetres(high),
        "floor": 0,
        "battery_wh": list(site.plan.battery_wh),
        "tells": site.file.events is not None,
        "zones": [{"name": z.name, "corners": z.corners} for z in site.file.zone],
    }
