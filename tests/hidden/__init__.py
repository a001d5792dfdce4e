"""Recordings with a hidden effect, made by physics written apart from invid's own."""
