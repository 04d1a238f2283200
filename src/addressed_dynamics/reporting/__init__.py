"""The report: a verdict in words, tables and figures, as one HTML file and as Markdown."""
