"""Forward dynamics: forces, stiction, integration, and simulation along a log."""
