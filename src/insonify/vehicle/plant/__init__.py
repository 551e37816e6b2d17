"""The vehicle as the world has it: dynamics, currents, what its sensors read."""
