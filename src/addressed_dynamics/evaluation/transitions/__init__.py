"""Evaluation on held-out episodes: one-step errors, the addressing table (Table 1), rollouts."""
