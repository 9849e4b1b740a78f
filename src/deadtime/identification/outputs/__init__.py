"""Plants from outputs alone: positions are logged, speeds are not."""
