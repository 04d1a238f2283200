"""The sections of a params file, frozen and checked."""
