"""Evaluation on held-out clips: one step ahead, and in the closed loop."""
