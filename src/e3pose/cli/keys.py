"""`e3pose keys`: certificates of a site."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter
from rich.console import Console
from rich.table import Table
from rich.text import Text

from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError
from e3pose.base.quantities import shell
from e3pose.cli.options import Flag
from e3pose.cli.output import wrote
from e3pose.settings.site_file import load_site
from e3pose.site.joining import let_one_join
from e3pose.wire.access import Kind
from e3pose.wire.keys.folder import MAX_PEM_BYTES, add_keys, init_keys, read_roll, revoke_keys
from e3pose.wire.keys.renewal import AUTHORITY, expiring, renew_keys

keys_app = App(name="keys", help="Create, list and revoke the certificates of a site.")
DEFAULT = Path("keys")


@keys_app.command(name="init")
def init(
    site: str,
    /,
    *,
    host: Annotated[list[str] | None, Parameter(negative="")] = None,
    out: Path = DEFAULT,
) -> None:
    """Create the certificate authority of a site and the certificate of its edge server.

    Example: `e3pose keys init lab --host edge.local --host 192.168.1.10`

    Keep the folder on the edge server. `authority.key` can sign any certificate of the site.

    Parameters
    ----------
    site
        Site name.
    host
        Host name or address at which cameras reach the edge; repeatable. localhost is included.
    out
        Folder to create.
    """
    init_keys(out, site, host or [], _now())
    print(
        f"Wrote {out}: certificates of site {site}; next: e3pose keys add CAMERA "
        f"--keys {shell(out)}"
    )


@keys_app.command(name="add")
def add(
    name: str,
    /,
    *,
    keys: Path = DEFAULT,
    viewer: Flag = False,
    operator: Flag = False,
    hub: Flag = False,
    router: Flag = False,
    host: Annotated[list[str] | None, Parameter(negative="")] = None,
    again: Flag = False,
) -> None:
    """Create the certificate of a camera, viewer, operator, hub or router; print its folder.

    Example: `e3pose keys add cam1`, then `scp -r keys/cameras/cam1 cam1.local:`

    A camera cannot read or forge the messages of another camera. A running edge accepts the new
    certificate within seconds.

    Parameters
    ----------
    name
        Camera id, as in the calibration; or any name for the others.
    keys
        Folder from `e3pose keys init`.
    viewer
        Create a viewer: a program that may read poses and status only.
    operator
        Create an operator: a viewer that may also control the edge, such as `e3pose view`.
    hub
        Create a hub: a program that may fetch summaries only, and sees no pose; see `e3pose hub`.
    router
        Create a router, which forwards all messages of the site; see `e3pose router`.
    host
        With --router: host name or address at which cameras reach it; repeatable.
    again
        Replace the existing certificate and revoke the old one.
    """
    kinds: dict[Kind, bool] = {
        "viewer": viewer, "operator": operator, "hub": hub, "router": router,
    }  # fmt: skip
    chosen = [kind for kind, asked in kinds.items() if asked]
    if len(chosen) > 1:
        raise InputError(f"--{chosen[1]}: found with --{chosen[0]}, expected one of them")
    if host and not router:
        raise InputError("--host: found without --router, expected both")
    kind: Kind = chosen[0] if chosen else "camera"
    made = add_keys(keys, name, _now(), kind, again, host or [])
    wrote(made, f"certificate of {kind} {name}; copy the folder to its machine")


@keys_app.command(name="join")
def join(site: Path, /) -> None:
    """Let one camera join: show a code of six digits for two minutes, and sign the camera's key.

    Example: `e3pose keys join site.toml`, then `e3pose camera --join --name cam1 --source usb:0` on
    the camera

    The page of a running site does the same with *Let a camera join*. The camera needs no copied
    folder: its private key is made there and stays there. A code is good for one try.

    Parameters
    ----------
    site
        Site file, or the folder that contains site.toml.
    """
    let_one_join(load_site(site), lambda line: print(line, flush=True))


@keys_app.command(name="renew")
def renew(name: list[str] | None = None, /, *, keys: Path = DEFAULT) -> None:
    """Renew certificates before they expire, without revoking those in use.

    Example: `e3pose keys renew`, or `e3pose keys renew edge cam1`

    A running edge takes its own within seconds. Copy the other folders to their machines and
    restart the programs there, at any time before the old certificates expire.

    Parameters
    ----------
    name
        `edge`, cameras, viewers, operators, hubs or routers. Default: those that expire within
        30 days.
    keys
        Folder from `e3pose keys init`.
    """
    names = name or [one for one, _ in expiring(keys, _now()) if one != AUTHORITY]
    for one in names:
        made = renew_keys(keys, one, _now())
        print(f"{one}: renewed in {made}" + ("" if one == "edge" else "; copy it to its machine"))
    if not names:
        print("no certificate expires within 30 days")


@keys_app.command(name="revoke")
def revoke(name: str, /, *, keys: Path = DEFAULT) -> None:
    """Revoke the certificate of a camera, viewer, operator, hub or router.

    Example: `e3pose keys revoke cam1`

    A running edge rejects it within seconds.

    Parameters
    ----------
    name
        Camera, viewer, operator, hub or router.
    keys
        Folder from `e3pose keys init`.
    """
    revoke_keys(keys, name)
    print(f"{name}: revoked")


@keys_app.command(name="list")
def list_keys(*, keys: Path = DEFAULT) -> None:
    """List certificates and their expiry dates.

    Example: `e3pose keys list`

    Parameters
    ----------
    keys
        Folder from `e3pose keys init`.
    """
    roll = read_roll(keys)
    table = Table("name", "role", "valid until", "certificate", box=None, pad_edge=False)
    rows = [("edge", "edge", f"{roll.site}#edge", keys / "edge.pem")]
    for kind, names in roll.holders.items():
        rows += [
            (name, kind, common_name, keys / f"{kind}s" / name / f"{kind}.pem")
            for name, common_name in names.items()
        ]
    for name, role, common_name, path in rows:
        table.add_row(Text(name), role, _until(path), Text(common_name))
    for common_name in roll.revoked:
        table.add_row(Text(common_name.rpartition("#")[0]), "revoked", "", Text(common_name))
    Console().print(table)


def _until(path: Path) -> str:
    from e3pose.wire.keys.authority import expires

    if not path.exists():
        return "file missing"
    try:
        return f"{expires(read_bytes(path, MAX_PEM_BYTES)):%Y-%m-%d}"
    except InputError:
        return "file damaged"


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.timezone.utc)
