"""Special cases of the search, one a module (decision 11)."""
