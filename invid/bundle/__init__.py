"""Evidence of a measurement in one signed file, and its results worked out again."""
