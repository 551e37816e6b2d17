"""What steers the vehicle from measurements alone: navigation, guidance, control, routes."""
