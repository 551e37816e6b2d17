"""Images of worlds: along a route, by a vehicle's sonars, or as a dataset with truth."""
