"""The task `put_bottles` of ABC's simulated evaluation, built from the model files of a checkout of amazon-far/abc."""
