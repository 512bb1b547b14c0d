"""What every stage shares: artifacts, grid, geometry, tissues, errors, random streams."""
