"""`e3pose keys`: certificates of a site."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from e3pose.errors import InputError

if TYPE_CHECKING:
    from e3pose.wire.keys.folder import Kind

keys_app = App(name="keys", help="Make, list and revoke the certificates of a site.")
DEFAULT = Path("keys")


@keys_app.command(name="init")
def init(
    site: str,
    /,
    *,
    host: Annotated[list[str] | None, Parameter(negative="")] = None,
    out: Path = DEFAULT,
) -> None:
    """Make the authority of a new site and the certificate of its edge server.

    Example: `e3pose keys init lab --host edge.local --host 192.168.1.10`

    The folder stays on the edge server. Whoever has its `authority.key` can let anybody in.

    Parameters
    ----------
    site
        Name of the site.
    host
        Names and addresses under which cameras reach the edge; localhost is always one.
    out
        The folder to make.
    """
    from e3pose.wire.keys.folder import init_keys

    init_keys(out, site, host or [], _now())
    print(f"{out}: made for site {site}; next: e3pose keys add CAMERA --keys {out}")


@keys_app.command(name="add")
def add(
    name: str,
    /,
    *,
    keys: Path = DEFAULT,
    viewer: Annotated[bool, Parameter(negative="")] = False,
    router: Annotated[bool, Parameter(negative="")] = False,
    host: Annotated[list[str] | None, Parameter(negative="")] = None,
    again: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Make the certificate of a camera, viewer or router, and print the folder to carry to it.

    Example: `e3pose keys add cam1`, then `scp -r keys/cameras/cam1 cam1.local:`

    A camera can neither read nor forge what another one says. A running edge lets it in within
    seconds.

    Parameters
    ----------
    name
        The camera, as the calibration names it.
    keys
        The folder that `e3pose keys init` made.
    viewer
        Not a camera: a program that may look at poses and status, and nothing else.
    router
        Not a camera: a router before the edge, trusted with all that the site says, see
        `e3pose router`.
    host
        Names and addresses under which cameras reach that router.
    again
        Replace the certificate that it has, which is then worthless.
    """
    from e3pose.wire.keys.folder import add_keys

    if viewer and router:
        raise InputError("--router: found it with --viewer, expected one of them")
    if host and not router:
        raise InputError("--host: found it without --router, expected both: others are not called")
    kind: Kind = "viewer" if viewer else "router" if router else "camera"
    print(add_keys(keys, name, _now(), kind, again, host or []))


@keys_app.command(name="revoke")
def revoke(name: str, /, *, keys: Path = DEFAULT) -> None:
    """Make the certificate of a camera, viewer or router worthless: lost, stolen, given away.

    Example: `e3pose keys revoke cam1`

    A running edge shuts it out within seconds.

    Parameters
    ----------
    name
        The camera, viewer or router.
    keys
        The folder that `e3pose keys init` made.
    """
    from e3pose.wire.keys.folder import revoke_keys

    revoke_keys(keys, name)
    print(f"{name}: revoked")


@keys_app.command(name="list")
def list_keys(*, keys: Path = DEFAULT) -> None:
    """List who has a certificate, and until when.

    Example: `e3pose keys list`

    Parameters
    ----------
    keys
        The folder that `e3pose keys init` made.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from e3pose.wire.keys.folder import read_roll

    roll = read_roll(keys)
    table = Table("name", "what", "valid until", "certificate", box=None, pad_edge=False)
    rows = [("edge", "edge", f"{roll.site}#edge", keys / "edge.pem")]
    for kind, people in (
        ("camera", roll.cameras),
        ("viewer", roll.viewers),
        ("router", roll.routers),
    ):
        rows += [
            (name, kind, common_name, keys / f"{kind}s" / name / f"{kind}.pem")
            for name, common_name in people.items()
        ]
    for name, kind, common_name, path in rows:
        table.add_row(Text(name), kind, _until(path), Text(common_name))
    for common_name in roll.revoked:
        table.add_row(Text(common_name.rpartition("#")[0]), "revoked", "", Text(common_name))
    Console().print(table)


def _until(path: Path) -> str:
    from e3pose.files.bounded import read_bytes
    from e3pose.wire.keys.authority import expires
    from e3pose.wire.keys.folder import MAX_PEM_BYTES

    if not path.exists():
        return "file is gone"
    try:
        return f"{expires(read_bytes(path, MAX_PEM_BYTES)):%Y-%m-%d}"
    except InputError:
        return "file is damaged"


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.timezone.utc)
