"""What everything stands on: errors, files, processes, torch's runtime and the params file."""
