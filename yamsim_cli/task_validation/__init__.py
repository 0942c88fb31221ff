"""Proofs of tasks, and the files of tasks."""
