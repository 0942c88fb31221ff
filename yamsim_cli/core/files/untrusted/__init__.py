"""Reading of untrusted files within one folder, and expansion of MJCF includes."""
