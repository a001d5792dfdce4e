"""Cells: readiness, stop, the accepted model and its history."""
