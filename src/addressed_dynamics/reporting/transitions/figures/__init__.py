"""Figures of transitions."""
