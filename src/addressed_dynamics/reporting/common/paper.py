"""The paper whose experiments these are."""

CITATION = (
    "Bach, Melnik, Schilling, Korthals, Ritter: An Error-Based Addressing Architecture for Dynamic Model Learning. "
    "Machine Learning, Optimization, and Data Science (LOD 2020)."
)
"""The paper."""
