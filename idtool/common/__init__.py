"""Errors, names, files written whole, safe YAML, provenance and interrupts: what every room may use."""
