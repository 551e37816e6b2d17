"""Where to scan next: entropy, clusters, candidates, expected gain, and the planners."""
