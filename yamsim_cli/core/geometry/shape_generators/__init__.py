"""Objects generated from a few dimensions: visual surfaces, collision primitives and grasps."""
