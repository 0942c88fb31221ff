"""From photos of a station to a scene whose images look like them."""
