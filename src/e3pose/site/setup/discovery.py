"""Find ONVIF cameras in the local network by WS-Discovery, on request.

One question goes to the multicast address of WS-Discovery 1.0; cameras answer with their name and
the address of their service, which `onvif.streams_of` asks for their streams.
"""

from __future__ import annotations

import re
import socket
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import unquote, urlsplit

from e3pose.site.setup.onvif import parse

GROUP = ("239.255.255.250", 3702)
WAIT_S = 3.0
MAX_BYTES, MOST_ANSWERS = 65_507, 64
PROBE = """<?xml version="1.0" encoding="UTF-8"?>
<e:Envelope xmlns:e="http://www.w3.org/2003/05/soap-envelope"
 xmlns:w="http://schemas.xmlsoap.org/ws/2004/08/addressing"
 xmlns:d="http://schemas.xmlsoap.org/ws/2005/04/discovery"
 xmlns:dn="http://www.onvif.org/ver10/network/wsdl">
<e:Header><w:MessageID>uuid:{id}</w:MessageID>
<w:To e:mustUnderstand="true">urn:schemas-xmlsoap-org:ws:2005:04:discovery</w:To>
<w:Action e:mustUnderstand="true">http://schemas.xmlsoap.org/ws/2005/04/discovery/Probe</w:Action>
</e:Header><e:Body><d:Probe><d:Types>dn:NetworkVideoTransmitter</d:Types></d:Probe></e:Body>
</e:Envelope>"""


@dataclass(frozen=True, slots=True)
class NetworkCamera:
    """A camera that answered.

    Attributes:
        host: its address.
        name: that it states, of its make and model; empty if it states none.
        service: address of its device service; empty where it tells none that is usable.
    """

    host: str
    name: str
    service: str = ""


def look_around(wait_s: float = WAIT_S, to: tuple[str, int] = GROUP) -> list[NetworkCamera]:
    """Ask the local network for cameras; return the answers that come in time.

    Args:
        wait_s: how long to wait for answers.
        to: whom to ask.
    """
    asked = str(uuid.uuid4())
    found: dict[str, NetworkCamera] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)  # no router passes it on
        out.sendto(PROBE.format(id=asked).encode(), to)
        end_s = time.monotonic() + wait_s
        for _ in range(MOST_ANSWERS):
            left_s = end_s - time.monotonic()
            if left_s <= 0:
                break
            out.settimeout(left_s)
            try:
                answer, (host, _port) = out.recvfrom(MAX_BYTES)
            except TimeoutError:
                break
            if (camera := read_answer(answer, asked, str(host))) is not None:
                found[camera.host] = camera
    return [found[host] for host in sorted(found)]


def read_answer(answer: bytes, asked: str, sender: str) -> NetworkCamera | None:
    """Return the camera that an answer tells of; None for another message.

    Args:
        answer: the datagram.
        asked: identifier of our question.
        sender: the address that it came from, the only one that is believed.
    """
    root = parse(answer)
    if root is None:
        return None
    words: dict[str, list[str]] = {"RelatesTo": [], "Scopes": [], "XAddrs": []}
    for node in root.iter():  # whatever their namespaces
        words.get(node.tag.rpartition("}")[2], []).append(node.text or "")
    if not any(asked in word for word in words["RelatesTo"]) or not words["XAddrs"]:
        return None
    urls = [url for text in words["XAddrs"] for url in text.split()[:8] if _host(url) == sender]
    if not urls:
        return None
    name = _name(" ".join(words["Scopes"]).split())
    return NetworkCamera(sender, name, next((u for u in urls if u.startswith("http://")), urls[0]))


def _host(url: str) -> str | None:
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None


def _name(scopes: Sequence[str]) -> str:
    """Return make and model of `onvif://www.onvif.org/name/...` scopes."""
    parts = []
    for key in ("name", "hardware"):
        for scope in scopes:
            if match := re.fullmatch(rf"onvif://www\.onvif\.org/{key}/(.{{1,100}})", scope):
                text = unquote(match[1])
                if text.isprintable() and text not in parts:
                    parts.append(text)
                break
    return " ".join(parts)[:100]
