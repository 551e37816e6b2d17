"""On the vehicle: pings and poses come one at a time, the map grows, the next path goes back."""
