"""What a session sends, served to Foxglove: the same topics, types and bytes as on the bus."""

from __future__ import annotations

from typing import Any

from insonify.errors import ConfigError, reason
from insonify.extras import optional
from insonify.io.recordings.ros.messages import message_types
from insonify.live.played import FREQUENCY_HZ, SONAR, SOUND_SPEED_MPS
from insonify.live.session import Event, Heard, Session
from insonify.results.replay import posed_messages

LOOPBACK, PORT = "127.0.0.1", 8765
_FOR_EYES = {f"/{SONAR}/polar", "/odometry", "/tf"}
"""Of a ping's messages, those that are served."""


class FoxgloveServer:
    """A WebSocket server of Foxglove's protocol; a watcher of a session, and where to send."""

    def __init__(self, host: str = LOOPBACK, port: int = PORT) -> None:
        """Serve at an address.

        Args:
            host: This machine alone by default; 0.0.0.0 for others too, who need no password.
            port: 0 for any that is free.

        Raises:
            ConfigError: The address cannot be had.
            MissingExtraError: foxglove-sdk is not installed.
        """
        self._foxglove: Any = optional("foxglove", "live", "Foxglove")
        self._context = self._foxglove.Context()
        self._channels: dict[str, Any] = {}
        try:
            self._server = self._foxglove.start_server(
                name="insonify live", host=host, port=port, context=self._context
            )
        except (OSError, RuntimeError, ValueError) as err:
            raise ConfigError(
                f"Foxglove cannot be served at {host}:{port} ({reason(err)}); give another port "
                "(--port)"
            ) from err
        self.url = f"ws://{host}:{self._server.port}"

    def send(self, topic: str, message: Any) -> None:
        """Serve a message."""
        kind = message.__msgtype__
        if topic not in self._channels:
            text, _ = message_types().generate_msgdef(kind, ros_version=2)
            schema = self._foxglove.Schema(name=kind, encoding="ros2msg", data=text.encode())
            self._channels[topic] = self._foxglove.Channel(
                topic, schema=schema, message_encoding="cdr", context=self._context
            )
        self._channels[topic].log(bytes(message_types().serialize_cdr(message, kind)))

    def watch(self, session: Session, event: Event) -> None:
        """Serve a ping's picture, and where it was."""
        if isinstance(event, Heard):
            told = posed_messages(SONAR, event.posed, event.stamp_ns, FREQUENCY_HZ, SOUND_SPEED_MPS)
            for topic in _FOR_EYES & set(told):
                self.send(topic, told[topic])

    def close(self) -> None:
        """Serve no more."""
        self._server.stop()
