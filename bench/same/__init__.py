"""Two revisions in turns, byte for byte."""
