"""What makes the documents: their figures from runs, their pages from the code. No user of the package needs it."""
