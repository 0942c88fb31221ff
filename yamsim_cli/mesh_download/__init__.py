"""Downloads and generates the meshes that yamsim does not ship. No other package downloads meshes."""
