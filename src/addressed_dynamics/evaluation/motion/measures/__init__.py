"""Measures of motion that have no section of their own in the report; see `evaluation.common.measures`."""
