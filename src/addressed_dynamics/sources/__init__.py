"""From what was recorded or imported to episodes, for each kind of data."""
