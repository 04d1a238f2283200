"""Training: Algorithm 1, the two phases, checkpoints. Loops are generators that yield one result an epoch."""
