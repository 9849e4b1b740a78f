"""What every room stands on: errors, checks, formats of text and numbers, read-only data."""
