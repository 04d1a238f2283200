"""Features of motion, and what is done to batches of it."""
