"""The report's figures, all in one house style."""
