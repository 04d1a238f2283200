"""Measures of models of any kind."""
