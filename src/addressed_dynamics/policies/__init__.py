"""Policies that are learned inside a model, what they are worth there and in truth, and their files."""
