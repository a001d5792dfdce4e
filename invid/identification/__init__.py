"""Recording to model: starts, order, doubts."""
