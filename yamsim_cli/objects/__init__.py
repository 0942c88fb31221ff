"""Object configs from surfaces: collision primitives, mass and inertia, visual meshes, and grasps."""
