"""The catalogue of causes, one a module."""
