"""The page for the technician."""
