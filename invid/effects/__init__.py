"""Causes: the interface, the laws' shared pieces, the catalogue."""
