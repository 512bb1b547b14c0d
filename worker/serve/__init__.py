"""Processes: started and ended together, with the broker that comes along."""
