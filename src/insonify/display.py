"""Records that show themselves, in notebooks and as plots.

What is shown stands left in the house, and what draws it right, where it may import the records.
So a record here only asks for the one who draws, and the package's front door, which knows all
rooms, says who that is (`drawn_by`).  Nothing is imported for it before something is shown.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from insonify.errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Artist(Protocol):
    """Who draws: `insonify.report.showing`."""

    def plot(self, record: Any, axes: Axes | None, **options: Any) -> Axes:
        """Draw a record into axes, or into those of a new figure."""

    def picture(self, record: Any) -> bytes:
        """A record as PNG."""

    def page(self, record: Any) -> str:
        """A record as a piece of HTML: its figures, and pictures."""


_find: Callable[[], Any] | None = None


def drawn_by(find: Callable[[], Any]) -> None:
    """Say who draws.

    Args:
        find: Gives the `Artist`, asked each time that something is shown.
    """
    global _find
    _find = find


def _artist() -> Artist:
    assert _find is not None
    found: Artist = _find()
    return found


class Plotted:
    """What can be drawn into matplotlib axes."""

    __slots__ = ()

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw it.

        Args:
            axes: Where; by default those of a new figure, which notebooks show.

        Returns:
            The axes, to go on with.

        Raises:
            MissingExtraError: matplotlib is not installed.
        """
        return self._plotted(axes)

    def _plotted(self, axes: Axes | None, **options: Any) -> Axes:
        return _artist().plot(self, axes, **options)


class Pictured(Plotted):
    """What Jupyter shows as a picture."""

    __slots__ = ()

    def _repr_png_(self) -> bytes | None:
        try:
            return _artist().picture(self)
        except MissingExtraError:
            return None  # and Jupyter shows the text


class Told(Plotted):
    """What Jupyter shows as its figures beside a picture."""

    __slots__ = ()

    def _repr_html_(self) -> str | None:
        try:
            return _artist().page(self)
        except MissingExtraError:
            return None
