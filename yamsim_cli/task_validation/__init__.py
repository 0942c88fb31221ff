"""Validation of tasks, and the catalog and templates of task files."""
