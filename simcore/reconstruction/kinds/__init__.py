"""What to ask of each reconstruction, one kind a file. Nothing in here loads compiled code before it runs."""
