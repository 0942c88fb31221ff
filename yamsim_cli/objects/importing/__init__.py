"""Import of object configs from the YCB set and from object files."""
