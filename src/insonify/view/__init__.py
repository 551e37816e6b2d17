"""The page in the browser: a run, map or recording, moment by moment."""

from insonify.extras import require

require("reports", "the colours of the view", "matplotlib")
