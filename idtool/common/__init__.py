"""Errors, names, atomic file output, safe YAML, provenance and interrupts, for all rooms."""
