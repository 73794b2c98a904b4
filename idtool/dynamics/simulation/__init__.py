"""The model run forwards: forces, stiction, integration."""
