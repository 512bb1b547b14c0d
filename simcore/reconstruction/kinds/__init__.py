"""What to ask of each reconstruction, one kind a file: data alone."""
