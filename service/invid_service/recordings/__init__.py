"""Recordings measured elsewhere: uploaded, identified and diagnosed."""
