"""Laws that a search supposes, by the kind of their place."""
