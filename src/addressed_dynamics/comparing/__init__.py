"""Two versions of an experiment side by side: revisions of DVC and Git, or runs in MLflow."""
