"""The finite elements against exact solutions, similarity laws, other discretisations and other programs.

``python -m bench.verification`` runs everything and writes docs/verification.md.
"""
