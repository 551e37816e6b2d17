"""The page in the browser: what a run, a map or a recording holds, moment by moment."""
