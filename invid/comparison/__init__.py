"""Two models of one robot: what changed beyond its uncertainty."""
