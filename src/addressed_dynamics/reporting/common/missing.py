"""What is missing in a report, and the command that makes it."""


def remedy(stage: str, experiment: str) -> str:
    """Return the command that makes what a stage of the pipeline writes; `experiment` is empty if it is not known."""
    return f"dvc repro {stage}@{experiment}" if experiment else f"dvc repro {stage}"


def missing_words(what: str, stage: str, experiment: str) -> str:
    """Say that something is missing in these results, `what` with a capital letter, and how it comes into being."""
    return f"{what} missing in these results: '{remedy(stage, experiment)}' makes them."
