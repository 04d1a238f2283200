"""Features: samples from transitions, and back again from what a network says to the next state."""
