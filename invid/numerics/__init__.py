"""Arrays, budgets, distributions, parallel map: knows no robot."""
