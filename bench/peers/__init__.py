"""Other people's programs on our problems."""
