"""The closed loop: a model of motion follows commands and lives on its own predictions."""
