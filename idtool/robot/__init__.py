"""What a robot is: configuration, bodies and the inertias they can have, URDF, meshes, kinematics and collision."""
