"""The public Python API: logs, models, and one function for every command; each in a file of its own."""
