"""Results of small specifications, held to references."""
