"""Pictures, and reports that open offline."""

from insonify.extras import require

require("reports", "reports and pictures", "matplotlib", "jinja2", "plotly")
