"""Films of the skeleton."""
