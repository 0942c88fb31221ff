"""Skills for cloth: grasps of single points, and folding, flattening and sliding with them."""
