"""Where the command starts: Ctrl-C is heard before anything heavy is imported."""

from __future__ import annotations

import gc
import os
import signal
import sys


def _stop(signum: int, frame: object) -> None:
    sys.stderr.write("insonify: interrupted; nothing was written\n")
    sys.stderr.flush()
    os._exit(130)


def main() -> None:
    """Run the command line."""
    signal.signal(signal.SIGINT, _stop)
    gc.set_threshold(50_000)  # what is imported stays, so looking through it often finds nothing
    from insonify.cli import main as run

    run()


if __name__ == "__main__":
    main()
