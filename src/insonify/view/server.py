"""A web server with an empty page, up before anything is read, so that its address can be told."""

from __future__ import annotations

import atexit
import contextlib
import errno
import io
import socket

from insonify.errors import OutputError
from insonify.extras import optional
from insonify.view.guard import guarded

_PORTS_TRIED = 100


class Server:
    """viser's server, which answers no other web page (`insonify.view.guard`).

    Attributes:
        viser: The server.
        url: Where it is.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Start serving.

        Args:
            host: Address to listen at; 0.0.0.0 is every one.
            port: The first free one from here on.

        Raises:
            MissingExtraError: The package viser is not installed.
            OutputError: There is no such address here, or no free port.
        """
        viser = optional("viser", "view", "the view in the browser")
        port = _free_port(host, port)
        with (
            contextlib.redirect_stdout(io.StringIO()),  # where it announces itself
            guarded(host),
        ):
            self.viser = viser.ViserServer(host=host, port=port, label="insonify", verbose=False)
        atexit.unregister(self.viser.stop)  # which says so on stdout
        self.url = f"http://{host}:{self.viser.get_port()}"
        gui = self.viser.gui
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(360)
        self.viser.scene.set_up_direction("+z")

    def close(self) -> None:
        """Stop serving."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.viser.stop()


def _free_port(host: str, port: int) -> int:
    """The first port from here on that nobody listens at."""
    for candidate in range(port, min(port + _PORTS_TRIED, 65536)):
        try:
            with socket.create_server((host, candidate)):
                return candidate
        except OSError as err:
            if err.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise OutputError(
                    f"the view cannot be served at {host}:{candidate} "
                    f"({err.strerror or err}); give another --host"
                ) from err
    raise OutputError(
        f"the view cannot be served at {host}: no free port from {port} on; give another --port"
    )
