"""The files of a study, one kind a file."""
