"""A kind of data that is made up for a test: the temperature of a room."""
