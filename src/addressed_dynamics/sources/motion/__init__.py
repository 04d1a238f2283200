"""Motion capture in the layout of phase-functioned neural networks: read, extracted from clips, stored."""
