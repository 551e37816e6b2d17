"""A session on our own page: its pings, the map as it grows, and the scans that are planned."""

from __future__ import annotations

import time

from insonify.live.session import Event, Finished, Heard, Planned, Session, Tick
from insonify.mission.remap import moved
from insonify.types import Box
from insonify.view.page import Page
from insonify.view.story import MOST_MOMENTS, Story

_EVERY_S, _MOST_SHARE = 1.0, 0.05
"""Between two pictures of the map; what of the time they may take, since pings wait for them."""
_PATIENCE_S = 2.0
"""How long is waited for a ping whose picture is kept for good."""


class Narrator:
    """Tells a session to a page's story (a watcher of the session)."""

    def __init__(self, page: Page, story: Story, region: Box | None) -> None:
        """Nothing told yet.

        Args:
            page: Shows it.
            story: What the page shows.
            region: Where uncertainty counts, in the world; None for around what is occupied.
        """
        self.story = story
        self._page, self._region = page, region
        self._due_s = 0.0
        self._scan = 1
        self._behind = False

    def watch(self, session: Session, event: Event) -> None:
        """Tell what has happened."""
        if isinstance(event, Heard):
            if len(self.story.moments) >= MOST_MOMENTS:
                self.story = self.story.halved()
                self._page.show(self.story)
            origin_m = session.remap.mapper.voxels.origin_m
            self.story.add_ping(moved(event.posed, origin_m), self._scan)
            self._behind = True
            if self._is_due():
                self._add_map(session)
            self.story.changed()
        elif isinstance(event, Tick):
            if self._behind and self._is_due():
                self._add_map(session)
                self.story.changed()
        elif isinstance(event, Planned):
            self._scan = 1 + event.scans
            if event.answer.decision is not None:
                self.story.decisions.append((len(self.story.moments), event.answer.decision))
                self.story.changed()
        elif isinstance(event, Finished):
            if self.story.moments:
                self._add_map(session)
            counts = session.counts
            self.story.end = f"It has ended: {counts.mapped} of {counts.pings} pings are mapped."
            self.story.changed()

    def _is_due(self) -> bool:
        """Whether to take a picture of the map: soon at a ping whose picture is kept for good."""
        over_s = time.monotonic() - self._due_s
        kept = self.story.maps.wants(len(self.story.moments))
        return over_s >= 0.0 if kept else over_s >= _PATIENCE_S

    def _add_map(self, session: Session) -> None:
        voxels = session.remap.mapper.voxels
        if not voxels.block_count:
            return
        begun_s, self._behind = time.monotonic(), False
        region = self._region
        shown = None if region is None else region.relative_to(voxels.origin_m)
        self.story.add_map(voxels, shown or voxels.around_occupied())
        took_s = time.monotonic() - begun_s
        self._due_s = begun_s + max(_EVERY_S, took_s / _MOST_SHARE)
