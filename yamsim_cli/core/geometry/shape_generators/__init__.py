"""Things generated from a handful of sizes: surfaces, collision primitives and grasps."""
