"""Networks: stacked members, the addressing network, the model made of both, and their files."""
