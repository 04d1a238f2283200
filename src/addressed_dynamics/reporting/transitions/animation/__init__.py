"""Films of rollouts."""
