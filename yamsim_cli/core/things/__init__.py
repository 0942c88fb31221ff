"""From the scan of a thing to an object's config: primitives to collide, mass and inertia, and where to hold it."""
