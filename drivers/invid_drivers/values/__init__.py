"""Values of the loops of drives: read, written by a person's act and undone, and as files."""
