"""yamsim: simulation toolkit for the I2RT YAM arm."""

__version__ = "0.1.0"
