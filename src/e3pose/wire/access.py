"""Zenoh configuration: endpoints, certificates and access rules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from e3pose.base.errors import InputError
from e3pose.wire.codec import MAX_BYTES
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.topics import ANY, of_camera, of_control, of_order, of_outbox, of_site

LEASE_MS = 1500  # a frozen peer is given up after it; Zenoh's own 10 s is too long
# Zenoh lets 2 messages wait for its own sending thread and drops the next after a millisecond: a
# busy machine loses whole poses. 16 is the most it takes: 1 MB a connection, where it is needed.
WAITING_MESSAGES = 16
# Of a link, before anybody looks at who says what: Zenoh holds up to 1 GB of an unfinished message
# otherwise, also of a certificate that may say nothing. A session holds 16 such messages at most,
# two of each priority. Zenoh 1.10 can do with one priority, but then a link that was once full
# drops everything from there on: what ends that looks at the wrong one.
MESSAGE_BYTES = MAX_BYTES + 2**12  # with its topic
VIEW_BYTES = 2**19  # 256 people with 133 keypoints
EDGE_BYTES = VIEW_BYTES + 2**12  # nothing larger than a view comes to an edge
MAX_SESSIONS = 128  # programs of a site that may be connected: 1 GB of unfinished messages
CLIENT_MS = 2000  # of one attempt of a client to join, which nothing can end before
JOIN_MS = 5000  # who has shown a certificate and says nothing more is given up after it
WORD_BYTES = 2**15  # hello and heartbeat: some hundred bytes, and the names of many joints
SIZES = {"view": VIEW_BYTES, "hello": WORD_BYTES, "heartbeat": WORD_BYTES, "clock": WORD_BYTES}
SPEAK = ["put", "delete", "liveliness_token", "query", "reply"]
LISTEN = [
    "declare_subscriber",
    "declare_queryable",
    "liveliness_query",
    "declare_liveliness_subscriber",
]
PASS = [*SPEAK, *LISTEN]
HEAR = ["put", "delete", "query", "reply", "declare_subscriber", "liveliness_token"]
Kind = Literal["camera", "viewer", "operator", "hub", "router"]  # of holders of certificates
KINDS: tuple[Kind, ...] = get_args(Kind)
Rights = dict[str, tuple[str, list[str], list[str]]]  # by name: direction, messages, topics


@dataclass(frozen=True, slots=True)
class Certificates:
    """The files with which a program authenticates.

    Attributes:
        authority: certificate of the site's authority.
        certificate: of the program.
        key: its private key.
    """

    authority: Path
    certificate: Path
    key: Path


@dataclass(frozen=True, slots=True)
class Link:
    """The connection of a program to its site.

    Attributes:
        role: the `edge` routes for its site, and so does a `router` before it; a `camera` or a
            `viewer` connects to one of them.
        site: the name of the site.
        endpoint: where the edge listens and others connect.
        certificates: for `tls`.
        upstream: routers that an edge connects to, so that sites share them; of a router, the edge.
        insecure: whether plain `tcp` beyond this machine is allowed.
    """

    role: Literal["edge", "router", "camera", "viewer"]
    site: str
    endpoint: Endpoint
    certificates: Certificates | None = None
    upstream: tuple[Endpoint, ...] = ()
    insecure: bool = False


@dataclass(frozen=True, slots=True)
class Roll:
    """The holders of certificates.

    Attributes:
        site: name of the site.
        cameras: camera id to the common name of its certificate.
        viewers: viewer to the common name of its certificate.
        operators: operator to the common name of its certificate.
        hubs: hub to the common name of its certificate.
        routers: router to the common name of its certificate.
        revoked: common names that are worthless.
        count: certificates made so far.
    """

    site: str
    cameras: Mapping[str, str] = field(default_factory=dict)
    viewers: Mapping[str, str] = field(default_factory=dict)
    operators: Mapping[str, str] = field(default_factory=dict)
    hubs: Mapping[str, str] = field(default_factory=dict)
    routers: Mapping[str, str] = field(default_factory=dict)
    revoked: tuple[str, ...] = ()
    count: int = 0

    @property
    def holders(self) -> dict[Kind, Mapping[str, str]]:
        """Of each kind, name to the common name of its certificate."""
        return {kind: getattr(self, f"{kind}s") for kind in KINDS}

    @property
    def common_names(self) -> tuple[str, ...]:
        """Issued and revoked names."""
        given = (name for names in self.holders.values() for name in names.values())
        return (*given, *self.revoked)

    @property
    def newest(self) -> int:
        """The largest number in a common name; it is never given again, whatever the count says."""
        return max([self.count, *(int(name.rpartition("#")[2]) for name in self.common_names)])


def check_link(link: Link) -> None:
    """Raise `InputError` for an endpoint that is unencrypted, or no certificates for it."""
    encrypted = link.endpoint.encrypted
    if not (encrypted or link.endpoint.here_alone or link.insecure):
        raise InputError(
            "endpoint",
            f"{link.endpoint}, plain tcp beyond this machine",
            "tls (make certificates with `e3pose keys init`) or insecure = true, "
            "--insecure at a camera",
        )
    if encrypted and link.certificates is None:
        raise InputError(
            "endpoint", f"{link.endpoint}, tls without certificates", "the folder of `e3pose keys`"
        )
    if not routes(link) and link.endpoint.port == 0:
        raise InputError("endpoint", link.endpoint, "the port of the edge")


def routes(link: Link) -> bool:
    """Return whether others connect to the program, which then enforces access."""
    return link.role in ("edge", "router")


def zenoh_config(link: Link, roll: Roll | None = None) -> dict[str, Any]:
    """Return the configuration of a program's Zenoh session.

    Args:
        link: how it joins.
        roll: of an edge or router with tls: who may say and hear what. Who is not here may connect,
            but neither read nor write. A router trusts the edge of its site too.
    """
    check_link(link)
    config: dict[str, Any] = {
        # A router passes nothing from one peer to another. So a viewer, who asks cameras for
        # pictures, is a client; a camera is a peer, which needs no edge to open.
        "mode": "router" if routes(link) else "client" if link.role == "viewer" else "peer",
        "listen": {"endpoints": [str(link.endpoint)] if routes(link) else []},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "timestamping": {"enabled": True},
        "transport": {
            "unicast": {
                "max_sessions": MAX_SESSIONS,
                "max_links": 1,
                "accept_timeout": JOIN_MS,
            },
            # A pool of 17 MB for each session that ever sends some kilobytes to its own machine.
            "shared_memory": {"enabled": False},
            "link": {
                "rx": {"max_message_size": EDGE_BYTES if link.role == "edge" else MESSAGE_BYTES},
                "tx": {
                    "lease": LEASE_MS,
                    "keep_alive": 3,
                    "queue": {"size": {"data": WAITING_MESSAGES}},
                },
            },
        },
    }
    connect = {
        "timeout_ms": CLIENT_MS if link.role == "viewer" else -1,
        "exit_on_failure": False,
        "retry": {"period_init_ms": 200, "period_max_ms": 500, "period_increase_factor": 1.5},
    }
    if routes(link):
        if link.upstream:
            config["connect"] = {"endpoints": [str(each) for each in link.upstream], **connect}
    else:
        config["connect"] = {"endpoints": [str(link.endpoint)], **connect}
    if link.endpoint.encrypted and link.certificates is not None:
        files = link.certificates
        config["transport"]["link"]["tls"] = {
            "root_ca_certificate": str(files.authority),
            "listen_certificate": str(files.certificate),
            "listen_private_key": str(files.key),
            "connect_certificate": str(files.certificate),
            "connect_private_key": str(files.key),
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
        if routes(link):
            config["access_control"] = _access(link, roll or Roll(link.site))
    if routes(link):
        config["low_pass_filter"] = [  # Zenoh drops larger messages of cameras
            {
                "id": f"size-{what}",
                "flows": ["ingress"],
                "messages": ["put", "query"],
                "key_exprs": [of_camera(link.site, ANY, what)],
                "size_limit": size,
            }
            for what, size in SIZES.items()
        ]
    return config


def edge_name(site: str) -> str:
    """Return the common name of the certificate of a site's edge."""
    return f"{site}#edge"


