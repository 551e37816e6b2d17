"""The loop of the method, what a config becomes, runs, campaigns, maps of recordings."""
