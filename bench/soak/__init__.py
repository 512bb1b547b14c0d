"""A service whose processes are killed at random."""
