"""The transport of photons against published cases."""
