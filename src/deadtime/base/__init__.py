"""The ground of all rooms: errors, checks, formats of text and numbers, read-only data."""
