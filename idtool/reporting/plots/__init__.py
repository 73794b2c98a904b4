"""Figures of results, for pages and notebooks alike: one file a kind, each function returns a `Figure`."""
