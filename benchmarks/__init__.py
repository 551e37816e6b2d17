"""Each figure in the README comes from a command here: ``make bench``."""
