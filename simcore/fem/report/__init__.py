"""What a compression tells: checks of the final state, facts, fields, VTU."""
