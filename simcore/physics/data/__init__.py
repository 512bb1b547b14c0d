"""Tables of the physics, with their sources and licences in SOURCES.md."""
