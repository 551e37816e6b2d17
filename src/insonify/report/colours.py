"""Colours that mean the same in every picture and page, told apart by people of all kinds of sight.

Blue and orange, after Okabe and Ito (https://jfly.uni-koeln.de/color/).
"""

from __future__ import annotations

INK, SOFT, PALE = "#1d2733", "#7a8794", "#dfe7ee"
BLUE, SKY, ORANGE, PURPLE = "#0072b2", "#56b4e9", "#e07b00", "#a9538c"
CORRECT, FALSE_ALARM, MISSED = BLUE, ORANGE, "#39424c"
"""Voxels that are there, that are not, and that were not found."""
UNSEEN = "#aab4be"
_SCANS = (BLUE, ORANGE, PURPLE, SKY, "#8a6d00", "#005f8f", "#b34700", "#6f7d8c")


def scan_colour(number: int) -> str:
    """The colour of a scan, counted from 1, in every picture of it."""
    return _SCANS[(number - 1) % len(_SCANS)]


def series(number: int) -> tuple[str, str]:
    """The colour and the line style of one of many curves, counted from 0."""
    return _SCANS[number % len(_SCANS)], ("-", "--", "-.", ":")[number // len(_SCANS) % 4]
