"""What samples of any kind have in common."""
