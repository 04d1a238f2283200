"""Animations of rollouts: what really happened, and what a model makes of the same actions."""
