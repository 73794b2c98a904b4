"""Robots: configuration, bodies and their realizable inertias, URDF, meshes, kinematics and collision."""
