"""Make the files of one request: `python -m e3pose.site.keep.program FOLDER SITE`.

It reads the request as JSON from standard input and reports progress on standard output, one JSON
object per line, at the end with the files or the reason for none. A separate process keeps the page
answering, and can be killed at any time.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from e3pose.base.errors import Exit, InputError, reason_of
from e3pose.base.installing import not_installed
from e3pose.base.system import stand_back

SAY_S = 0.2  # between two lines about how far it is


def main(arguments: list[str]) -> int:
    """Make the requested files; return the exit code."""
    folder, site_file = Path(arguments[0]), Path(arguments[1])
    stand_back()
    told = json.load(sys.stdin)
    said_s = [0.0]

    def say(doing: str, share: float | None) -> None:
        if time.monotonic() - said_s[0] >= SAY_S:
            said_s[0] = time.monotonic()
            print(json.dumps({"doing": doing, "share": share}), flush=True)

    try:
        # Here, where loading them stands back and has words for what is missing.
        from e3pose.site.keep.making import make
        from e3pose.site.keep.request import ExportRequest

        request = ExportRequest(**{**told, "tracks": tuple(told["tracks"])})
        names, note = make(request, site_file, folder, say)
    except InputError as error:
        print(json.dumps({"problem": str(error.elsewhere())}), flush=True)
        return Exit.NO
    except ModuleNotFoundError as error:
        problem = f"on the machine of the page, {not_installed(error.name, 'all')}"
        print(json.dumps({"problem": problem}), flush=True)
        return Exit.NO
    except OSError as error:
        print(json.dumps({"problem": reason_of(error).lower()}), flush=True)
        return Exit.NO
    except MemoryError:
        print(json.dumps({"problem": "more than fits into memory: a shorter time"}), flush=True)
        return Exit.NO
    print(json.dumps({"files": names, "note": note}), flush=True)
    return Exit.DONE


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
