"""The figures and films of motion."""
