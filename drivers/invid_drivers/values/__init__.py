"""Values of the loops of drives: as files, and measured while they are closed."""
