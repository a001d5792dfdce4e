"""What outlives the process: rows in a database, files beside it."""