def holder_of(common_name: str) -> str:
    """Return to whom a certificate was given, `cam1` for `cam1#2`."""
    return common_name.rpartition("#")[0]


def _access(link: Link, roll: Roll) -> dict[str, Any]:
    """Return the access rules: the topics that each program may publish and hear.

    Cameras say what they see and hear their orders. Viewers hear poses and status, and operators
    may also control the edge. Hubs ask for summaries and hear nothing else. Routers pass on
    whatever the site says, and are trusted to let each camera say and hear its own alone.
    """
    site, trusted = link.site, dict(roll.routers)
    if link.role == "router":
        trusted["#edge"] = edge_name(site)
    rights: dict[tuple[str, str], Rights] = {}  # by subject and common name
    alive = of_site(site, "alive")
    for camera_id, name in roll.cameras.items():
        own, order = of_camera(site, camera_id, "**"), of_order(site, camera_id)
        rights[f"camera-{camera_id}", name] = {
            "speaks": ("ingress", SPEAK, [own]),
            "listens": ("ingress", LISTEN, [order, alive, of_camera(site, camera_id, "picture")]),
            "hears": ("egress", HEAR, [order, alive]),
            "asks": ("egress", ["reply"], [own]),
            "asked": ("egress", ["query"], [of_camera(site, camera_id, "picture")]),
        }
    shown = [of_site(site, what) for what in ("poses", "poses-delayed", "status", "alive")]
    looks: Rights = {"listens": ("ingress", LISTEN, shown), "hears": ("egress", HEAR, shown)}
    for viewer, name in roll.viewers.items():
        rights[f"viewer-{viewer}", name] = looks
    for hub, name in roll.hubs.items():
        outbox = [of_outbox(site, holder_of(name))]
        rights[f"hub-{hub}", name] = {
            "asks": ("ingress", ["query"], outbox),
            "gets": ("egress", ["reply"], outbox),
        }
    for operator, name in roll.operators.items():
        control = [of_control(site, holder_of(name)), of_camera(site, ANY, "picture")]
        rights[f"operator-{operator}", name] = {
            **looks,
            "asks": ("ingress", ["query"], control),
            "gets": ("egress", ["reply"], control),
        }
    for router, name in trusted.items():
        rights[f"router-{router}", name] = {
            "takes": ("ingress", PASS, [of_site(site, "**")]),
            "gives": ("egress", PASS, [of_site(site, "**")]),
        }
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {
                "id": f"{subject}-{what}",
                "permission": "allow",
                "flows": [flow],
                "messages": messages,
                "key_exprs": topics,
            }
            for (subject, _), each in rights.items()
            for what, (flow, messages, topics) in each.items()
        ],
        "policies": [
            {"rules": [f"{subject}-{what}" for what in each], "subjects": [subject]}
            for (subject, _), each in rights.items()
        ],
        "subjects": [{"id": subject, "cert_common_names": [name]} for subject, name in rights],
    }
