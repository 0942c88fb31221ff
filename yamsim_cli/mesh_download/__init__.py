"""Downloads and generates the meshes that yamsim does not ship. Only this package uses the network for them."""
