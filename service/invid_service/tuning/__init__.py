"""Values for the drives from a model, worked out in a process of their own."""
