"""An autopilot for tests, of pymavlink's own, in a thread."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any


@dataclass
class Autopilot:
    """Sends heartbeats, asks for a mission's items, and answers as it is told to."""

    port: int
    answer: int = 0
    whole: bool = True
    deaf_to: int = 0
    counts: list[int] = field(default_factory=list)
    items: list[Any] = field(default_factory=list)
    over: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        mavutil: Any = import_module("pymavlink.mavutil")
        link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{self.port}", source_system=7)

        def ask(number: int) -> None:
            send = (
                link.mav.mission_request_int_send if self.whole else link.mav.mission_request_send
            )
            send(255, 0, number)

        beaten_s = 0.0
        count = 0
        while not self.over.is_set():
            if time.monotonic() - beaten_s > 0.1:
                link.mav.heartbeat_send(12, 3, 0, 0, 4)  # a submarine by ArduPilot
                beaten_s = time.monotonic()
            message = link.recv_match(blocking=True, timeout=0.02)
            kind = "" if message is None else message.get_type()
            if kind == "MISSION_COUNT" and self.deaf_to > 0:
                self.deaf_to -= 1
            elif kind == "MISSION_COUNT":
                count = message.count
                self.counts.append(count)
                ask(0)
            elif kind in ("MISSION_ITEM_INT", "MISSION_ITEM") and message.seq == len(self.items):
                self.items.append(message)
                if len(self.items) < count:
                    ask(len(self.items))
                else:
                    link.mav.mission_ack_send(255, 0, self.answer)
        link.close()


@contextmanager
def autopilot() -> Iterator[Autopilot]:
    """One that flies at a port of its own."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        made = Autopilot(free.getsockname()[1])
    thread = threading.Thread(target=made.run)
    thread.start()
    try:
        yield made
    finally:
        made.over.set()
        thread.join()
