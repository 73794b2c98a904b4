"""Results → HTML: one self-contained file for each page, readable without a network; one module for each page."""
