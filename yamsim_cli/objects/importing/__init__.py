"""Object configs from the YCB set, and from files of things."""
