"""Uploaded label volumes: formats, tissues, orientation."""
