"""Causes that show only in large motion of a rigid machine, one a file."""
