"""The loop of the method, what a config becomes, runs, maps of recordings, comparisons."""
