"""Arrays, distributions, fixed points, parallel map: knows no robot."""
