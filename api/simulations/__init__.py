"""/v1/simulations: cases and their files."""
