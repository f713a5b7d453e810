"""`e3pose phone`: a phone as a camera."""

from __future__ import annotations

from pathlib import Path

from e3pose.camera.probe import probe
from e3pose.site.phones import show_phone


def phone(file: Path, /, *, keys: Path | None = None, listen: str | None = None) -> None:
    """Make a phone a camera: show the code that it scans, and wait for its first picture.

    Example: `e3pose phone anna.toml`, then `e3pose init room anna=phone:anna.toml usb:0`

    The phone opens a page of this machine by https and sends its camera's pictures as long as
    that page is in front. It warns of the certificate, which is of your own authority: compare the
    fingerprint. A code is good for one phone and for ten minutes; run the command again for another
    phone, or another address of this machine. Beyond loopback, this machine listens for the phone
    only while something reads it: this command, `e3pose setup`, a recording, the running site.

    Parameters
    ----------
    file
        File of the phone, NAME.toml, there or to be made; certificates lie beside it.
    keys
        Folder of `e3pose keys`, whose authority signs the certificate. Default: one of its own.
    listen
        Address of this machine at which the phone reaches it. Default: all.
    """
    shown = show_phone(file, keys, listen)
    print(
        f"{shown.drawn()}\nOpen on the phone, within {shown.minutes} minutes: {shown.url}\n"
        f"Fingerprint of the certificate: {shown.fingerprint}\n"
        f"This machine listens at port {shown.port} now. Waiting for the first picture; Ctrl-C "
        "ends.",
        flush=True,
    )
    seen = probe(shown.source, timeout_s=60 * shown.minutes)
    width, height = seen.image_size
    print(f"{file.stem}: {width} x {height}, {seen.rate_words()}; its source is {shown.source}")
