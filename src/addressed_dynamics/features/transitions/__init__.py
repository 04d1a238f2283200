"""Features of transitions: windows of frames, angles, normalisation."""
