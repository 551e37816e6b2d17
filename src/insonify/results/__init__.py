"""What each command leaves behind, written and read back."""
