"""What the page adds to viser's: a name, keys that step from ping to ping, a phone's layout."""

from __future__ import annotations

import gzip
from typing import Any

_TITLE = b"<title>Viser</title>"
BACK, ON = "pageup", "pagedown"
"""The keys that the arrows become, as viser would turn the camera by those."""
_HEAD = """<title>insonify</title>
<style>
  @media (max-width: 36em) {
    html, body { height: 100%; overflow: hidden; }
    #root { height: 44vh !important; }
    [style*="max-height: 60%"] { max-height: 56vh !important; width: 100% !important; }
    [style*="max-height: 60%"] [style*="width: 20em"] { width: 100% !important; }
    [class*="Notifications-root"] { max-width: 15em; font-size: 0.8em; }
  }
</style>
<script>
  addEventListener("keydown", (event) => {
    const key = { ArrowLeft: "PageUp", ArrowRight: "PageDown" }[event.code];
    if (!key || event.ctrlKey || event.altKey || event.metaKey || event.shiftKey) return;
    if (event.target.closest?.("input, textarea, select")) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    event.target.dispatchEvent(new KeyboardEvent("keydown", { key, code: key, bubbles: true }));
  }, true);
</script>"""


def dressed(response: Any) -> Any:
    """A response of viser's, with our additions if it is the page itself.

    A page without the title that is known is left as it is: it works, but for keys and phones.
    """
    if response is None or "text/html" not in response.headers.get("Content-Type", ""):
        return response
    packed = response.headers.get("Content-Encoding") == "gzip"
    body = gzip.decompress(response.body) if packed else response.body
    body = body.replace(_TITLE, _HEAD.encode(), 1)
    response.body = gzip.compress(body, 1) if packed else body
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))
    return response
