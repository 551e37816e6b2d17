"""Where the command starts: Ctrl-C is heard before anything heavy is imported."""

from __future__ import annotations

import gc
import os
import resource
import signal
import sys

from insonify.limits import LEAST_ADDRESS_SPACE_BYTES


def _stop(signum: int, frame: object) -> None:
    sys.stderr.write("insonify: interrupted; nothing was written\n")
    sys.stderr.flush()
    os._exit(130)


def _has_room() -> bool:
    """Whether ``ulimit -v`` leaves what the libraries map; short of it they end in a fault."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return limit == resource.RLIM_INFINITY or limit >= LEAST_ADDRESS_SPACE_BYTES


def main() -> None:
    """Run the command line."""
    signal.signal(signal.SIGINT, _stop)
    if not _has_room():
        sys.stderr.write(
            "insonify: the address space is limited (ulimit -v) to less than the "
            f"{LEAST_ADDRESS_SPACE_BYTES >> 20} MiB that its libraries need; raise the limit\n"
        )
        sys.exit(2)
    gc.set_threshold(50_000)  # what is imported stays, so looking through it often finds nothing
    from insonify.cli import main as run

    run()


if __name__ == "__main__":
    main()
