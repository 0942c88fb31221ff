"""Make an object's config: of one of the YCB set, or of a file from elsewhere."""
