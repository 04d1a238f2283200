"""The report on an experiment of motion: held-out frames, who serves which, and the closed loop."""
