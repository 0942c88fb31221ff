"""Skills for cloth: grasps of single points of a cloth, and folding, flattening and sliding with them."""
