"""The report on an experiment with transitions."""
