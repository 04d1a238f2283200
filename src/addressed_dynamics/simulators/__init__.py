"""Trained models as one uses them: predictions, rollouts, export."""
