"""Special rules of the search, one a module."""
