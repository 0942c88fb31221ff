"""Untrusted files: reading confined to one folder, and MJCF includes."""
