"""Reports: pictures of a run, and the one HTML file that shows them all."""
