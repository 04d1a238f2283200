"""What reports on any kind of data are made of."""
