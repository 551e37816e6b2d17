"""The vehicle: how it moves, how it is steered, what it senses and where it believes it is."""
