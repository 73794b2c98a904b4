"""URDF files: read and checked, and written back with every other byte kept."""
