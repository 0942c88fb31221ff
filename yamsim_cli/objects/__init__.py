"""Make object configs from surfaces: collision geometry, mass properties, visual meshes and grasps."""
