"""Results as JSON, HTML, terminal output and files for simulators."""
