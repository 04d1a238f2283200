"""Transitions from logs: read, converted to tables."""
