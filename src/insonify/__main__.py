"""Where the command starts: Ctrl-C is heard before anything heavy is imported."""

from __future__ import annotations

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
    from insonify.cli import main as run

    run()


if __name__ == "__main__":
    main()
