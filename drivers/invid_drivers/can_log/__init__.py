"""CAN logs as tables: the kind of log, its frames, the fields in them, and rows by SYNC."""
